"""Log records of the nodes: `/rosout` as one event."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from rcp_kernel.errors import AdapterUnavailable
from rcp_kernel.model import Resource
from rcp_ros2.binding import Binding, Offer, Shared, common
from rcp_ros2.cdr import Codec, Value
from rcp_ros2.config import Mapping, Qos
from rcp_ros2.graph import Graph
from rcp_ros2.idl import load
from rcp_ros2.native import native_type
from rcp_ros2.topics import Tap

__all__ = ["Log"]

_NAME = "event/log"
_TOPIC = "/rosout"
_DEPTH = 1000  # queue depth in records, the same as in ROS itself
_LEVELS = {"debug": 10, "info": 20, "warn": 30, "error": 40, "fatal": 50}
_LEVEL_AT = 12  # header of the encoding, stamp: the offset of the level

Level = Literal["debug", "info", "warn", "error", "fatal"]


class LogRecord(msgspec.Struct, frozen=True):
    """One record of a node's log."""

    level: Level
    node: str
    text: str
    file: str
    function: str
    line: Annotated[int, Meta(ge=0, extra_json_schema={"unit": "1"})]


class _Records(Codec):
    """Decodes rcl_interfaces/msg/Log."""

    def decode(self, data: bytes) -> LogRecord:
        """Return the record; an unnamed level is reported as the next lower named one."""
        log = super().decode(data)
        level: Any = next((n for n, least in _FALLING if log.level >= least), "debug")
        return LogRecord(level, log.name, log.msg, log.file, log.function, log.line)

    def stamp(self, data: bytes) -> int | None:
        """Return the time of the record, ns since the epoch."""
        second = int.from_bytes(data[4:8], self._order(data))
        nano = int.from_bytes(data[8:12], self._order(data))
        return second * 1_000_000_000 + nano if second > 0 else None

    def _order(self, data: bytes) -> Literal["little", "big"]:
        return "little" if data[1] else "big"


_FALLING = sorted(_LEVELS.items(), key=lambda item: -item[1])


class Log:
    """Finds the log, if it is exposed."""

    def __init__(self, shared: Shared, exposes: Callable[[str], bool]) -> None:
        self._shared = shared
        self._exposed = exposes(_TOPIC)

    def find(self, graph: Graph) -> dict[str, Offer]:
        """Return the event resource."""
        if not self._exposed:
            return {}
        mapping = Mapping(topic=_TOPIC)
        return {_NAME: Offer(mapping, partial(Records, self._shared, mapping))}


class Records(Binding):
    """The log of all nodes, at a level and above."""

    def __init__(self, shared: Shared, mapping: Mapping) -> None:
        cls = load("rcl_interfaces/msg/Log")
        self._least = _LEVELS[shared.config.log.level]
        self._codec = _Records(cls)
        level = shared.config.log.level
        facts = common(
            _NAME,
            mapping,
            f"Log records of the robot's nodes, at level {level} and above.",
            topic=_TOPIC,
            type="rcl_interfaces/msg/Log",
        )
        resource = Resource(
            value=LogRecord,
            live=True,
            native="rcl_interfaces/msg/Log",
            native_types={"value": native_type(cls)},
            **facts,
        )
        super().__init__(shared, resource, mapping)
        tap = Tap(_NAME, self._codec, taker=self._on_record)
        shared.subscriptions.tap(_TOPIC, cls, Qos(depth=_DEPTH), tap)

    def _on_record(self, value: Value) -> None:
        if value.data[_LEVEL_AT] >= self._least:
            self.shared.outbox.put(_NAME, value, self._codec.stamp(value.data))

    async def read(self) -> Any:
        """Raise: no record has come yet, or the kernel would have returned the last one."""
        raise AdapterUnavailable(
            "no node has logged at this level so far",
            remedy="Subscribe to it to receive the next one.",
        )

    def close(self) -> None:
        """End the subscription."""
        self.shared.ros.post(self.shared.subscriptions.untap, _TOPIC, _NAME)
