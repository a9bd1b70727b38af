"""The sensors of the standard profiles, each derived from one message or several."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import msgspec

from rcp_kernel.clock import iso
from rcp_kernel.types import PoseStamped
from rcp_mavlink import enu
from rcp_mavlink.dialect import Dialect
from rcp_mavlink.frames import Frame
from rcp_profiles.messages import Attitude, BatteryState, GnssFix, TwistStamped

__all__ = ["Derived", "DerivedFrame", "deriveds"]

_NO_HEADING = 65535
_FIXES = ("none", "none", "2d", "3d", "dgnss", "rtk_float", "rtk_fixed", "3d", "3d")
"""By GPS_FIX_TYPE; a static or precise position is one in three dimensions."""
_POSITIONED = 2  # GPS_FIX_TYPE from which there is a position
_NO_ACCURACY = 0
_CHARGING, _UNKNOWN_STATE = 7, 0

Frames = Mapping[str, Frame]


class Derived(NamedTuple):
    """A path and the messages that its value is made of; the first one brings a new value."""

    name: str
    description: str
    messages: tuple[str, ...]
    type: Any
    make: Callable[[Frames, str | None], Any]
    live: bool = False
    """Whether the gateway itself needs the messages, so that they are always received."""


class DerivedFrame:
    """A value to be; `decode` makes it from the messages that it was given."""

    __slots__ = ("_at", "_frames", "_make", "data")

    def __init__(self, derived: Derived, frames: Frames, at: int | None) -> None:
        self._make, self._at = derived.make, at
        self._frames = {name: frames[name] for name in derived.messages}
        self.data = self._frames[derived.messages[0]].data

    def decode(self) -> Any:
        """Return its value."""
        return self._make(self._frames, None if self._at is None else iso(self._at))


def deriveds(dialect: Dialect) -> list[Derived]:
    """List the derived sensors that a dialect has the messages for."""
    battery = _beside(dialect, "BATTERY_STATUS", BatteryState)
    velocity = _beside(dialect, "VFR_HUD", TwistStamped)
    found = [
        Derived("sensor/pose", "Position and heading in the map: metres east, north and up from home.", ("GLOBAL_POSITION_INT", "HOME_POSITION"), PoseStamped, _pose, live=True),
        Derived("sensor/orientation", "Attitude and angular velocity: body x forward, y left, z up; map x east, y north, z up.", ("ATTITUDE",), Attitude, _orientation),
        Derived("sensor/gnss", "Position by satellites.", ("GPS_RAW_INT",), GnssFix, _gnss),
    ]  # fmt: skip
    if velocity is not None:
        found.append(Derived("sensor/velocity", "Velocity ahead, to the left and up, and turning rates, positive to the left; beside them ground speed, airspeed, climb rate, compass heading and throttle.", ("VFR_HUD", "GLOBAL_POSITION_INT", "ATTITUDE"), velocity, _velocity(velocity)))  # fmt: skip
    if battery is not None:
        found.append(Derived("sensor/battery", "Remaining charge, voltage and current; beside them the vehicle's own report: cells, consumption, state.", ("BATTERY_STATUS",), battery, _battery(battery)))  # fmt: skip
    return [one for one in found if all(name in dialect.by_name for name in one.messages)]


def _beside(dialect: Dialect, message: str, profiled: type[msgspec.Struct]) -> Any:
    """Return a profile's type with the fields of a message beside its own; None without it."""
    definition = dialect.by_name.get(message)
    if definition is None:
        return None
    native = [(field.name, field.type) for field in msgspec.structs.fields(definition.type)]
    return msgspec.defstruct(
        profiled.__name__, native, bases=(profiled,), frozen=True, kw_only=True,
        forbid_unknown_fields=True, module=__name__,
    )  # fmt: skip


def _native(value: Any) -> dict[str, Any]:
    return {name: getattr(value, name) for name in value.__struct_fields__}


def _heading(position: Mapping[str, Any]) -> float:
    """Return the heading, rad; one that is not reported is taken as north."""
    centidegrees = position["hdg"]
    return 0.0 if centidegrees == _NO_HEADING else math.radians(centidegrees / 100)


def _pose(frames: Frames, at: str | None) -> PoseStamped:
    f, home = frames["GLOBAL_POSITION_INT"].fields(), frames["HOME_POSITION"].fields()
    origin = (home["latitude"] / 1e7, home["longitude"] / 1e7, home["altitude"] / 1e3)
    where = enu.place(f["lat"] / 1e7, f["lon"] / 1e7, f["relative_alt"] / 1e3, origin)
    return PoseStamped(where, enu.flat(_heading(f)), "map", at)


def _orientation(frames: Frames, at: str | None) -> Attitude:
    f = frames["ATTITUDE"].fields()
    turning = enu.rates(f["rollspeed"], f["pitchspeed"], f["yawspeed"])
    return Attitude(enu.attitude(f["roll"], f["pitch"], f["yaw"]), turning, "map", at)


def _velocity(type_: Any) -> Callable[[Frames, str | None], Any]:
    def make(frames: Frames, at: str | None) -> Any:
        f, turn = frames["GLOBAL_POSITION_INT"].fields(), frames["ATTITUDE"].fields()
        v = (f["vx"] / 100, f["vy"] / 100, f["vz"] / 100)
        return type_(
            linear=enu.level_velocity(*v, turn["yaw"]),
            angular=enu.rates(turn["rollspeed"], turn["pitchspeed"], turn["yawspeed"]),
            timestamp=at,
            **_native(frames["VFR_HUD"].decode()),
        )

    return make


def _battery(type_: Any) -> Callable[[Frames, str | None], Any]:
    def make(frames: Frames, at: str | None) -> Any:
        native = frames["BATTERY_STATUS"].decode()
        cells = [cell for cell in native.voltages if cell is not None]
        extra = frames["BATTERY_STATUS"].fields()
        more = [cell / 1000 for cell in extra["voltages_ext"] if cell]
        left, drawn = native.battery_remaining, native.current_battery
        state = extra["charge_state"]
        return type_(
            percentage=None if left is None else min(1.0, max(0.0, left)),
            voltage=sum(cells) + sum(more) if cells else None,
            current=None if drawn is None else -drawn,  # MAVLink counts what is drawn
            charging=None if state == _UNKNOWN_STATE else state == _CHARGING,
            timestamp=at,
            **_native(native),
        )

    return make


def _gnss(frames: Frames, at: str | None) -> GnssFix:
    f = frames["GPS_RAW_INT"].fields()
    kind = f["fix_type"]
    fixed, satellites, accuracy = kind >= _POSITIONED, f["satellites_visible"], f["h_acc"]
    return GnssFix(
        fix=_FIXES[kind] if kind < len(_FIXES) else "3d",  # type: ignore[arg-type]
        latitude=f["lat"] / 1e7 if fixed else None,
        longitude=f["lon"] / 1e7 if fixed else None,
        altitude=f["alt"] / 1e3 if kind > _POSITIONED else None,
        satellites=None if satellites == 255 else satellites,
        horizontal_accuracy=None if accuracy == _NO_ACCURACY or not fixed else accuracy / 1e3,
        timestamp=at,
    )
