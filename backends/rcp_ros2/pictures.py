"""Cameras as JPEG: an additional sensor per image sensor, encoded only while subscribed."""

from __future__ import annotations

import threading
from collections.abc import Mapping as Bindings
from functools import partial
from typing import Any

from rcp_kernel.errors import RcpError
from rcp_kernel.model import Resource
from rcp_ros2.binding import Binding, Offer, Shared
from rcp_ros2.cdr import Codec, Value
from rcp_ros2.graph import Graph
from rcp_ros2.idl import load
from rcp_ros2.jpeg import compress, is_here, wrapped
from rcp_ros2.native import native_type
from rcp_ros2.newest import Newest
from rcp_ros2.sensors import Observed
from rcp_ros2.topics import Tap

__all__ = ["Pictures"]

_IMAGE, _COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
_LEAF = "/jpeg"


class Pictures:
    """Provides `<sensor>/jpeg` for each sensor of whole images."""

    def __init__(self, shared: Shared, bindings: Bindings[str, Binding]) -> None:
        self._shared = shared
        self._bindings = bindings
        self._is_here = is_here()

    def find(self, graph: Graph) -> dict[str, Offer]:
        """Return a path for each image sensor."""
        if not self._is_here:
            return {}
        return {
            name + _LEAF: Offer(binding.mapping, partial(Picture, self._shared, binding))
            for name, binding in self._bindings.items()
            if isinstance(binding, Observed) and _is_camera(binding)
        }


def _is_camera(binding: Observed) -> bool:
    whole = binding.mapping.field is None and not binding.resource.live
    return whole and binding.resource.native == _IMAGE


class Picture(Binding):
    """One camera's JPEG; while encoding, only the newest image is queued."""

    def __init__(self, shared: Shared, source: Observed) -> None:
        self._source = source
        self._newest = Newest("ros2 jpeg", self._put)
        self._codec = Codec(load(_COMPRESSED))
        self._lock = threading.Lock()
        self._wanted = False
        self._rate = shared.config.jpeg.rate
        of = source.resource
        resource = Resource(
            name=of.name + _LEAF,
            value=self._codec.type,
            native=_COMPRESSED,
            native_types={"value": native_type(load(_COMPRESSED))},
            description=f"JPEG of {of.name}, at most {self._rate:g} per second.",
            timeout=of.timeout,
            deadline=of.deadline,
            meta={"topic": source.topic, "type": _COMPRESSED},
        )
        super().__init__(shared, resource, source.mapping)

    def watched(self, rate: float) -> None:
        """Subscribe, or change the rate."""
        self._wanted = True
        period = 1 / min(rate, self._rate)
        codec = self._source.codec
        self._source.tap(Tap(self.resource.name, codec, taker=self._newest.take, period=period))

    def unwatched(self) -> None:
        """End the subscription."""
        self._source.untap(self.resource.name)
        with self._lock:  # an image being encoded must not report a problem after this
            self._wanted = False
            self._newest.clear()
            self.shared.complain(self.resource.name, None)

    def close(self) -> None:
        """End the subscription and the thread."""
        self.unwatched()
        self._newest.close()

    async def read(self) -> Any:
        """Return a JPEG of the next image; raises as `measured`."""
        return (await self.measured())[0]

    async def measured(self) -> tuple[Any, int | None]:
        """Return a JPEG of the next image, with the time of the image.

        :raises AdapterUnavailable: no node publishes the topic.
        :raises DeviceTimeout: no image arrived in time.
        :raises DeviceRejected: the image encoding is not supported.
        """
        image = await self._source.following()
        made = await self._newest.apart(self._made, image)
        return made.decode(), self._codec.stamp(made.data)

    def _made(self, image: Value) -> Value:
        jpeg = compress(image.decode(), self.shared.config.jpeg.quality)
        return Value(wrapped(image.data, jpeg), self._codec)

    def _put(self, image: Value) -> None:
        name = self.resource.name
        try:
            made = self._made(image)
        except Exception as error:
            why = error.message if isinstance(error, RcpError) else str(error)
            with self._lock:
                if self._wanted:
                    self.shared.complain(name, f"{name}: {why}")
            return
        self.shared.complain(name, None)
        stamp = self._codec.stamp(made.data)
        self.shared.outbox.put(
            name, made, self.shared.subscriptions.now() if stamp is None else stamp
        )
