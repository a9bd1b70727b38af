"""Lost leases: their former holders are refused until they acquire or give up a lease again."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass

from rcp_kernel.features import Scope

__all__ = ["Loss", "Losses"]

_LOSERS = 1000  # holders with remembered losses
_LOSSES = 100  # per holder


@dataclass(slots=True, frozen=True)
class Loss:
    """A lost lease: its id and scope, who took it, and why."""

    lease: str
    scope: Scope
    by: str
    reason: str

    @property
    def message(self) -> str:
        """The error message for the former holder."""
        return f"the lease on {self.scope.text} was lost: {self.reason} (by {self.by})"


class Losses:
    """The losses of each holder that it has not made good or forgone, by lease id."""

    def __init__(self) -> None:
        self._lost: OrderedDict[str, dict[str, Loss]] = OrderedDict()

    def __bool__(self) -> bool:
        """Return whether there is any loss."""
        return bool(self._lost)

    def add(self, key: str, loss: Loss) -> None:
        """Remember a loss; beyond the limits, the oldest are dropped."""
        lost = self._lost.setdefault(key, {})
        lost[loss.lease] = loss
        self._lost.move_to_end(key)
        if len(lost) > _LOSSES:
            del lost[next(iter(lost))]
        if len(self._lost) > _LOSERS:
            self._lost.popitem(last=False)

    def of(self, holders: Iterable[str]) -> list[Loss]:
        """List the losses of some holders."""
        if not self._lost:
            return []
        return [loss for key in holders for loss in self._lost.get(key, {}).values()]

    def clear(self, key: str, scope: Scope) -> None:
        """Forget the losses of a holder that overlap a scope."""
        lost = self._lost.get(key, {})
        for loss in [loss for loss in lost.values() if loss.scope.overlaps(scope)]:
            del lost[loss.lease]
        if not lost:
            self._lost.pop(key, None)
