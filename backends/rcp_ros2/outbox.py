"""Transfer from the ROS thread to the event loop: a bounded queue per name, batched wake-ups."""

from __future__ import annotations

import contextlib
from collections import deque
from typing import Any

from rcp_kernel.spi import Host
from rcp_ros2.cdr import Value

__all__ = ["Outbox"]

_DEPTH = 256  # queued values per name
_FEW = 4  # queued values per name if they are large
_BIG = 65_536  # bytes


class Outbox:
    """Queued values; if the event loop is late, the oldest of a name are dropped."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._queues: dict[str, deque[tuple[Value, int | None]]] = {}
        self._woken = False
        self.dropped = 0
        """Number of dropped values."""

    def put(self, name: str, value: Value, timestamp: int | None) -> None:
        """Queue a value; called in the ROS thread."""
        queue = self._queues.get(name)
        if queue is None:
            queue = self._queues[name] = deque()
        if len(queue) >= (_FEW if len(value.data) > _BIG else _DEPTH):
            queue.popleft()
            self.dropped += 1
        queue.append((value, timestamp))
        if not self._woken:
            self._woken = True
            with contextlib.suppress(RuntimeError):  # the event loop is closed
                self._host.call_soon(self._drain)

    def _drain(self) -> None:
        self._woken = False  # before the queues are emptied, so that new values wake the loop again
        publish: Any = self._host.publish
        for name, queue in list(self._queues.items()):
            while queue:
                value, timestamp = queue.popleft()
                publish(name, value, timestamp)

    def forget(self, name: str) -> None:
        """Drop the queued values of a name; called on the event loop."""
        self._queues.pop(name, None)
