"""The robots as one feature sees them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import ParamSpec

import structlog

from rcp_conditions import Condition
from rcp_kernel.access.conditions import Conditions
from rcp_kernel.features.health import FeatureHealth
from rcp_kernel.features.robots import SupervisedBackend
from rcp_kernel.tree.entry import Entry, StopGroup
from rcp_kernel.tree.samples import Sample
from rcp_streams.hub import Hub

__all__ = ["GatewayRobots"]

log = structlog.get_logger("rcp.features")
P = ParamSpec("P")


class _Watch:
    """Watches one path for one feature, whose exceptions must not reach the publisher."""

    __slots__ = ("_feature", "_offer")

    def __init__(self, feature: str, offer: Callable[[Sample], None]) -> None:
        self._feature = feature
        self._offer = offer

    def offer(self, sample: Sample) -> None:
        """Pass a sample on."""
        try:
            self._offer(sample)
        except Exception:
            log.exception("watch_failed", feature=self._feature, path=sample.entry.path)


class _Conditions:
    """The conditions of one feature."""

    def __init__(self, feature: str, conditions: Conditions) -> None:
        self._feature = feature
        self._conditions = conditions
        self.holds = conditions.holds
        self.values = conditions.values
        self.resource = conditions.resource

    def use(self, conditions: Iterable[Condition]) -> None:
        """Keep the values of these conditions published."""
        self._conditions.use(f"feature {self._feature}", conditions)


class GatewayRobots:
    """The `Robots` of one feature."""

    def __init__(
        self,
        health: FeatureHealth,
        hub: Hub,
        conditions: Conditions,
        backends: Sequence[SupervisedBackend],
    ) -> None:
        self._health = health
        self._feature = health.name
        self._hub = hub
        self.backends = backends
        self._watches: dict[str, list[_Watch]] = {}
        self.conditions = _Conditions(health.name, conditions)
        self._following = False

    @property
    def entries(self) -> Mapping[str, Entry]:
        """Every resource, by path."""
        return self._hub.registry.entries

    def follow(self, added: Callable[[Entry], None], removed: Callable[[Entry], None]) -> None:
        """Tell of changes of the tree."""
        self._hub.registry.on_added.append(self._contained("follow", added))
        self._hub.registry.on_removed.append(self._contained("follow", removed))

    def follow_state(self, changed: Callable[[], None]) -> None:
        """Tell of changes of state."""
        self._hub.registry.on_state.append(self._contained("follow_state", changed))

    def follow_leases(self, told: Callable[[StopGroup], None]) -> None:
        """Tell of leases at the robots' own gateways."""
        self._hub.registry.on_leases.append(self._contained("follow_leases", told))

    def _contained(self, part: str, callback: Callable[P, None]) -> Callable[P, None]:
        """Keep errors of the feature from whoever changes something: a backend, or an e-stop."""

        def call(*args: P.args, **kwargs: P.kwargs) -> None:
            try:
                callback(*args, **kwargs)
            except Exception as error:
                self._health.failed(part, error)

        return call

    def watch(self, path: str, offer: Callable[[Sample], None]) -> Callable[[], None]:
        """Offer each sample of a path."""
        if not self._following:
            self._following = True
            self._hub.registry.on_added.append(self._added)
        watch = _Watch(self._feature, offer)
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
