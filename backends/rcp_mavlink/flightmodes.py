"""The names of flight modes: numbers mean something else for each autopilot and kind of vehicle."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["Family", "family"]

_COPTER = {0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 5: "LOITER", 6: "RTL", 7: "CIRCLE", 9: "LAND", 11: "DRIFT", 13: "SPORT", 14: "FLIP", 15: "AUTOTUNE", 16: "POSHOLD", 17: "BRAKE", 18: "THROW", 19: "AVOID_ADSB", 20: "GUIDED_NOGPS", 21: "SMART_RTL", 22: "FLOWHOLD", 23: "FOLLOW", 24: "ZIGZAG", 25: "SYSTEMID", 26: "AUTOROTATE", 27: "AUTO_RTL", 28: "TURTLE"}  # fmt: skip
_PLANE = {0: "MANUAL", 1: "CIRCLE", 2: "STABILIZE", 3: "TRAINING", 4: "ACRO", 5: "FBWA", 6: "FBWB", 7: "CRUISE", 8: "AUTOTUNE", 10: "AUTO", 11: "RTL", 12: "LOITER", 13: "TAKEOFF", 14: "AVOID_ADSB", 15: "GUIDED", 17: "QSTABILIZE", 18: "QHOVER", 19: "QLOITER", 20: "QLAND", 21: "QRTL", 22: "QAUTOTUNE", 23: "QACRO", 24: "THERMAL", 25: "LOITER_ALT_QLAND"}  # fmt: skip
_ROVER = {0: "MANUAL", 1: "ACRO", 3: "STEERING", 4: "HOLD", 5: "LOITER", 6: "FOLLOW", 7: "SIMPLE", 8: "DOCK", 9: "CIRCLE", 10: "AUTO", 11: "RTL", 12: "SMART_RTL", 15: "GUIDED", 16: "INITIALISING"}  # fmt: skip
_SUB = {0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 7: "CIRCLE", 9: "SURFACE", 16: "POSHOLD", 19: "MANUAL", 20: "MOTOR_DETECT"}  # fmt: skip


def _px4(main: int, sub: int = 0) -> int:
    return main << 16 | sub << 24


_PX4 = {_px4(1): "MANUAL", _px4(2): "ALTCTL", _px4(3): "POSCTL", _px4(4, 1): "READY", _px4(4, 2): "TAKEOFF", _px4(4, 3): "HOLD", _px4(4, 4): "MISSION", _px4(4, 5): "RTL", _px4(4, 6): "LAND", _px4(4, 8): "FOLLOW", _px4(5): "ACRO", _px4(6): "OFFBOARD", _px4(7): "STABILIZED"}  # fmt: skip

_ARDUPILOT, _PX4_AUTOPILOT = 3, 12
_PLANES = frozenset({1, *range(19, 26)})
_ROVERS = frozenset({10, 11})
_SUBS = frozenset({12})


class Family(NamedTuple):
    """What vehicles of one kind have in common."""

    kind: str
    """`copter`, `plane`, `rover`, `sub`, `px4` or `unknown`."""
    modes: dict[int, str]
    guided: str
    """The mode in which it follows targets and set-points."""
    hold: str
    """The mode in which it comes to rest and stays."""
    auto: str
    land: str
    """Empty: it cannot."""

    @property
    def px4(self) -> bool:
        """Whether it is PX4, which counts heights from the sea."""
        return self.kind == "px4"

    def number(self, name: str) -> int | None:
        """Return the number of a mode."""
        return next((n for n, word in self.modes.items() if word == name), None)

    def word(self, number: int) -> str:
        """Return the name of a mode, or its number where it has none."""
        return self.modes.get(number, str(number))


def family(autopilot: int, type_: int) -> Family:
    """Return the family of a vehicle, by what its heartbeat says."""
    if autopilot == _PX4_AUTOPILOT:
        return Family("px4", _PX4, "HOLD", "HOLD", "MISSION", "LAND")
    if autopilot != _ARDUPILOT:
        return Family("unknown", {}, "", "", "", "")
    if type_ in _PLANES:
        return Family("plane", _PLANE, "GUIDED", "LOITER", "AUTO", "")
    if type_ in _ROVERS:
        return Family("rover", _ROVER, "GUIDED", "HOLD", "AUTO", "")
    if type_ in _SUBS:
        return Family("sub", _SUB, "GUIDED", "POSHOLD", "AUTO", "")
    return Family("copter", _COPTER, "GUIDED", "BRAKE", "AUTO", "LAND")
