"""When and for how long to stop the robots: the guard's decisions, without clocks or sockets."""

from __future__ import annotations

from collections.abc import Iterable

__all__ = ["Watch"]

_HEALTHY = 3  # consecutive heartbeats in time after which the gateway is trusted again
_LEAST = 1.0  # s that stops are sent at least, if the guard is told to end meanwhile


class Watch:
    """Follows the gateway's heartbeats; times are seconds of any monotonic clock."""

    def __init__(self, after: float, bound: float, now: float) -> None:
        self._after = after
        self._bound = bound
        self._last = now
        self._good = 0
        self._since = now
        self._spent = False
        self._end = False
        self.armed: frozenset[str] = frozenset()
        """The groups that may move."""
        self.stopping: frozenset[str] = frozenset()
        """The groups being stopped."""
        self.reason = ""
        """Why they are being stopped, or why no longer."""
        self.lost = False
        """Whether the gateway is gone without a goodbye."""
        self.over = False
        """Whether the guard can end."""

    def hear(self, now: float, armed: Iterable[str] | None = None) -> None:
        """Handle a heartbeat."""
        in_time = now - self._last <= self._after
        self._good = self._good + 1 if in_time else 1
        self._last = now
        self._spent = False
        if armed is not None:
            self.armed = frozenset(armed)

    def lose(self, now: float) -> None:
        """Handle a gateway that is gone without a goodbye."""
        if self.lost:
            return
        self.lost = True
        if self.armed and not self._spent:
            self._stop(now, "the gateway ended unexpectedly")

    def trusts(self, now: float) -> bool:
        """Return whether heartbeats arrive, and have for a while."""
        return not self.lost and self._good >= _HEALTHY and now - self._last <= self._after

    def may_yield(self, now: float) -> bool:
        """Return whether the stop was sent long enough to leave the robot to another guard."""
        return self.lost and now - self._since >= _LEAST

    def end(self) -> None:
        """Handle a request to end: soon, once the gateway is gone."""
        self._end = True

    def judge(self, now: float) -> float:
        """Decide what to send now; return the seconds until the next decision."""
        if self.stopping:
            self._judge_stopping(now)
        elif self.armed and not self._spent and now - self._last > self._after:
            self._stop(now, f"no heartbeat for {now - self._last:.2f} s")
        if self.lost and not self.stopping:
            self.over = True
        if self.stopping or not self.armed:
            return self._after / 5
        return max(0.001, self._last + self._after - now + 0.001)

    def _judge_stopping(self, now: float) -> None:
        sent = now - self._since
        if not self.lost and self._good >= _HEALTHY:
            self._release("the gateway's heartbeat has returned")
        elif sent >= self._bound or (self._end and self.may_yield(now)):
            self._spent = True
            self._release(f"the stop was sent for {sent:.1f} s")

    def _stop(self, now: float, reason: str) -> None:
        if not self.stopping:
            self._since = now
        self.stopping, self.reason, self._good = self.stopping | self.armed, reason, 0

    def _release(self, reason: str) -> None:
        self.stopping, self.reason = frozenset(), reason
