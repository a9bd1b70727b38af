"""What a feature may know of robots: their resources, samples, and conditions on these."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Protocol

from rcp_conditions import Condition, Ref
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Sample

__all__ = ["RobotConditions", "Robots"]


class RobotConditions(Protocol):
    """Evaluates conditions over the state of robots: see `rcp_conditions.condition`."""

    def use(self, conditions: Iterable[Condition]) -> None:
        """Keep published what these conditions name, in place of those before."""
        ...

    def holds(self, condition: Condition, placed: Entry) -> bool | None:
        """Tell whether a condition holds for the robot of an entry; None: it cannot be known."""
        ...

    def values(self, refs: Iterable[Ref], placed: Entry) -> dict[Ref, Any]:
        """Return what names stand for now, for the robot of an entry; not what is unknown."""
        ...

    def resource(self, ref: Ref, placed: Entry) -> tuple[Entry, Ref] | None:
        """Find what a name means for a robot: the resource, and the field in it."""
        ...


class Robots(Protocol):
    """The tree with all robots. For the event loop's thread only."""

    @property
    def entries(self) -> Mapping[str, Entry]:
        """Every resource, by path; changes while it is held."""
        ...

    @property
    def conditions(self) -> RobotConditions:
        """Conditions of the feature's own."""
        ...

    def follow(self, added: Callable[[Entry], None], removed: Callable[[Entry], None]) -> None:
        """Have each resource told that is declared (or declared anew) and withdrawn from now on."""
        ...

    def watch(self, path: str, offer: Callable[[Sample], None]) -> Callable[[], None]:
        """Have each sample of a path offered, and its source kept running; return what ends it.

        The path need not be there yet, and may come and go.
        """
        ...
