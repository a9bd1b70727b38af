"""Names of flight modes: numbers depend on the autopilot and the type of vehicle."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

__all__ = ["Family", "family"]

_COPTER = {0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 5: "LOITER", 6: "RTL", 7: "CIRCLE", 9: "LAND", 11: "DRIFT", 13: "SPORT", 14: "FLIP", 15: "AUTOTUNE", 16: "POSHOLD", 17: "BRAKE", 18: "THROW", 19: "AVOID_ADSB", 20: "GUIDED_NOGPS", 21: "SMART_RTL", 22: "FLOWHOLD", 23: "FOLLOW", 24: "ZIGZAG", 25: "SYSTEMID", 26: "AUTOROTATE", 27: "AUTO_RTL", 28: "TURTLE"}  # fmt: skip
_PLANE = {0: "MANUAL", 1: "CIRCLE", 2: "STABILIZE", 3: "TRAINING", 4: "ACRO", 5: "FBWA", 6: "FBWB", 7: "CRUISE", 8: "AUTOTUNE", 10: "AUTO", 11: "RTL", 12: "LOITER", 13: "TAKEOFF", 14: "AVOID_ADSB", 15: "GUIDED", 17: "QSTABILIZE", 18: "QHOVER", 19: "QLOITER", 20: "QLAND", 21: "QRTL", 22: "QAUTOTUNE", 23: "QACRO", 24: "THERMAL", 25: "LOITER_ALT_QLAND"}  # fmt: skip
_ROVER = {0: "MANUAL", 1: "ACRO", 3: "STEERING", 4: "HOLD", 5: "LOITER", 6: "FOLLOW", 7: "SIMPLE", 8: "DOCK", 9: "CIRCLE", 10: "AUTO", 11: "RTL", 12: "SMART_RTL", 15: "GUIDED", 16: "INITIALISING"}  # fmt: skip
_SUB = {0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 7: "CIRCLE", 9: "SURFACE", 16: "POSHOLD", 19: "MANUAL", 20: "MOTOR_DETECT"}  # fmt: skip


def _px4(main: int, sub: int = 0) -> int:
    return main << 16 | sub << 24


_PX4 = {_px4(1): "MANUAL", _px4(2): "ALTCTL", _px4(3): "POSCTL", _px4(3, 1): "ORBIT", _px4(3, 2): "POSCTL_SLOW", _px4(4, 1): "READY", _px4(4, 2): "TAKEOFF", _px4(4, 3): "HOLD", _px4(4, 4): "MISSION", _px4(4, 5): "RTL", _px4(4, 6): "LAND", _px4(4, 8): "FOLLOW", _px4(4, 9): "PRECISION_LAND", _px4(4, 10): "VTOL_TAKEOFF", _px4(5): "ACRO", _px4(6): "OFFBOARD", _px4(7): "STABILIZED", _px4(10): "TERMINATION", _px4(11): "ALTITUDE_CRUISE"}  # fmt: skip

_ARDUPILOT, _PX4_AUTOPILOT = 3, 12
_KINDS = {1: "plane", 10: "rover", 11: "boat", 12: "sub", **dict.fromkeys(range(19, 26), "vtol")}

_RISING = ("action/takeoff", "action/land")
_STICKS = "actuator/velocity"
_ATTITUDE = "actuator/attitude"
_POSITION = "actuator/position"


class Family(NamedTuple):
    """Common properties of one type of vehicle."""

    autopilot: str
    """`ardupilot`, `px4` or `unknown`."""
    kind: str
    """`copter`, `plane`, `vtol`, `rover`, `boat` or `sub`."""
    modes: dict[int, str]
    guided: str
    """The mode for going to a target."""
    led: str
    """The mode for following set-points."""
    hold: str
    """The mode for holding or circling at a position."""
    auto: str
    rtl: str
    """Empty if it has none."""
    land: str
    """Empty if it has none."""
    without: frozenset[str] = frozenset()
    """Resources that it does not have."""

    @property
    def px4(self) -> bool:
        """Whether it is PX4, which measures heights from sea level."""
        return self.autopilot == "px4"

    @property
    def flies(self) -> bool:
        """Whether it must be in the air to go to a target."""
        return self.kind in ("copter", "plane", "vtol")

    @property
    def circles(self) -> bool:
        """Whether it holds a position by circling around it."""
        return self.kind in ("plane", "vtol")

    @property
    def drives(self) -> bool:
        """Whether it is a ground or water vehicle; these ignore heights."""
        return self.kind in ("rover", "boat")

    def holding(self, *, hovering: bool) -> tuple[str, ...]:
        """List the modes that hold its position, in order of preference; all require a position."""
        if self.px4:
            return (self.hold,)
        match self.kind:
            case "copter" if self.hold:
                return ("BRAKE", "LOITER", "POSHOLD")
            case "vtol" if hovering:  # as a plane it would fly away in LOITER
                return ("QLOITER",)
            case _:
                return (self.hold,) if self.hold else ()

    def level(self, *, hovering: bool) -> tuple[str, ...]:
        """List the modes that keep it level, or stop its motors, without a position."""
        if self.px4 or not self.hold:
            return ()
        match self.kind:
            case "copter" | "sub":
                return ("ALT_HOLD",)
            case "vtol" if hovering:
                return ("QHOVER",)
            case "plane" | "vtol":
                return ("CIRCLE",)
            case "boat":
                return ("HOLD",)
            case _:
                return ()

    @property
    def resting(self) -> frozenset[str]:
        """The modes in which it stays where it is."""
        both = (False, True)
        held = (self.holding(hovering=h) + self.level(hovering=h) for h in both)
        return frozenset(mode for modes in held for mode in modes)

    def circling(self, *, hovering: bool) -> frozenset[str]:
        """List the modes in which circling around a position counts as rest."""
        if not self.circles or hovering:
            return frozenset()
        return frozenset(self.holding(hovering=False) + self.level(hovering=False))

    def number(self, name: str) -> int | None:
        """Return the number of a mode."""
        return next((n for n, word in self.modes.items() if word == name), None)

    def word(self, number: int) -> str:
        """Return the name of a mode, or its number if it has no name."""
        return self.modes.get(number, str(number))


@lru_cache(maxsize=256)
def family(autopilot: int, type_: int) -> Family:
    """Return the family of a vehicle from its heartbeat."""
    kind = _KINDS.get(type_, "copter")
    if autopilot == _PX4_AUTOPILOT:
        return _of_px4(kind)
    if autopilot != _ARDUPILOT:
        return Family("unknown", kind, {}, "", "", "", "", "", "", _without(kind))
    match kind:
        case "plane":
            return Family(
                "ardupilot",
                kind,
                _PLANE,
                "GUIDED",
                "GUIDED",
                "LOITER",
                "AUTO",
                "RTL",
                "",
                _without(kind) | {"action/land"},
            )
        case "vtol":
            return Family(
                "ardupilot",
                kind,
                _PLANE,
                "GUIDED",
                "GUIDED",
                "LOITER",
                "AUTO",
                "RTL",
                "QLAND",
                _without(kind),
            )
        case "rover" | "boat":
            hold = "HOLD" if kind == "rover" else "LOITER"  # a boat that only stops drifts away
            return Family(
                "ardupilot",
                kind,
                _ROVER,
                "GUIDED",
                "GUIDED",
                hold,
                "AUTO",
                "RTL",
                "",
                _without(kind),
            )
        case "sub":
            return Family(
                "ardupilot",
                kind,
                _SUB,
                "GUIDED",
                "GUIDED",
                "POSHOLD",
                "AUTO",
                "",
                "SURFACE",
                _without(kind),
            )
        case _:
            return Family("ardupilot", kind, _COPTER, "GUIDED", "GUIDED", "BRAKE", "AUTO", "RTL", "LAND")  # fmt: skip


def _of_px4(kind: str) -> Family:
    land = "" if kind in ("rover", "boat", "sub") else "LAND"
    return Family("px4", kind, _PX4, "HOLD", "OFFBOARD", "HOLD", "MISSION", "RTL", land, _without(kind))  # fmt: skip


def _without(kind: str) -> frozenset[str]:
    match kind:
        case "plane" | "vtol":
            return frozenset({_STICKS, _POSITION})
        case "rover" | "boat":
            return frozenset({*_RISING, _ATTITUDE})
        case "sub":
            return frozenset({*_RISING, "action/rtl", _ATTITUDE, _POSITION})
        case _:
            return frozenset()
