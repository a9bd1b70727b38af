"""Receivers of the same bytes share their making, and nothing of each other's fate."""

from __future__ import annotations

import asyncio
import json
from typing import Any, Self

import pytest

from kernel.world import World
from rcp_kernel.model import Resource
from rcp_kernel.sessions.outbox import BUDGET
from rcp_kernel.tree.samples import Rendering, Sample
from rcp_kernel.values import Encoding
from rcp_streams.shared_fanout import SharedFanout

pytestmark = pytest.mark.anyio
LEVEL = "/tenant/alpha/sensor/level"
STEADY = "/tenant/alpha/sensor/steady"


class Socket:
    """A transport that frames messages and takes them only when it is told to."""

    def __init__(
        self,
        world: World,
        depth: int,
        id_: str = "s",
        path: str = LEVEL,
        rendering: Rendering | None = None,
        **body: Any,
    ) -> None:
        client_api = world.server.client_api
        self._flushed = asyncio.Event()
        self.connection = client_api.connect(
            client_api.authenticate(None), Encoding.JSON, self._ready
        )
        self.connection.outbox.framing = lambda size, _text: b"%04d" % size
        self.connection.outbox.render(id_, rendering)
        envelope = {
            "type": "subscribe",
            "id": id_,
            "path": path,
            "body": {"qos": {"depth": depth}, **body},
        }
        self.connection.receive(json.dumps(envelope).encode())

    @classmethod
    async def open(cls, world: World, depth: int, **facts: Any) -> Self:
        """Subscribe, and wait for the reply: requests wait where their principal's share is used up."""
        socket = cls(world, depth, **facts)
        async with asyncio.timeout(60):
            while not any(message["type"] == "subscribe" for message in socket.take()):
                await socket._flushed.wait()
                socket._flushed.clear()
        return socket

    def _ready(self) -> None:
        self._flushed.set()

    def take(self) -> list[Any]:
        """Collect what waits, and cut it where the frames say."""
        return _cut(b"".join(self.connection.outbox.collect()))


def _cut(data: bytes) -> list[Any]:
    out: list[Any] = []
    while data:
        size = int(data[:4])
        out.append(json.loads(data[4 : 4 + size]))
        data = data[4 + size :]
    return out


def publish(world: World, *values: float, name: str = "sensor/level") -> None:
    for value in values:
        world.robot.host.publish(name, value)


async def test_receivers_of_the_same_bytes_are_served_from_one_ring(world: World) -> None:
    sockets = [await Socket.open(world, 8) for _ in range(3)]
    listeners = world.server.gateway.registry.entries[LEVEL].listeners
    assert [type(listener) for listener in listeners] == [SharedFanout]
    publish(world, 1.0, 2.0)
    taken = [socket.take() for socket in sockets]
    assert [m["body"] for m in taken[0]] == [1.0, 2.0]
    assert taken[0] == taken[1] == taken[2]


async def test_one_that_falls_behind_skips_alone_and_is_told(world: World) -> None:
    quick, slow = await Socket.open(world, 4), await Socket.open(world, 4)
    seen: list[float] = []
    for value in range(10):
        publish(world, float(value))
        seen += [m["body"] for m in quick.take()]
    assert seen == [float(value) for value in range(10)]
    late = slow.take()
    assert [m["body"] for m in late] == [6.0, 7.0, 8.0, 9.0]
    assert [m.get("dropped") for m in late] == [6, None, None, None]
    publish(world, 10.0)
    assert slow.take() == quick.take()


async def test_a_newcomer_hears_only_what_comes_after_it(world: World) -> None:
    first = await Socket.open(world, 8)
    publish(world, 1.0)
    second = await Socket.open(world, 8)
    publish(world, 2.0)
    assert [m["body"] for m in first.take()] == [1.0, 2.0]
    assert [m["body"] for m in second.take()] == [2.0]


async def test_those_who_leave_are_forgotten(world: World) -> None:
    sockets = [await Socket.open(world, 8) for _ in range(2)]
    listeners = world.server.gateway.registry.entries[LEVEL].listeners
    sockets[0].connection.close()
    publish(world, 1.0)
    assert [m["body"] for m in sockets[1].take()] == [1.0]
    sockets[1].connection.close()
    assert listeners == []


async def test_a_bad_value_is_left_out_for_all(world: World) -> None:
    sockets = [await Socket.open(world, 8) for _ in range(2)]
    publish(world, 1.0, float("nan"), 2.0)
    assert [[m["body"] for m in socket.take()] for socket in sockets] == [[1.0, 2.0]] * 2


class Direct(Socket):
    """A transport that takes frames at once, unless its socket is full."""

    def __init__(self, world: World, depth: int, **body: Any) -> None:
        super().__init__(world, depth, **body)
        self.got: list[bytes] = []
        self.full = False
        self.unread = 0

    @classmethod
    async def open(cls, world: World, depth: int, **facts: Any) -> Self:
        """Subscribe, and take frames at once from then on."""
        socket = await super().open(world, depth, **facts)
        socket.connection.outbox.direct = socket.pass_on
        return socket

    def pass_on(self, parts: list[bytes]) -> int | None:
        if self.full:
            return None
        self.got += parts
        return self.unread

    def bodies(self) -> list[float]:
        """Take apart what was passed on."""
        data, self.got = b"".join(self.got), []
        return [message["body"] for message in _cut(data)]


async def turn() -> None:
    """Let a tick pass."""
    for _ in range(2):
        await asyncio.sleep(0)


async def test_who_takes_frames_at_once_need_not_collect_them(world: World) -> None:
    sockets = [await Direct.open(world, 8) for _ in range(3)]
    publish(world, 1.0, 2.0)
    await turn()
    publish(world, 3.0)
    await turn()
    assert [socket.bodies() for socket in sockets] == [[1.0, 2.0, 3.0]] * 3
    assert [socket.take() for socket in sockets] == [[], [], []]


async def test_a_full_socket_is_passed_nothing_before_it_has_collected(world: World) -> None:
    full, other = await Direct.open(world, 4), await Direct.open(world, 4)
    full.full = True
    publish(world, 1.0)
    await turn()
    full.full = False
    publish(world, 2.0)
    await turn()
    assert full.got == []
    assert [m["body"] for m in full.take()] == [1.0, 2.0]
    publish(world, 3.0)
    await turn()
    assert full.bodies() == [3.0]
    assert other.bodies() == [1.0, 2.0, 3.0]


LONG = 2 * BUDGET  # bytes


async def opened_for_long(world: World, count: int) -> list[Direct]:
    """Subscribe some clients to samples that are longer than what is sent at once otherwise."""
    world.robot.add(Resource(name="sensor/steady", description="A level.", value=float, live=True))
    rendering = Rendering(b"", lambda sample: b"%d" % sample.value * LONG)
    return [
        await Direct.open(world, 4, path=STEADY, rendering=rendering, id_=f"s{number}")
        for number in range(count)
    ]


async def test_a_long_sample_is_passed_on_uncopied_and_what_nobody_has_read_of_it_counts(
    world: World,
) -> None:
    slow, quick = await opened_for_long(world, 2)
    slow.unread = LONG // 2
    publish(world, 1.0, name="sensor/steady")
    await turn()
    assert b"".join(slow.got) == b"%d" % LONG + b"1" * LONG
    assert slow.connection.outbox.buffered == LONG // 2
    # Whoever comes after a long time, on a busy machine, has it in the next tick.
    assert (quick.got or quick.connection.outbox.collect())[-1] is slow.got[-1]
    assert quick.connection.outbox.buffered == 0


async def test_a_long_sample_waits_while_others_leave_too_much_unread(world: World) -> None:
    waiting, greedy = await opened_for_long(world, 2)
    greedy.full = True
    greedy.connection.outbox.hand(1 << 40)
    publish(world, 1.0, 2.0, name="sensor/steady")
    publish(world, 3.0, name="sensor/steady")
    await turn()
    assert waiting.got == []
    assert waiting.connection.outbox.collect() == []
    greedy.connection.outbox.hand(0)
    assert waiting.connection.outbox.collect()[-1][:1] == b"1"


async def test_several_long_samples_are_not_passed_on_in_one_write(world: World) -> None:
    (socket,) = await opened_for_long(world, 1)
    publish(world, 1.0, 2.0, name="sensor/steady")
    await turn()
    assert socket.got == []
    collected = [socket.connection.outbox.collect()[-1][:1] for _ in range(2)]
    assert collected == [b"1", b"2"]


async def test_replies_that_wait_go_out_before_what_is_published_later(world: World) -> None:
    socket = await Direct.open(world, 4)
    socket.connection.receive(b'{"type":"ping","id":"p"}')
    publish(world, 1.0)
    await turn()
    assert socket.got == []
    assert [m["type"] for m in socket.take()] == ["ping", "update"]


async def test_what_a_backend_publishes_in_one_call_goes_out_at_its_end(world: World) -> None:
    socket = await Direct.open(world, 8)
    found: asyncio.Future[list[float]] = asyncio.get_running_loop().create_future()

    def both() -> None:
        asyncio.get_running_loop().call_soon(lambda: found.set_result(socket.bodies()))
        publish(world, 1.0, 2.0)

    world.robot.host.call_soon(both)
    assert await found == [1.0, 2.0]


class Frame:
    """A value in a form of its robot's own."""

    def __init__(self, data: bytes) -> None:
        self.data = data

    def decode(self) -> str:
        return self.data.decode()


async def test_native_bytes_are_shared_too_and_named_once(world: World) -> None:
    world.robot.add(
        Resource(name="sensor/frame", description="A frame.", value=str, native="frame", live=True)
    )
    path = "/tenant/alpha/sensor/frame"
    sockets = [await Direct.open(world, 2, path=path, encoding="native") for _ in range(2)]

    async def told(*data: bytes) -> list[list[dict[str, Any]]]:
        for one in data:
            world.robot.host.publish("sensor/frame", Frame(one))
        await turn()
        return [socket.take() or _cut(b"".join(socket.got)) for socket in sockets]

    first, second = (one for (one,) in await told(b"one"))
    assert first == second
    assert (first["encoding"], first["native_type"], first["body"]) == ("native", "frame", "b25l")
    again = await told(b"two")
    assert again[0] == again[1]
    assert [(m["body"], m["encoding"], m.get("native_type")) for m in again[0]] == [
        ("dHdv", "native", None)
    ]
    for socket in sockets:
        socket.got.clear()
    behind = await told(b"1", b"2", b"3")
    assert [(m["body"], m.get("dropped")) for m in behind[0]] == [("Mg==", 1), ("Mw==", None)]


def _tail(sample: Sample) -> bytes:
    return b"%d" % sample.value


async def written(world: World, depth: int, write_interval: float) -> asyncio.Queue[bytes]:
    """Subscribe with an interval of writes; return the queue of what is written directly."""
    if STEADY not in world.server.gateway.registry.entries:
        # Without a deadline: a notice that the path is stale would wait to be collected first.
        world.robot.add(
            Resource(name="sensor/steady", description="A level.", value=float, live=True)
        )
    rendering = Rendering(b"", _tail, write_interval=write_interval)
    socket = await Socket.open(world, depth, path=STEADY, rendering=rendering)
    writes: asyncio.Queue[bytes] = asyncio.Queue()

    def direct(parts: list[bytes]) -> int:
        writes.put_nowait(b"".join(parts))
        return 0

    framing = socket.connection.outbox.framing
    assert framing is not None
    socket.connection.outbox.send_frames(framing, direct)
    return writes


async def test_updates_within_the_interval_of_writes_share_one(world: World) -> None:
    writes = await written(world, 16, 1.0)
    publish(world, 1.0, name="sensor/steady")
    async with asyncio.timeout(60):
        assert await writes.get() == b"00011"  # none before it: at once
        publish(world, 2.0, name="sensor/steady")
        await asyncio.sleep(0)
        publish(world, 3.0, name="sensor/steady")
        await asyncio.sleep(0)
        assert writes.empty()
        assert await writes.get() == b"0001200013"


async def test_the_first_update_does_not_wait_on_a_machine_that_has_just_booted(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcp_streams.shared_fanout.perf_counter", lambda: 0.5)
    writes = await written(world, 16, 3600)
    publish(world, 1.0, name="sensor/steady")
    async with asyncio.timeout(60):
        assert await writes.get() == b"00011"


async def test_half_a_queue_does_not_wait_for_the_interval(world: World) -> None:
    writes = await written(world, 4, 3600)
    async with asyncio.timeout(60):
        publish(world, 1.0, name="sensor/steady")
        assert await writes.get() == b"00011"
        for value in (2.0, 3.0, 4.0):
            publish(world, value, name="sensor/steady")
        assert await writes.get() == b"000120001300014"


async def test_a_queue_of_one_does_not_wait_at_all(world: World) -> None:
    writes = await written(world, 1, 3600)
    async with asyncio.timeout(60):
        for value in (1.0, 2.0):
            publish(world, value, name="sensor/steady")
            assert await writes.get() == b"0001%d" % value


async def test_one_who_leaves_meanwhile_misses_nothing_of_others(world: World) -> None:
    leaving = await written(world, 16, 1.0)
    staying = await written(world, 16, 1.0)
    publish(world, 1.0, name="sensor/steady")
    async with asyncio.timeout(60):
        assert await leaving.get() == await staying.get() == b"00011"
        publish(world, 2.0, name="sensor/steady")
        entry = world.server.gateway.registry.entries[STEADY]
        (fanout,) = entry.listeners
        assert isinstance(fanout, SharedFanout)
        fanout.members[0].unlisten()
        assert await staying.get() == b"00012"
    assert leaving.empty()
