"""An e-stop over a link whose other end takes nothing else."""

from __future__ import annotations

import asyncio

import pytest

pytest.importorskip("zenoh")

import msgspec
import zenoh

from ports import free_port
from rcp_gateway.testing import OPERATOR, eventually, serve
from rcp_gateway.testing.wire import ROBOT
from rcp_kernel.config.file import parse
from rcp_zenoh.budget import Allowance
from rcp_zenoh.keys import LinkKeys, alive
from rcp_zenoh.lane import Lane, Priority
from rcp_zenoh.pipe import Message, Pipe
from rcp_zenoh.session import configuration, on_loop, opened
from transports.cable import Cable

_GATEWAY = """
[transports]
asgi = false
http = false
ws = false
sse = false
[transports.zenoh]
gateway = "r7"
tenant = "alpha"
connect = ["tcp/127.0.0.1:{port}"]
[[backends]]
use = "wire-robot"
tenant = "alpha"
[[keys]]
name = "operator"
role = "operator"
key = "{key}"
"""
_READS = 40
_MANY = 300  # robots
_FILL = 400  # messages: more than the buffers of a connection hold
_LONG = 50_000  # bytes of a reply: all of them are more than the window and the kernel's buffers


class _Hub:
    """A hub that can stop acknowledging."""

    longest = 1 << 30

    def __init__(self, session: zenoh.Session) -> None:
        keys = LinkKeys.of("alpha", "r7", "h1", "one")
        loop = asyncio.get_running_loop()
        self.messages: list[Message] = []
        self._subscriber = session.declare_subscriber(keys.down, on_loop(loop, self._take))
        self._token = session.liveliness().declare_token(keys.token)
        self.pipe = Pipe(session, zenoh.KeyExpr(keys.up), 10.0, self, Allowance())

    def send(self, priority: Priority, **envelope: object) -> None:
        self.pipe.send(msgspec.msgpack.encode(envelope), priority)

    def _take(self, sample: zenoh.Sample) -> None:
        message = self.pipe.receive(sample)
        if message is not None:
            self.messages.append(message)

    def got(self, id_: str) -> Priority | None:
        """Return the class of the final reply to a request."""
        for message in self.messages:
            assert message.data is not None
            reply = msgspec.msgpack.decode(message.data)
            if reply.get("id") == id_ and reply.get("status") == "completed":
                return message.priority
        return None

    async def gets(self, id_: str) -> None:
        async def look() -> bool:
            return self.got(id_) is not None

        await eventually(look, f"the reply to {id_} arrives")

    def drained(self) -> None:
        pass

    def ended(self, why: str) -> None:
        self._subscriber.undeclare()
        self._token.undeclare()


def _router() -> tuple[int, zenoh.Config]:
    port = free_port()
    return port, configuration("router", listen=[f"tcp/127.0.0.1:{port}"], silence=60.0)


async def test_no_stop_of_many_at_once_is_dropped_while_the_link_is_held_up() -> None:
    loop, arrived = asyncio.get_running_loop(), list[str]()
    port, router = _router()
    async with opened(router, patient=False) as far, Cable(port).laid() as cable:
        joining = configuration("client", connect=[f"tcp/127.0.0.1:{cable.port}"], silence=60.0)
        async with opened(joining, patient=False) as near:
            subscriber = far.declare_subscriber(
                "stop/*", on_loop(loop, lambda sample: arrived.append(str(sample.key_expr)))
            )
            filled = far.declare_subscriber("fill", on_loop(loop, lambda _: None))
            filling = Lane(near, zenoh.KeyExpr("fill"), Priority.UPDATES)
            keys = [zenoh.KeyExpr(f"stop/{number}") for number in range(_MANY)]
            stops = [Lane(near, key, Priority.STOP) for key in keys]
            ready = Lane(near, zenoh.KeyExpr("stop/ready"), Priority.CONTROL)

            async def known() -> bool:
                ready.put(b"", b"")
                return bool(arrived)

            await eventually(known, "the subscriber is known")
            cable.freeze()
            for _ in range(_FILL):  # what does not fit is dropped
                filling.put(bytes(_LONG), b"")
            for stop in stops:
                stop.put(b"x" * 200, b"")
            cable.mend()

            async def all_there() -> bool:
                return {f"stop/{number}" for number in range(_MANY)} <= set(arrived)

            await eventually(all_there, "every stop arrives")
            subscriber.undeclare()
            filled.undeclare()
            for lane in (filling, ready, *stops):
                lane.close()


async def test_the_reply_to_an_e_stop_waits_for_no_window() -> None:
    port, router = _router()
    text = _GATEWAY.format(port=port, key=OPERATOR)
    async with (
        opened(router, patient=False) as session,
        serve(parse(text, "test"), ROBOT) as served,
    ):
        here = asyncio.Event()
        token = session.liveliness().declare_subscriber(
            alive("alpha", "r7"),
            on_loop(asyncio.get_running_loop(), lambda _: here.set()),
            history=True,
        )
        await here.wait()
        hub = _Hub(session)
        hub.send(Priority.CONTROL, type="hello", id="hello", body={"token": OPERATOR})
        await hub.gets("hello")
        served.life.host.publish("event/note", "x" * _LONG)
        hub.pipe.reading = False
        for number in range(_READS):
            hub.send(Priority.CONTROL, type="read", id=f"r{number}", path="/event/note")
        await hub.gets("r0")
        hub.send(Priority.STOP, type="execute", id="stop", path="/system/estop", body={})
        await hub.gets("stop")
        assert hub.got("stop") is Priority.STOP
        assert hub.got(f"r{_READS - 1}") is None
        hub.pipe.reading = True
        hub.pipe.acknowledge()
        await hub.gets(f"r{_READS - 1}")
        hub.pipe.end("the test is over")
        token.undeclare()
