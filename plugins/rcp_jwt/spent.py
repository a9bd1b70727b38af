"""Which logins under way were used: their cookies could be shown again."""

from __future__ import annotations

__all__ = ["SpentStates"]

_MOST = 20_000


class SpentStates:
    """Used states for as long as one could be used again; beyond a number, the oldest are forgotten."""

    def __init__(self, lifetime: int) -> None:
        """Keep each for `lifetime` ns."""
        self._lifetime = lifetime
        self._used: dict[str, int] = {}

    def use(self, state: str, moment: int) -> bool:
        """Use a state at a moment; return whether it is the first time."""
        while self._used:
            oldest, used = next(iter(self._used.items()))
            if used + self._lifetime >= moment and len(self._used) < _MOST:
                break
            del self._used[oldest]
        if state in self._used:
            return False
        self._used[state] = moment
        return True
