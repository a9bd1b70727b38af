"""A feature's access to robots: resources, samples and conditions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import ParamSpec, Protocol

import structlog

from rcp_conditions import Condition
from rcp_kernel.access.conditions import Conditions
from rcp_kernel.features.health import FeatureHealth
from rcp_kernel.spi import StopPlan
from rcp_kernel.tree.entry import Entry, Owner, RobotUnit
from rcp_kernel.tree.registry import Registry
from rcp_kernel.tree.samples import Listener, Sample

__all__ = ["RobotConditions", "Robots", "SupervisedBackend"]

log = structlog.get_logger("rcp.features")
P = ParamSpec("P")


class SampleSource(Protocol):
    """The tree, and who listens to it."""

    registry: Registry

    def listen(self, entry: Entry, listener: Listener) -> None:
        """Offer each new sample of an entry to a listener, and keep its source running."""
        ...

    def unlisten(self, entry: Entry, listener: Listener) -> None:
        """End that."""
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


class RobotConditions:
    """Evaluates conditions over the state of robots: see `rcp_conditions.condition`."""

    def __init__(self, feature: str, conditions: Conditions) -> None:
        self._feature = feature
        self._conditions = conditions
        self.holds = conditions.holds
        self.values = conditions.values
        self.resource = conditions.resource

    def use(self, conditions: Iterable[Condition]) -> None:
        """Keep the values of these conditions published, instead of those of the previous call."""
        self._conditions.use(f"feature {self._feature}", conditions)


class _Watch:
    """Passes the samples of a path to a feature, whose exceptions must not reach the publisher."""

    __slots__ = ("_feature", "_offer")

    def __init__(self, feature: str, offer: Callable[[Sample], None]) -> None:
        self._feature = feature
        self._offer = offer

    def offer(self, sample: Sample) -> None:
        try:
            self._offer(sample)
        except Exception:
            log.exception("watch_failed", feature=self._feature, path=sample.entry.path)


class Robots:
    """The tree with all robots, for one feature; only for the event loop's thread."""

    def __init__(
        self,
        health: FeatureHealth,
        hub: SampleSource,
        conditions: Conditions,
        backends: Sequence[SupervisedBackend],
    ) -> None:
        self._health = health
        self._hub = hub
        self._registry = hub.registry
        self._watches: dict[str, list[_Watch]] = {}
        self.backends = backends
        """The backends of the configuration; a live list."""
        self.entries: Mapping[str, Entry] = hub.registry.entries
        """Every resource, by path; a live mapping."""
        self.conditions = RobotConditions(health.name, conditions)
        """The feature's own conditions."""

    def follow(self, added: Callable[[Entry], None], removed: Callable[[Entry], None]) -> None:
        """Report each resource that is declared (or declared again) or withdrawn from now on."""
        self._registry.on_added.append(self._contained("follow", added))
        self._registry.on_removed.append(self._contained("follow", removed))

    def follow_state(self, changed: Callable[[], None]) -> None:
        """Report when the state of a robot may have changed.

        That is its availability, an e-stop, a hold, or what its backend reports about it.
        """
        self._registry.on_state.append(self._contained("follow_state", changed))

    def follow_leases(self, changed: Callable[[RobotUnit], None]) -> None:
        """Report when a robot's own gateway has announced who holds leases on it (`own_leases`)."""
        self._registry.on_leases.append(self._contained("follow_leases", changed))

    def _contained(self, part: str, callback: Callable[P, None]) -> Callable[P, None]:
        """Keep errors of the feature from the caller: a backend, or an e-stop."""

        def call(*args: P.args, **kwargs: P.kwargs) -> None:
            try:
                callback(*args, **kwargs)
            except Exception as error:
                self._health.failed(part, error)

        return call

    def watch(self, path: str, offer: Callable[[Sample], None]) -> Callable[[], None]:
        """Receive each sample of a path, keep its source running; return the end function.

        The path need not exist yet, and may come and go.
        """
        if self._added not in self._registry.on_added:
            self._registry.on_added.append(self._added)
        watch = _Watch(self._health.name, offer)
        self._watches.setdefault(path, []).append(watch)
        if (entry := self.entries.get(path)) is not None:
            self._hub.listen(entry, watch)

        def end() -> None:
            several = self._watches[path]
            several.remove(watch)
            if not several:
                del self._watches[path]
            if (entry := self.entries.get(path)) is not None:
                self._hub.unlisten(entry, watch)

        return end

    def _added(self, entry: Entry) -> None:
        for watch in self._watches.get(entry.path, ()):
            self._hub.listen(entry, watch)
