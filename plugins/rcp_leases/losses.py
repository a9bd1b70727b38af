"""Leases that were lost: who lost one is refused there until it has acquired again or gone on."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass

from rcp_kernel.features import Scope

__all__ = ["Loss", "Losses"]

_LOSERS = 1000  # holders whose losses are remembered
_LOSSES = 100  # of one of them


@dataclass(slots=True, frozen=True)
class Loss:
    """Which lease was lost, to whom, and why."""

    lease: str
    scope: Scope
    by: str
    reason: str

    @property
    def told(self) -> str:
        """Say it to the loser."""
        return f"the lease on {self.scope.text} was lost: {self.reason} (by {self.by})"


class Losses:
    """What each holder has lost and not asked for again, by lease."""

    def __init__(self) -> None:
        self._lost: OrderedDict[str, dict[str, Loss]] = OrderedDict()

    def __bool__(self) -> bool:
        """Tell whether anybody has lost anything."""
        return bool(self._lost)

    def add(self, key: str, loss: Loss) -> None:
        """Remember a loss; the oldest are forgotten."""
        lost = self._lost.setdefault(key, {})
        lost[loss.lease] = loss
        self._lost.move_to_end(key)
        if len(lost) > _LOSSES:
            del lost[next(iter(lost))]
        if len(self._lost) > _LOSERS:
            self._lost.popitem(last=False)

    def of(self, holders: Iterable[str]) -> list[Loss]:
        """List what some holders have lost."""
        if not self._lost:
            return []
        return [loss for key in holders for loss in self._lost.get(key, {}).values()]

    def forgive(self, key: str, scope: Scope) -> None:
        """Forget what a holder has lost that shares something with a scope."""
        lost = self._lost.get(key, {})
        for loss in [one for one in lost.values() if one.scope.overlaps(scope)]:
            del lost[loss.lease]
        if not lost:
            self._lost.pop(key, None)
