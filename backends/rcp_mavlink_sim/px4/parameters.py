"""PX4's parameters: integers by their bits in the float, and the type has to match.

What the flight of the simulated copter needs by ArduPilot's names is kept beside, out of sight.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

from rcp_mavlink_sim.parameters import Parameters
from rcp_mavlink_sim.wire import mav

__all__ = ["Px4Parameters"]

_CODES = {"i": mav.MAV_PARAM_TYPE_INT32, "f": mav.MAV_PARAM_TYPE_REAL32}
_HASH = "_HASH_CHECK"
_NO_INDEX = 0xFFFF
_MOST = 1e38  # of a float

_HIDDEN: dict[str, tuple[str, float]] = {
    "MPC_XY_CRUISE": ("WPNAV_SPEED", 100.0), "MPC_Z_VEL_MAX_UP": ("WPNAV_SPEED_UP", 100.0),
    "MPC_Z_VEL_MAX_DN": ("WPNAV_SPEED_DN", 100.0), "MPC_ACC_HOR": ("WPNAV_ACCEL", 100.0),
    "MPC_LAND_SPEED": ("LAND_SPEED", 100.0), "RTL_RETURN_ALT": ("RTL_ALT", 100.0),
    "COM_DISARM_PRFLT": ("DISARM_DELAY", 1.0),
}  # fmt: skip
"""The names that the flight knows them by, and the factor to their units."""
_KEPT = {
    "GUID_OPTIONS": 8.0,
    "FOLL_ENABLE": 1.0,
    "FOLL_DIST_MAX": 0.0,
    "FOLL_OFS_TYPE": 1.0,
    "RTL_CONE_SLOPE": 0.0,
}


class Px4Parameters(Parameters):
    """Names with types and values."""

    def __init__(self, other: dict[str, float]) -> None:
        hidden = {name: value for name, value in other.items() if name.startswith("SIM_")}
        self._own = Parameters("copter", hidden | _KEPT)
        """Those of the flight."""
        super().__init__("px4", {n: v for n, v in other.items() if n not in hidden})
        for name in self.listed():
            self._apply(name)

    def __getitem__(self, name: str) -> float:
        if name in self._values:
            return self._values[name]
        if name.startswith("FOLL_OFS_"):
            return self._side(name)
        return self._own[name]

    def _side(self, name: str) -> float:
        angle, away = math.radians(self["FLW_TGT_FA"]), self["FLW_TGT_DST"]
        return {
            "FOLL_OFS_X": away * math.cos(angle),
            "FOLL_OFS_Y": away * math.sin(angle),
            "FOLL_OFS_Z": -self["FLW_TGT_HT"],
        }.get(name, self._own[name])

    def set(self, name: str, value: float) -> bool:
        """Set a parameter, or one of the flight; return whether this succeeded."""
        if name not in self._values and name not in self._kinds:
            return self._own.set(name, value)
        done = super().set(name, value)
        self._apply(name)
        return done

    def _apply(self, name: str) -> None:
        if name in _HIDDEN:
            own, factor = _HIDDEN[name]
            self._own.set(own, max(-_MOST, min(_MOST, self._values[name] * factor)))

    def boot(self) -> None:
        """Read the storage."""
        super().boot()
        for name in self.listed():
            self._apply(name)

    # The protocol

    def message(self, name: str, place: int | None = None, type_: int | None = None) -> Any:
        """Return the PARAM_VALUE of a name, with its index in the list."""
        at = self._places[name] if place is None else place
        kind, value = self._kinds[name], self._values[name]
        if kind == "i":
            value = struct.unpack("<f", struct.pack("<i", int(value)))[0]
        code = _CODES[kind] if type_ is None else type_
        return mav.MAVLink_param_value_message(name.encode(), value, code, len(self._names), at)

    def hashed(self) -> Any:
        """Return the PARAM_VALUE of the hash over all parameters, which begins each list."""
        number = struct.pack("<I", sum(map(hash, self._names)) & 0x7FFFFFFF)
        value = struct.unpack("<f", number)[0]
        code = mav.MAV_PARAM_TYPE_UINT32
        return mav.MAVLink_param_value_message(
            _HASH.encode(), value, code, len(self._names), _NO_INDEX
        )

    def read(self, message: Any, answer: Callable[[Any], None]) -> None:
        """Handle PARAM_REQUEST_READ, if there is such a parameter."""
        if message.param_index < 0 and str(message.param_id) == _HASH:
            answer(self.hashed())
            return
        super().read(message, answer)

    def write(self, message: Any, answer: Callable[[Any], None]) -> bool:
        """Handle PARAM_SET; another type than the parameter's own changes nothing, and has no reply."""
        name = str(message.param_id)
        kind = self._kinds.get(name)
        if kind is None or message.param_type != _CODES[kind]:
            return False
        value = message.param_value
        if kind == "i":
            value = float(struct.unpack("<i", struct.pack("<f", value))[0])
        if not self.set(name, value):
            return False
        answer(self.message(name))
        return True
