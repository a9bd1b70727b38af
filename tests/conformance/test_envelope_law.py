"""No value outside an envelope reaches a robot, however it is written, sent, repeated or mixed."""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import AsyncGenerator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from functools import partial
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from configuration import backend, key, listener, table
from conformance.wires import HttpClient, WebSocketClient
from rcp_gateway.testing import Client, MemoryClient, ScriptedRobot, scripted, serve
from rcp_kernel.clock import Clock as GatewayClock
from rcp_kernel.config.file import parse
from rcp_kernel.errors import DeviceRejected
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host, Progress
from rcp_kernel.types import Real
from rcp_kernel.values import Encoding

pytestmark = pytest.mark.anyio
RATE, LEAST, MOST, LONGEST = 1.0, -2.0, 2.0, 30.0
AGENT, OPERATOR = "agent-agent-agent", "operator-operator"
CONFIG = (
    table("transports", sse=False)
    + listener()
    + backend(use="recorder")
    + key("agent", AGENT)
    + key("operator", OPERATOR)
    + f"""
[[envelopes]]
name = "speed"
paths = ["/actuator/drive"]
roles = ["agent"]
bounds = {{ "v.x" = {{ min = {LEAST}, max = {MOST} }}, "v.n" = {{ max = 3 }} }}
rate = {{ "v.x" = {RATE} }}

[[envelopes]]
name = "word"
paths = ["/actuator/drive"]
roles = ["agent"]
bounds = {{ "word" = {{ allow = ["go", "come"], optional = true }} }}

[[envelopes]]
name = "several"
paths = ["/param/*", "/service/*"]
bounds = {{ "numbers.*" = {{ min = -1, max = 1 }}, "named.*" = {{ max = 1 }}, "by" = {{ allow = ["agent"] }} }}
roles = ["agent"]

[[envelopes]]
name = "place"
paths = ["/action/line"]
fence = {{ point = ["v.x", "v.y"], inside = {{ hall = [[-2, -2], [2, -2], [2, 2], [-2, 2]] }}, outside = {{ pit = [[0, 0], [1, 0], [1, 1], [0, 1]] }} }}
roles = ["agent"]
"""
)


class Inner(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Numbers that may be anything."""

    x: Real = 0.0  # pyright: ignore[reportInvalidTypeForm]
    y: Real = 0.0  # pyright: ignore[reportInvalidTypeForm]
    n: int = 0


class Value(msgspec.Struct, frozen=True):
    """What is sent; `tag` says how, for the model only."""

    v: Inner = Inner()
    word: str | None = None
    tag: str = ""
    by: str = "agent"


class Several(msgspec.Struct, frozen=True):
    """Several numbers."""

    numbers: list[Real] = []  # pyright: ignore[reportInvalidTypeForm]
    named: dict[str, float] = {}
    tag: str = ""
    by: str = "agent"


RESOURCES = (
    Resource(
        name="actuator/drive",
        description="A drive.",
        value=Value,
        safe=Value(),
        valid_for=LONGEST,
    ),
    Resource(name="param/several", description="Several numbers.", value=Several),
    Resource(name="service/several", description="Several numbers.", input=Several),
    Resource(name="action/line", description="Queues.", input=Value, policy="queue"),
)


def recorder(host: Host, clock: Clock, seen: list[tuple[str, Any, float]]) -> ScriptedRobot:
    """Make a robot that writes down what reaches it and when, and refuses what a tag says."""
    robot = ScriptedRobot(host, *RESOURCES)

    async def take(name: str, value: Any) -> None:
        seen.append((name, value, clock.now))
        if "!" in value.tag:
            raise DeviceRejected("no")

    async def run(name: str, value: Any, _progress: Progress) -> None:
        seen.append((name, value, clock.now))

    for name in ("actuator/drive", "param/several"):
        robot.takes[name] = partial(take, name)
    for name in ("service/several", "action/line"):
        robot.behaviours[name] = partial(run, name)
    return robot


class Clock:
    """Time that the test moves."""

    now = 1000.0


def finite(*numbers: Any) -> bool:
    return all(type(n) in (int, float) and math.isfinite(n) for n in numbers)


class Model:
    """The law, in the plainest words."""

    def __init__(self, start: float) -> None:
        self.past = [(0.0, start, "")]
        self.keys: dict[str, int] = {}

    def check(self, name: str, value: Any, when: float) -> None:
        assert "dry" not in value.tag, "a dry run reached the robot"
        if "key" in value.tag:
            key = value.tag.rpartition("key")[2]
            self.keys[key] = self.keys.get(key, 0) + 1
            assert self.keys[key] == 1, "a repeat reached the robot"
        held = value.by == "agent" and value != Value()
        if held:
            getattr(self, name.rpartition("/")[2])(value, when)
        if name == "actuator/drive" and "!" not in value.tag:
            self.past.append((value.v.x, when, value.by))

    def drive(self, value: Value, when: float) -> None:
        assert finite(value.v.x)
        assert LEAST <= value.v.x <= MOST
        assert value.v.n <= 3
        assert value.word in (None, "go", "come")
        was, since, _ = self.past[-1]
        if finite(was):  # an operator may write what is no number
            assert abs(value.v.x - was) <= RATE * min(when - since, LONGEST)

    def several(self, value: Several, _when: float) -> None:
        assert all(finite(n) and -1 <= n <= 1 for n in value.numbers)
        assert all(finite(n) and n <= 1 for n in value.named.values())

    def line(self, value: Value, _when: float) -> None:
        assert finite(value.v.x, value.v.y)
        assert -2 <= value.v.x <= 2
        assert -2 <= value.v.y <= 2
        assert not (0 <= value.v.x <= 1 and 0 <= value.v.y <= 1)


edges = st.sampled_from(
    [
        0.0,
        -0.0,
        1,
        2,
        -2,
        2.0000001,
        1e308,
        -1e308,
        math.nan,
        math.inf,
        -math.inf,
        "NaN",
        "Infinity",
    ]
)
junk = st.sampled_from(
    [
        "-Infinity",
        "1",
        "-2",
        "9007199254740993",
        "go",
        "",
        None,
        True,
        [],
        {},
        [1],
        2**53 + 1,
        -(2**53) - 1,
        2**63,
        -(2**63),
    ]
)


def mostly(good: st.SearchStrategy[Any], rest: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    return st.sampled_from(range(8)).flatmap(lambda n: rest if n == 7 else good)


numbers = mostly(mostly(st.floats(-2.2, 2.2), edges), junk)
near = mostly(mostly(st.floats(-1.1, 1.1), edges), junk)
inner = mostly(
    st.fixed_dictionaries({"x": numbers}, optional={"y": numbers}),
    st.fixed_dictionaries({}, optional={"x": numbers, "y": numbers, "n": numbers}),
)
extra = {"surplus": numbers}
values = mostly(
    st.fixed_dictionaries({"v": inner}),
    st.fixed_dictionaries(
        {"v": inner | numbers | st.just({"x": 1, "z": 9}) | st.just({"n": 4})},
        optional={"word": st.sampled_from(["go", "come", "stay", None, 7]), **extra},
    ),
)
several = st.fixed_dictionaries(
    {},
    optional={
        "numbers": st.lists(near, max_size=3),
        "named": st.dictionaries(st.sampled_from("abc"), near, max_size=3),
        **extra,
    },
)
commands = st.one_of(
    *[st.tuples(st.just("write"), st.just("/actuator/drive"), values)] * 3,
    st.tuples(st.just("write"), st.just("/param/several"), several),
    st.tuples(st.just("execute"), st.just("/service/several"), several),
    st.tuples(st.just("execute"), st.just("/tenant/alpha/action/line"), values),
)
ways = st.fixed_dictionaries(
    {
        "who": st.sampled_from(["agent", "agent", "agent", "operator"]),
        "encoding": st.sampled_from(list(Encoding)),
        "keyed": st.booleans(),
        "dry": st.sampled_from([False, False, True]),
        "refused": st.sampled_from([False, False, True]),
        "batched": st.booleans(),
        "rest": st.sampled_from([*[False] * 8, True]),
        "back": st.sampled_from([*[False] * 8, True]),
    }
)
steps = st.lists(
    st.tuples(commands, ways, st.floats(0, 1.5), st.booleans()), min_size=4, max_size=16
)
COUNT = itertools.count()


class Bench:
    """A gateway that is up, its robot, and a client for each principal and encoding."""

    def __init__(self, seen: list[tuple[str, Any, float]], clock: Clock) -> None:
        self.seen = seen
        """What has reached the robot, and when."""
        self.clock = clock
        self.model = Model(clock.now)
        self.checked = 0
        self.clients: dict[tuple[str, Encoding], Client] = {}
        self.connect: Callable[[str, Encoding], Awaitable[Client]]
        self.refused = 0

    def envelope(self, command: Any, way: dict[str, Any]) -> list[dict[str, Any]]:
        """Write a command as it is sent, twice if it has a key."""
        type_, path, value = command
        number = next(COUNT)
        tag = "dry" * way["dry"] + "!" * way["refused"] + f"key{number}" * way["keyed"]
        body = {**value, "tag": tag, "by": way["who"]}
        if way["rest"]:
            body = {}
        envelope = {"type": type_, "path": path, "body": body}
        if way["dry"]:
            envelope["dry_run"] = True
        if not way["keyed"] or way["rest"]:
            return [envelope]
        return [{**envelope, "idempotency_key": f"k{number}"}] * 2

    async def send(self, command: Any, way: dict[str, Any]) -> None:
        client = self.clients[way["who"], way["encoding"]]
        envelopes = self.envelope(command, way)
        try:
            if way["batched"]:
                reply = await client.request("batch", body=envelopes)
                replies = reply.get("body", [])
            else:
                ids = [await client.send(envelope) for envelope in envelopes]
                replies = [await client.final(id_) for id_ in ids]
        except (OverflowError, ValueError):
            return  # this encoding has no way to say it
        for reply in replies:
            assert reply.get("error", {}).get("code") != "internal"
            self.refused += reply.get("error", {}).get("code") == "out_of_range"

    async def come_back(self, who: str, encoding: Encoding) -> None:
        """Cut a client's connection and open another."""
        await self.clients[who, encoding].close()
        self.clients[who, encoding] = await self.connect(who, encoding)

    def check(self) -> None:
        for name, value, when in self.seen[self.checked :]:
            self.model.check(name, value, when)
        self.checked = len(self.seen)


@asynccontextmanager
async def running(wire: str) -> AsyncGenerator[Bench]:
    clock = Clock()
    gateway_clock = GatewayClock(monotonic=lambda: clock.now)
    seen: list[tuple[str, Any, float]] = []

    kind = scripted(lambda host: recorder(host, clock, seen), "recorder")
    async with (
        serve(parse(CONFIG, "test"), kind, clock=gateway_clock) as served,
        AsyncExitStack() as stack,
    ):
        bench = Bench(seen, clock)

        async def connect(who: str, encoding: Encoding) -> Client:
            server, token = served.server, AGENT if who == "agent" else OPERATOR
            if wire == "memory":
                client: Client = MemoryClient(server.client_api, token, encoding)
            elif wire == "http":
                client = HttpClient(server, token, encoding)
            else:
                client = await WebSocketClient.connected(server, token, encoding)
            stack.push_async_callback(client.close)
            return client

        bench.connect = connect
        for who, encoding in itertools.product(("agent", "operator"), Encoding):
            bench.clients[who, encoding] = await connect(who, encoding)
        yield bench


@pytest.fixture
async def bench(request: pytest.FixtureRequest) -> AsyncGenerator[Bench]:
    """A gateway over one wire, for one test."""
    async with running(request.param) as made:
        yield made
        assert made.checked > 20, "hardly anything was let through"
        assert made.refused > 20, "hardly anything was refused"


def few(examples: int) -> settings:
    return settings(
        max_examples=examples,
        suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    )


@few(200)
@given(sequence=steps)
@pytest.mark.parametrize("bench", ["memory"], indirect=True)
async def test_nothing_outside_an_envelope_reaches_the_robot(
    bench: Bench, sequence: list[Any]
) -> None:
    await play(bench, sequence)


@few(40)
@given(sequence=steps)
@pytest.mark.parametrize("bench", ["http", "websocket"], indirect=True)
async def test_nothing_outside_an_envelope_reaches_the_robot_over_a_wire(
    bench: Bench, sequence: list[Any]
) -> None:
    await play(bench, sequence)


async def play(bench: Bench, sequence: list[Any]) -> None:
    under_way: list[asyncio.Task[None]] = []
    for command, way, pause, wait in sequence:
        under_way.append(asyncio.create_task(bench.send(command, way)))
        if wait:
            await asyncio.gather(*under_way)
            under_way.clear()
            bench.clock.now += pause
            if way["back"]:
                await bench.come_back(way["who"], way["encoding"])
    await asyncio.gather(*under_way)
    bench.check()
