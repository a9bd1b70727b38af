"""The steps of a stop, strongest first: the next is used if the autopilot refuses the previous."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

from rcp_mavlink.flightmodes import Family

__all__ = ["LOITER", "Group", "Rung", "ladder"]

Group = Literal["hold", "level", "land", "disarm", "terminate"]


class Rung(NamedTuple):
    """One step of a stop."""

    group: Group
    mode: str
    """The flight mode it commands; empty for those that stop the motors."""
    rests: Literal["still", "landed", "disarmed"]
    """The state that telemetry must confirm."""

    @property
    def word(self) -> str:
        """Its name in messages and in the log."""
        return self.mode or _WORDS[self.group]


_WORDS = {
    "hold": "NAV_LOITER_UNLIM", "disarm": "forced disarm", "terminate": "flight termination"
}  # fmt: skip
LOITER = Rung("hold", "", "still")
"""For an autopilot with unknown modes: no mode confirms that it holds."""


def ladder(groups: Sequence[str], family: Family, *, hovering: bool) -> list[Rung]:
    """List the steps of some groups for a vehicle; unavailable ones are left out."""
    rungs: list[Rung] = []
    for group in dict.fromkeys(groups):
        match group:
            case "hold":
                modes = family.holding(hovering=hovering)
                rungs += [Rung("hold", mode, "still") for mode in modes]
            case "level":
                modes = family.level(hovering=hovering)
                rungs += [Rung("level", mode, "still") for mode in modes]
            case "land":
                rungs += [Rung("land", family.land, "landed")] if family.land else []
            case "disarm":
                rungs.append(Rung("disarm", "", "disarmed"))
            case _:
                rungs.append(Rung("terminate", "", "disarmed"))
    return rungs
