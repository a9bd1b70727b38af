"""A feature's access to robots: resources, samples and conditions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Protocol

from rcp_conditions import Condition, Ref
from rcp_kernel.access.conditions import Placed
from rcp_kernel.spi import StopPlan
from rcp_kernel.tree.entry import Entry, Owner, StopGroup
from rcp_kernel.tree.samples import Sample

__all__ = ["RobotConditions", "Robots", "SupervisedBackend"]


class RobotConditions(Protocol):
    """Evaluates conditions over the state of robots: see `rcp_conditions.condition`."""

    def use(self, conditions: Iterable[Condition]) -> None:
        """Keep the values of these conditions published, instead of those of the previous call."""
        ...

    def holds(self, condition: Condition, placed: Placed) -> bool | None:
        """Return whether a condition holds for a robot, or that of an entry; None: it is unknown."""
        ...

    def values(self, refs: Iterable[Ref], placed: Placed) -> dict[Ref, Any]:
        """Return the current values of names for a robot, if known."""
        ...

    def resource(self, ref: Ref, placed: Placed) -> tuple[Entry, Ref] | None:
        """Resolve a name for a robot: the resource, and the field within it."""
        ...


class SupervisedBackend(Owner, Protocol):
    """A backend of the configuration, over all its lives; the `owner` of its entries."""

    @property
    def plans(self) -> Mapping[str, StopPlan]:
        """What stops its robots without the gateway, by name: see `Host.guard`."""
        ...

    @property
    def plans_changed(self) -> int:
        """Number of changes of these."""
        ...


class Robots(Protocol):
    """The tree with all robots; only for the event loop's thread."""

    @property
    def backends(self) -> Sequence[SupervisedBackend]:
        """The backends of the configuration; a live list."""
        ...

    @property
    def entries(self) -> Mapping[str, Entry]:
        """Every resource, by path; a live mapping."""
        ...

    @property
    def conditions(self) -> RobotConditions:
        """The feature's own conditions."""
        ...

    def follow(self, added: Callable[[Entry], None], removed: Callable[[Entry], None]) -> None:
        """Report each resource that is declared (or declared again) or withdrawn from now on."""
        ...

    def follow_state(self, changed: Callable[[], None]) -> None:
        """Report when the state of a robot may have changed.

        That is its availability, an e-stop, a hold, or what its backend says of it.
        """
        ...

    def follow_leases(self, told: Callable[[StopGroup], None]) -> None:
        """Report when a robot's own gateway has said who holds leases on it (`own_leases`)."""
        ...

    def watch(self, path: str, offer: Callable[[Sample], None]) -> Callable[[], None]:
        """Receive each sample of a path, keep its source running; return the end function.

        The path need not exist yet, and may come and go.
        """
        ...
