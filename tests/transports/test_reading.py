"""A client that takes its replies is read from, whatever came before: two models of the way in.

One drives the peer of a scripted socket and the event loop turn by turn, so that what races in life
happens in every order. The other one does the same over real sockets, as far as these let it.
"""

from __future__ import annotations

import asyncio
import json
from collections import Counter
from collections.abc import Generator
from contextlib import AsyncExitStack
from itertools import count as counting
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule, run_state_machine_as_test

from configuration import backend, configuration, key, listener, table
from rcp_kernel.contract.peer import UNKNOWN
from rcp_kernel.sessions.session import Session
from rcp_kernel.spi import Progress
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Reply
from rcp_web import socket_client
from rcp_ws.client import WsClient
from rcp_ws.config import WsConfig
from transports.raw import TEXT, Raw, frame, opened
from transports.robot import KEY, Site
from transports.scripted_socket import Place, ScriptedSocket

BACKLOG = 40  # replies
TURNS = 60  # of the loop, within which everything has to be answered that can be
NEVER = 1000.0  # s of a turn that is not used up
SPEED = settings(
    deadline=None,
    stateful_step_count=40,
    phases=(Phase.explicit, Phase.generate),  # to shrink a failure takes minutes
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)
OTHERS = "replayed"
USUAL = socket_client._TURN  # noqa: SLF001 - turns are ended without waiting
ROBOT = backend() + key("op", KEY, role="operator")
WITHOUT_SOCKET = configuration()


def replayed(session: Session, count: int) -> None:
    """Let go at once of replies that were held back for a session, as a commit does."""
    for _ in range(count):
        session.deliver(Reply(type="execute", id=OTHERS, path="/tenant/alpha/service/add"))


@pytest.fixture
def place() -> Generator[Place]:
    made = Place()
    yield made
    made.close()
    socket_client._TURN = USUAL  # noqa: SLF001 - see USUAL


class Reading(RuleBasedStateMachine):
    """One client that sends, stalls, takes, is cut off, and comes back."""

    place: Place
    """Set by `run`."""

    def __init__(self) -> None:
        super().__init__()
        socket_client._TURN = NEVER  # noqa: SLF001 - see USUAL
        self.number = 0
        self.asked: set[str] = set()
        """The requests of the present connection."""
        self.hello: dict[str, Any] = {}

    def request(self, **more: Any) -> bytes:
        self.number += 1
        id_ = f"r{self.number}"
        self.asked.add(id_)
        return json.dumps({"type": "ping", "id": id_, **more}).encode()

    def greeting(self, *, segmented: bool) -> bytes:
        body = self.hello | ({"segment_size": 1024} if segmented else {})
        return self.request(type="hello", body=body)

    @property
    def session(self) -> Session:
        return self.place.server.gateway.sessions.known[self.hello["session"]]

    def greeted(self, reply: dict[str, Any]) -> None:
        assert reply["status"] == "completed", reply
        self.hello = {name: reply["body"][name] for name in ("session", "resume_token")}

    @rule(used_up=st.booleans())
    def pace(self, *, used_up: bool) -> None:
        """Have every message use up its turn, or none."""
        socket_client._TURN = -1.0 if used_up else NEVER  # noqa: SLF001 - see USUAL

    @rule(count=st.integers(1, 3 * BACKLOG))
    def commit(self, count: int) -> None:
        """Replies to what was asked before come all at once."""
        with self.place.inside():
            replayed(self.session, count)

    @rule(size=st.sampled_from([10, 5000]))
    def publish(self, size: int) -> None:
        with self.place.inside():
            self.place.robots[0].host.publish("sensor/text", "x" * size)


def answers(told: list[dict[str, Any]], asked: set[str]) -> Counter[str]:
    """Count the replies to some requests."""
    replies = (m for m in told if m["type"] not in ("update", "notice", "segment"))
    return Counter(m["id"] for m in replies if m.get("id") in asked)


class ScriptedReading(Reading):
    """The event loop is a player too: it gets a turn when a rule says so."""

    def turn(self, count: int = 1) -> None:
        async def go() -> None:
            for _ in range(count):
                await asyncio.sleep(0)

        self.place.do(go())

    def connect(self, *, segmented: bool) -> None:
        self.socket = ScriptedSocket(self.place)
        self.asked = set()
        client_api = self.place.server.client_api
        who = (client_api.authenticate(KEY), None)
        config = WsConfig(backlog=BACKLOG)
        with self.place.inside():
            self.socket.attach(
                WsClient(client_api, config, who, Encoding.JSON, self.socket, UNKNOWN)
            )
            self.socket.receiver.opened()
        self.socket.inbound.append(self.greeting(segmented=segmented))
        self.socket.read(1)
        self.turn(2)
        reply = next(m for m in self.socket.replies if m["type"] == "hello")
        self.greeted(reply)

    @initialize(segmented=st.booleans(), used_up=st.booleans())
    def begin(self, *, segmented: bool, used_up: bool) -> None:
        self.pace(used_up=used_up)
        self.connect(segmented=segmented)
        self.socket.inbound.append(self.request(type="subscribe", path="/sensor/text"))

    @rule(count=st.integers(1, 2 * BACKLOG))
    def ask(self, count: int) -> None:
        self.socket.inbound.extend(self.request() for _ in range(count))

    @rule(most=st.integers(1, 2 * BACKLOG), committed=st.sampled_from([0, 1, 2 * BACKLOG]))
    def read(self, most: int, committed: int) -> None:
        """Read, and have what the last requests waited for come in the same turn."""
        self.socket.read(most)
        with self.place.inside():
            replayed(self.session, committed)

    @rule()
    def one_turn(self) -> None:
        self.turn()

    @rule()
    def stall(self) -> None:
        """What was written last is more than the client takes."""
        self.socket.writable = False

    @rule()
    def take(self) -> None:
        self.socket.take()

    @rule()
    def is_not_deaf(self) -> None:
        """Left alone, a client that takes everything is read from."""
        self.turn(TURNS + len(self.asked))  # turns that are used up by one message each
        if self.socket.writable:
            assert self.socket.reading

    @rule()
    def all_is_answered(self) -> None:
        """Once it takes everything, each of its requests has exactly one answer."""
        for _ in range(2):
            self.socket.take()
            self.socket.read(len(self.asked))
            self.turn(TURNS + len(self.asked))
        assert not self.socket.inbound
        assert answers(self.socket.replies, self.asked) == Counter(self.asked)

    def teardown(self) -> None:
        if not hasattr(self, "socket"):
            return
        try:
            self.all_is_answered()
        finally:
            self.socket.lose(1000)
            self.place.server.gateway.sessions.drop(self.session)


class ScriptedReturning(ScriptedReading):
    """The client also loses its connection, and comes back to its session."""

    @property
    def handled(self) -> int:
        return sum(self.place.server.gateway.counts.outcomes.values())

    @rule(segmented=st.booleans(), late=st.integers(0, 3))
    def come_back(self, *, segmented: bool, late: int) -> None:
        """Come back before the gateway has seen the old connection end; something is left in it."""
        old, before = self.socket, self.asked
        late_ids = {f"late{self.number}-{n}" for n in range(late)}
        self.connect(segmented=segmented)
        for id_ in late_ids:
            old.inbound.append(json.dumps({"type": "ping", "id": id_}).encode())
        old.read(len(old.inbound))
        self.turn(3)
        old.take()
        self.turn(3)
        assert old.code == 1008
        assert not answers(old.replies + self.socket.replies, late_ids)
        assert not answers(self.socket.replies, before)
        old.lose(1006)

    @rule(late=st.integers(0, 5))
    def leave(self, late: int) -> None:
        """Nothing is carried out for a client that is gone; it comes back."""
        old, before = self.socket, self.asked
        old.inbound.extend(self.request() for _ in range(late))
        old.read(len(old.inbound))
        old.close(1001)  # what was kept of the client's messages is nobody's any more
        handled = self.handled
        self.turn(TURNS)
        assert self.handled == handled
        old.lose(1006)
        self.connect(segmented=False)
        self.turn(3)
        assert not answers(self.socket.replies, before)


def _reading_of(raw: Raw) -> asyncio.Transport:
    transport = raw.writer.transport
    assert isinstance(transport, asyncio.Transport)
    return transport


class RealReading(Reading):
    """The same over a socket, whose buffers and loop nobody directs."""

    raw: Raw
    _stack: AsyncExitStack

    def connect(self) -> None:
        async def come() -> None:
            self._stack = AsyncExitStack()
            self.raw = await self._stack.enter_async_context(
                opened(Site(self.place.server, self.place.robots), Authorization=f"Bearer {KEY}")
            )

        self.place.do(come())
        self.told: list[dict[str, Any]] = []
        self.asked = set()
        greeting = self.greeting(segmented=False)
        id_ = json.loads(greeting)["id"]
        self.raw.send(frame(TEXT, greeting))
        self.place.do(self.until({id_}))
        self.greeted(next(m for m in self.told if m.get("id") == id_))

    async def until(self, asked: set[str]) -> None:
        """Take what comes until some requests have their replies."""
        _reading_of(self.raw).resume_reading()
        while answers(self.told, asked).keys() != asked:
            opcode, payload = await self.raw.frame()
            if opcode & 0x0F == TEXT:
                self.told.append(json.loads(payload))

    @initialize(used_up=st.booleans())
    def begin(self, *, used_up: bool) -> None:
        self.pace(used_up=used_up)
        self.connect()
        self.raw.send(frame(TEXT, self.request(type="subscribe", path="/sensor/text")))

    @rule(count=st.integers(1, 2 * BACKLOG), committed=st.sampled_from([0, 1, 2 * BACKLOG]))
    def ask(self, count: int, committed: int) -> None:
        """Send in one write; replies are committed at some moment while these are read."""
        self.raw.send(*(frame(TEXT, self.request()) for _ in range(count)))

        async def commit() -> None:
            await asyncio.sleep(0)
            if self.session.connection is not None:
                replayed(self.session, committed)
            await asyncio.sleep(0)

        self.place.do(commit())

    @rule()
    def stall(self) -> None:
        """Take nothing, so that the buffers fill."""
        _reading_of(self.raw).pause_reading()
        self.publish(4_000_000)

    @rule()
    def all_is_answered(self) -> None:
        self.place.do(self.until(self.asked))
        assert answers(self.told, self.asked) == Counter(self.asked)

    @rule()
    def come_back(self) -> None:
        """Cut the connection under whatever is under way."""
        self.raw.writer.transport.abort()
        self.place.do(self._stack.aclose())
        self.connect()

    def teardown(self) -> None:
        if not hasattr(self, "raw"):
            return
        try:
            self.all_is_answered()
        finally:
            self.raw.writer.transport.abort()
            self.place.do(self._stack.aclose())
            self.place.server.gateway.sessions.drop(self.session)


@pytest.mark.parametrize("model", [ScriptedReading, ScriptedReturning])
def test_a_scripted_client_is_read_from_and_answered_once(
    place: Place, model: type[ScriptedReading]
) -> None:
    place.serve(WITHOUT_SOCKET + ROBOT)
    run(model, place, 60)


def run(model: type[Reading], place: Place, examples: int) -> None:
    class Placed(model):  # type: ignore[misc, valid-type] - a class, for it is made afresh each time
        pass

    Placed.place = place
    run_state_machine_as_test(Placed, settings=settings(SPEED, max_examples=examples))


def test_a_client_on_a_socket_is_read_from_and_answered_once(place: Place) -> None:
    sockets = listener() + table("transports.ws", backlog=BACKLOG)
    place.serve(sockets + ROBOT)
    run(RealReading, place, 12)


def test_many_reads_in_one_turn_of_the_loop_are_one_turn_of_the_client(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The loop reads a client that sends much up to 32 times before it looks at the others."""
    place.serve(WITHOUT_SOCKET + ROBOT)
    model = ScriptedReading()
    model.place = place
    model.connect(segmented=False)
    monkeypatch.setattr(socket_client, "_TURN", USUAL)
    clock = counting()  # each message takes a tenth of a millisecond at least
    monkeypatch.setattr(socket_client, "perf_counter", lambda: next(clock) * 0.0001)
    model.ask(32)
    reads = 0
    while model.socket.reading and model.socket.inbound:
        model.socket.read(1)
        reads += 1
    assert reads <= 8
    monkeypatch.undo()
    model.pace(used_up=False)
    model.teardown()  # the rest is answered in the coming turns


def test_a_result_that_comes_at_once_is_in_one_write_with_the_acceptance(place: Place) -> None:
    place.serve(WITHOUT_SOCKET + ROBOT)
    model = ScriptedReading()
    model.place = place
    model.connect(segmented=False)

    async def add(_name: str, value: Any, _progress: Progress) -> Any:
        return value + 1

    place.robots[-1].execute = add  # type: ignore[method-assign] - the scripted one takes a turn of the loop
    writes = list[list[str]]()
    write = model.socket.write

    def noted(messages: list[bytes]) -> None:
        writes.append([json.loads(data)["status"] for data in messages])
        write(messages)

    model.socket.write = noted  # type: ignore[method-assign] - of this socket alone
    ask = model.request(type="execute", path="/service/add", body=1)
    model.socket.inbound.append(ask)
    model.socket.read(1)
    model.turn(TURNS)
    assert writes == [["accepted", "completed"]]
