"""A robot's values as they pass a hub: encoded as they came, with the robot's own numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import msgspec

from rcp_client.channel import Channel
from rcp_client.messages import Message
from rcp_client.subscription import Subscription
from rcp_kernel.clock import parse_time
from rcp_kernel.values import Encoding

__all__ = ["RobotFeed", "RobotNumbers", "RobotValue", "undecoded_update"]

_UPDATE = b"\xa4type\xa6update"
_BURST = 8  # samples published at once


class RobotValue(msgspec.Struct, frozen=True, gc=False):
    """A value as the robot's gateway encoded it: the kernel's `Encoded`."""

    data: bytes
    seq: int
    timestamp: int
    encoding: ClassVar[Encoding] = Encoding.MSGPACK

    def decode(self) -> Any:
        """Return the plain value: the robot's gateway has validated it."""
        return msgspec.msgpack.decode(self.data)


class RobotNumbers:
    """The numbers of the samples of one gateway, which begin anew when it restarts."""

    def __init__(self) -> None:
        self._known: dict[str, tuple[int, int, int]] = {}
        """By name: the last number and time of the robot, and what is added to its numbers."""

    def restarted(self) -> None:
        """Note that the gateway may have restarted, with whatever time its clock has now."""
        self._known = {name: (last, -1, shift) for name, (last, _, shift) in self._known.items()}

    def of(self, name: str, seq: int, timestamp: int) -> int:
        """Return the number that a sample has here: the robot's own until it restarts."""
        last, time, shift = self._known.get(name, (0, 0, 0))
        if seq <= last:
            if timestamp <= time:  # the same sample again, or an earlier one
                return seq + shift
            shift += last + 1 - seq
        self._known[name] = (seq, timestamp, shift)
        return seq + shift


class RobotFeed(Subscription):
    """A subscription whose updates are published as they arrive; iterate over it for its end."""

    def __init__(
        self,
        channel: Channel,
        path: str,
        rate: float | None,
        publish: Callable[[bytes, int, int], None],
        *,
        frame: str | None = None,
    ) -> None:
        # A burst on an idle link is passed on whole; on a slow one only events are.
        qos = {"reliability": "reliable"} if "/event/" in path else {"depth": _BURST}
        super().__init__(channel, (path,), {"rate": rate, "qos": qos, "frame": frame})
        self._publish = publish

    def take(self, message: Message) -> None:
        """Publish an update, whose body is not decoded."""
        path, seq = message.path or "", message.seq or 0
        if seq <= self.seen.get(path, 0):
            self.duplicates += 1
            return
        self.seen[path] = seq
        if not message.truncated:
            self._publish(bytes(message.body), seq, parse_time(message.timestamp or ""))


class _Undecoded(Message, kw_only=True):
    body: msgspec.Raw = msgspec.Raw(b"\xc0")


_undecoded = msgspec.msgpack.Decoder(_Undecoded)


def undecoded_update(data: bytes) -> Message | None:
    """Decode an update of a robot's gateway, but not the value in it; None: it is none."""
    return _undecoded.decode(data) if data.startswith(_UPDATE, 1) else None
