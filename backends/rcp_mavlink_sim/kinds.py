"""The kinds of vehicles: their MAVLink identity and their modes."""

from __future__ import annotations

from typing import Literal

import msgspec

from rcp_mavlink_sim.modes import Mode
from rcp_mavlink_sim.wire import mav

__all__ = ["KINDS", "Kind", "Name"]

Name = Literal["copter", "plane", "rover", "boat"]

_COPTER = {0: Mode.STABILIZE, 2: Mode.ALT_HOLD, 3: Mode.AUTO, 4: Mode.GUIDED, 5: Mode.LOITER, 6: Mode.RTL, 7: Mode.CIRCLE, 9: Mode.LAND, 16: Mode.POSHOLD, 17: Mode.BRAKE, 23: Mode.FOLLOW}  # fmt: skip
_PLANE = {0: Mode.MANUAL, 1: Mode.CIRCLE, 2: Mode.STABILIZE, 5: Mode.FBWA, 6: Mode.FBWB, 7: Mode.CRUISE, 10: Mode.AUTO, 11: Mode.RTL, 12: Mode.LOITER, 13: Mode.TAKEOFF, 15: Mode.GUIDED}  # fmt: skip
_ROVER = {0: Mode.MANUAL, 3: Mode.STEERING, 4: Mode.HOLD, 5: Mode.LOITER, 10: Mode.AUTO, 11: Mode.RTL, 12: Mode.SMART_RTL, 15: Mode.GUIDED}  # fmt: skip
_PX4 = {
    1 << 16: Mode.MANUAL, 2 << 16: Mode.ALT_HOLD, 3 << 16: Mode.LOITER, 3 << 16 | 1 << 24: Mode.CIRCLE,
    4 << 16 | 2 << 24: Mode.TAKEOFF, 4 << 16 | 3 << 24: Mode.GUIDED, 4 << 16 | 4 << 24: Mode.AUTO,
    4 << 16 | 5 << 24: Mode.RTL, 4 << 16 | 6 << 24: Mode.LAND, 4 << 16 | 8 << 24: Mode.FOLLOW,
    6 << 16: Mode.OFFBOARD, 7 << 16: Mode.STABILIZE,
}  # fmt: skip
"""Main and sub mode of PX4; its HOLD is GUIDED, in which a copter goes to targets or stays."""
_BY_HAND = frozenset({Mode.MANUAL, Mode.STABILIZE, Mode.STEERING, Mode.ALT_HOLD, Mode.FBWA, Mode.FBWB, Mode.HOLD, Mode.LAND})  # fmt: skip


class Kind(msgspec.Struct, frozen=True, kw_only=True):
    """One kind of vehicle."""

    name: Name
    title: str
    """Firmware name."""
    frame: str
    """Frame, as in its banner."""
    type: int
    """MAV_TYPE."""
    modes: dict[int, Mode]
    first: Mode
    """The mode after boot."""
    flies: bool
    """Whether it can fly."""
    hold: Mode
    """The mode for holding."""
    down: Mode
    """The failsafe mode if the way home is unknown."""
    counts_home: bool = True
    """Whether home is item 0 of its missions."""
    own: dict[str, str] = {}
    """Its names for parameters that a copter names differently."""

    @property
    def drives(self) -> bool:
        """Whether it is a ground or water vehicle."""
        return not self.flies

    def number(self, mode: Mode) -> int:
        """Return the custom mode of its heartbeat."""
        return next(number for number, one in self.modes.items() if one is mode)

    def param(self, name: str) -> str:
        """Return its name for a parameter of a copter."""
        return self.own.get(name, name)

    def by_hand(self, mode: Mode) -> bool:
        """Return whether a mode is steered manually."""
        return mode in _BY_HAND


KINDS: dict[str, Kind] = {
    "copter": Kind(
        name="copter", title="ArduCopter", frame="Frame: QUAD/X", type=mav.MAV_TYPE_QUADROTOR,
        modes=_COPTER, first=Mode.STABILIZE, flies=True, hold=Mode.BRAKE, down=Mode.LAND,
    ),
    "plane": Kind(
        name="plane", title="ArduPlane", frame="", type=mav.MAV_TYPE_FIXED_WING,
        modes=_PLANE, first=Mode.MANUAL, flies=True, hold=Mode.LOITER, down=Mode.CIRCLE,
        own={"FS_GCS_ENABLE": "FS_GCS_ENABL", "FS_GCS_TIMEOUT": "FS_LONG_TIMEOUT", "FS_THR_ENABLE": "THR_FAILSAFE"},
    ),
    "rover": Kind(
        name="rover", title="ArduRover", frame="", type=mav.MAV_TYPE_GROUND_ROVER,
        modes=_ROVER, first=Mode.MANUAL, flies=False, hold=Mode.HOLD, down=Mode.HOLD,
    ),
}  # fmt: skip
KINDS["boat"] = msgspec.structs.replace(
    KINDS["rover"], name="boat", type=mav.MAV_TYPE_SURFACE_BOAT, hold=Mode.LOITER
)
KINDS["px4"] = msgspec.structs.replace(
    KINDS["copter"], title="PX4", frame="", modes=_PX4, first=Mode.GUIDED, hold=Mode.GUIDED, counts_home=False
)  # fmt: skip
