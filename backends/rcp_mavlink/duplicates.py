"""Whether two vehicles use one system id: then nothing that either reports proves anything of the other."""

from __future__ import annotations

from collections import Counter, deque

__all__ = ["Duplicates"]

_APART = 10.0  # s by which the boots of two vehicles differ at least; frames are late by less
_RETURNS = 2  # a restart changes the time of boot once, and a held-up gateway sees it return once;
# of heartbeats of two kinds, one may have overtaken another
_MEMORY = 10.0  # s for which two vehicles that were seen count
_SILENT = 3.0  # s without a heartbeat of the known kind, after which another one is its own


class Duplicates:
    """Sees a second vehicle by what one vehicle does not do: be two kinds, or two ages, in turn."""

    def __init__(self, kind: tuple[int, int], now: float) -> None:
        """`kind` is the autopilot and the type in its first heartbeat; `now` is monotonic."""
        self._kind, self._heard = kind, now
        self._other: tuple[int, int] | None = None
        """Another kind that was heard since the known one."""
        self._beside: Counter[tuple[int, int]] = Counter()
        """How often the known kind was heard after another: that one is no successor of it."""
        self._boots: dict[str, tuple[float, float | None]] = {}
        """When it was booted by the last frame of each message, and by those of before that changed."""
        self._returns: deque[float] = deque(maxlen=_RETURNS)
        self._seen = float("-inf")

    def is_own(self, kind: tuple[int, int], now: float) -> bool:
        """Return whether a heartbeat is of the known vehicle."""
        if kind != self._kind and (now - self._heard < _SILENT or self._beside[kind] >= _RETURNS):
            self._seen, self._other = now, kind
            return False
        if kind == self._kind and self._other is not None:
            self._beside[self._other] += 1
        self._kind, self._heard, self._other = kind, now, None
        return True

    def take_clock(self, message: str, boot: float, now: float) -> None:
        """See when the sender of a message was booted, in s on the monotonic clock."""
        known, before = self._boots.get(message, (boot, None))
        if abs(boot - known) > _APART:
            if before is not None and abs(boot - before) <= _APART:
                self._returns.append(now)
                if len(self._returns) == _RETURNS and now - self._returns[0] < _MEMORY:
                    self._seen = now
            before = known
        self._boots[message] = (boot, before)

    def seen(self, now: float) -> bool:
        """Return whether a second vehicle was seen lately."""
        return now - self._seen < _MEMORY
