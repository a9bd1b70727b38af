"""The two ends of a pipe on one Zenoh session: numbers, windows, classes and heartbeats."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager

import pytest

pytest.importorskip("zenoh")

import zenoh

from rcp_gateway.testing import eventually
from rcp_zenoh.budget import Allowance
from rcp_zenoh.lane import PART, WINDOWS, Priority
from rcp_zenoh.path import PathTimes
from rcp_zenoh.pipe import Message, Pipe
from rcp_zenoh.session import configuration, on_loop, opened

_SILENCE = 0.6  # s


class _End:
    """A pipe, what it received, and why it ended."""

    def __init__(self, session: zenoh.Session, ours: str, theirs: str) -> None:
        self.session = session
        self.longest = 1 << 30
        self.messages: list[Message] = []
        self.reasons: list[str] = []
        self.drained_times = 0
        self.lose: Callable[[bytes], bool] = lambda _: False
        loop = asyncio.get_running_loop()
        self._subscriber = session.declare_subscriber(theirs, on_loop(loop, self._take))
        self.pipe = Pipe(session, zenoh.KeyExpr(ours), _SILENCE, self, Allowance())

    @property
    def received(self) -> list[bytes | None]:
        return [message.data for message in self.messages]

    def _take(self, sample: zenoh.Sample) -> None:
        if not self.lose(sample.payload.to_bytes()):
            message = self.pipe.receive(sample)
            if message is not None:
                self.messages.append(message)

    def drained(self) -> None:
        self.drained_times += 1

    def ended(self, why: str) -> None:
        self.reasons.append(why)

    def close(self) -> None:
        self.pipe.end("the test is over")
        self._subscriber.undeclare()


@asynccontextmanager
async def _ends() -> AsyncGenerator[tuple[_End, _End]]:
    async with opened(configuration("router"), patient=False) as session:
        near, far = _End(session, "test/up", "test/down"), _End(session, "test/down", "test/up")
        try:
            yield near, far
        finally:
            near.close()
            far.close()


async def _comes(holds: Callable[[], bool], what: str) -> None:
    async def look() -> bool:
        return holds()

    await eventually(look, what)


async def test_a_lost_message_ends_the_link() -> None:
    async with _ends() as (near, far):
        far.lose = lambda data: data == b"two"
        for data in (b"one", b"two", b"three"):
            near.pipe.send(data, Priority.CONTROL)
        await _comes(lambda: bool(far.reasons and near.reasons), "the loss is noticed")
        assert far.received == [b"one"]
        assert far.reasons == ["messages 2 to 2 were lost on the way"]
        assert far.pipe.lost


@pytest.mark.parametrize("priority", list(Priority))
async def test_the_loss_of_the_last_message_is_found(priority: Priority) -> None:
    async with _ends() as (near, far):
        far.lose = lambda data: data == b"two"
        near.pipe.send(b"one", priority)
        near.pipe.send(b"two", priority)
        await _comes(lambda: bool(far.reasons), "the loss is noticed")
        assert far.received == [b"one"]
        assert far.reasons == ["messages 2 to 2 were lost on the way"]


async def test_an_idle_link_lives_on() -> None:
    async with _ends() as (near, far):
        near.pipe.send(b"one", Priority.CONTROL)
        beats: list[float | None] = []
        near.pipe.on_beat = lambda: beats.append(near.pipe.times.latency)
        await _comes(lambda: len(beats) >= 5, "heartbeats go on")
        assert not near.reasons
        assert not far.reasons
        assert near.pipe.times.latency is not None
        assert near.pipe.buffered == 0


@pytest.mark.parametrize("busy", [True, False])
async def test_a_frozen_link_ends_at_both_ends(*, busy: bool) -> None:
    async with _ends() as (near, far):
        near.pipe.send(b"one", Priority.CONTROL)
        await _comes(lambda: near.pipe.greeted, "the link is in use")
        near.lose = far.lose = lambda _: True
        if busy:
            near.pipe.send(b"two", Priority.CONTROL)
        await _comes(lambda: bool(near.reasons and far.reasons), "both ends notice")
        assert near.reasons[0].startswith("nothing received for")
        assert far.reasons[0].startswith("nothing received for")


async def test_a_stop_overtakes_a_long_message() -> None:
    async with _ends() as (near, far):
        long = bytes(10_000_000)
        near.pipe.send(long, Priority.UPDATES)
        near.pipe.send(b"reply", Priority.CONTROL)
        near.pipe.send(b"stop", Priority.STOP)
        assert near.pipe.parked > len(long) - WINDOWS[Priority.BULK] - PART
        await _comes(lambda: len(far.messages) == 3, "all have arrived")
        assert set(far.received[:2]) == {b"reply", b"stop"}
        assert far.messages[2] == Message(long, len(long), Priority.BULK)
        assert near.pipe.parked == 0


async def test_a_class_that_is_full_holds_up_no_other() -> None:
    async with _ends() as (near, far):
        far.pipe.reading = False
        near.pipe.send(bytes(60_000), Priority.CONTROL)
        while near.pipe.writable(Priority.UPDATES):
            near.pipe.send(bytes(60_000), Priority.UPDATES)
        near.pipe.send(b"stop", Priority.STOP)
        await _comes(lambda: b"stop" in far.received, "the stop has arrived")
        assert near.pipe.writable(Priority.CONTROL)
        assert near.pipe.buffered > WINDOWS[Priority.UPDATES]
        assert not near.drained_times
        far.pipe.reading = True
        far.pipe.acknowledge()
        await _comes(lambda: near.pipe.writable(Priority.UPDATES), "there is room again")
        assert near.drained_times


async def test_a_message_that_is_too_long_is_not_kept() -> None:
    async with _ends() as (near, far):
        far.longest = 100_000
        near.pipe.send(bytes(1_000_000), Priority.CONTROL)
        near.pipe.send(bytes(100_000), Priority.CONTROL)
        await _comes(lambda: len(far.messages) == 2, "both have arrived")
        assert far.messages[0] == Message(None, 1_000_000, Priority.BULK)
        assert far.messages[1].data == bytes(100_000)


async def test_clocks_are_compared_by_the_fastest_of_eight() -> None:
    async with _ends() as (near, far):
        near.pipe.send(b"one", Priority.CONTROL)
        await _comes(lambda: near.pipe.times.offset is not None, "the clocks are compared")
        offset = near.pipe.times.offset
        assert offset is not None
        assert abs(offset[0]) <= offset[1] + 0.001  # it is the same clock
        assert not far.reasons


async def test_what_a_later_version_says_besides_is_no_end() -> None:
    async with _ends() as (near, far):
        near.pipe.send(b"before", Priority.CONTROL)
        await _comes(lambda: far.received == [b"before"], "the message is there")
        session = near.session
        beat = PathTimes().beat((0, 0, 0, 0), idle=False).write()
        for kind, number, data in ((b"x", 9, b"?"), (b"h", 0, beat + b"more"), (b"m", 2, b"after")):
            head = struct.pack("<cBQ", kind, Priority.CONTROL, number) + b"more"
            session.put("test/up", data, attachment=head)
        await _comes(lambda: far.received == [b"before", b"after"], "the other message is there")
        assert far.reasons == []
