"""Sensors of maps and point clouds that are published cropped or decimated, to all who subscribe."""

from __future__ import annotations

import threading
from typing import Any

from rcp_kernel.errors import RcpError
from rcp_kernel.model import Resource
from rcp_ros2.binding import Shared
from rcp_ros2.cdr import Codec, Value
from rcp_ros2.config import Mapping
from rcp_ros2.newest import Newest
from rcp_ros2.reduction import reduction
from rcp_ros2.sensors import Observed
from rcp_ros2.topics import Tap

__all__ = ["Reduced"]


class Reduced(Observed):
    """A map or a cloud; while one is reduced, only the newest one waits."""

    def __init__(
        self, shared: Shared, resource: Resource, mapping: Mapping, message: Any, codec: Codec
    ) -> None:
        """:raises ConfigError: the type cannot be reduced so."""
        self._reduce = reduction(codec.name, mapping.crop, mapping.decimate)
        self._newest = Newest("ros2 reduced", self._put)
        self._lock = threading.Lock()
        self._wanted = False
        super().__init__(shared, resource, mapping, message, codec)

    def watched(self, rate: float) -> None:
        """Subscribe, or change the rate."""
        self._wanted = True
        name, period = self.resource.name, self.period(rate)
        self.tap(Tap(name, self.codec, taker=self._newest.take, period=period))

    def unwatched(self) -> None:
        """End the subscription."""
        self.untap(self.resource.name)
        with self._lock:  # what is being reduced must not report a problem after this
            self._wanted = False
            self._newest.clear()
            self.shared.complain(self.resource.name, None)

    def close(self) -> None:
        """End the subscription and the thread."""
        self.unwatched()
        self._newest.close()

    async def following(self) -> Value:
        """Return the next value, reduced.

        :raises DeviceRejected: it is not of the form that can be.
        """
        return await self._newest.apart(self._made, await super().following())

    def _made(self, value: Value) -> Value:
        return Value(self._reduce(value.data), self.codec)

    def _put(self, value: Value) -> None:
        name = self.resource.name
        try:
            made = self._made(value)
        except Exception as error:
            why = error.message if isinstance(error, RcpError) else str(error)
            with self._lock:
                if self._wanted:
                    self.shared.complain(name, f"{name}: {why}")
            return
        self.shared.complain(name, None)
        stamp = self.codec.stamp(made.data)
        self.shared.outbox.put(
            name, made, self.shared.subscriptions.now() if stamp is None else stamp
        )
