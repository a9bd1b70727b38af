"""A backend that is not open yet: what it may have is to be asked for again, and is there in the end."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest

from configuration import key, role, rule
from kernel.world import BOUND, CONFIG, Client, NoOptions, Robot, prepared
from rcp_gateway.server import Server, running
from rcp_gateway.testing import SteppedClock
from rcp_kernel.clock import SYSTEM_CLOCK, Clock
from rcp_kernel.config.file import parse
from rcp_kernel.errors import ConfigError, NotReady
from rcp_kernel.spi import BackendKind, Host

pytestmark = pytest.mark.anyio

LEVEL = "/sensor/level"
NARROW = role("narrow", rule("*", "/sensor/level")) + key(
    "narrow", "narrow-narrow-narrow", tenants=["alpha"]
)


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let clients in before any backend is open."""
    monkeypatch.setattr("rcp_gateway.server._FIRST_OPEN", 0.05)


class Gate:
    """How the robot opens: when it is let, or with an error."""

    def __init__(self) -> None:
        self.opens = asyncio.Event()
        self.fate: Exception | None = None
        self.before: Callable[[Host], None] = lambda _: None
        self.host: Host

    @asynccontextmanager
    async def open(self, _config: NoOptions, host: Host) -> AsyncGenerator[Robot]:
        self.host = host
        self.before(host)
        await self.opens.wait()
        if self.fate is not None:
            raise self.fate
        robot = Robot(host)
        robot.declare()
        host.publish("sensor/level", 1.0)
        yield robot


@asynccontextmanager
async def gateway(
    gate: Gate, text: str = CONFIG, clock: Clock = SYSTEM_CLOCK
) -> AsyncGenerator[Server]:
    made = prepared(parse(text + NARROW, "test"), [])
    made.plugins.backends["robot"] = BackendKind("robot", NoOptions, gate.open)
    async with asyncio.timeout(BOUND), running(made, clock=clock) as server:
        try:
            yield server
        finally:
            gate.opens.set()


async def refusal(client: Client, type_: str, path: str = LEVEL) -> tuple[str, bool]:
    error = (await client.ask(type=type_, path=path))["error"]
    return error["code"], error["retryable"]


WAITS, UNKNOWN = ("adapter_unavailable", True), ("unknown_path", False)


async def until(client: Client, type_: str, wanted: tuple[str, bool] | None) -> dict[str, Any]:
    """Ask until the answer is as wanted; None: it is good. Until then it is to be tried again."""
    while True:
        reply = await client.ask(type=type_, path=LEVEL)
        error = reply.get("error")
        answer = error and (error["code"], error["retryable"])
        if answer == wanted:
            return reply
        assert answer == WAITS, reply
        await asyncio.sleep(0.01)


@pytest.mark.usefixtures("at_once")
async def test_while_it_opens_every_operation_is_to_be_tried_again_and_then_works() -> None:
    gate = Gate()
    async with gateway(gate) as server:
        client = Client(server.client_api)
        for type_ in ("read", "write", "execute", "subscribe", "cancel"):
            assert await refusal(client, type_) == WAITS, type_
        assert (await client.ask(type="discover"))["body"]["complete"] is False
        gate.opens.set()
        await until(client, "subscribe", None)
        assert (await client.ask(type="read", path=LEVEL))["body"] == 1.0
        assert "complete" not in (await client.ask(type="discover"))["body"]
        assert await refusal(client, "read", "/sensor/none") == UNKNOWN


@pytest.mark.usefixtures("at_once")
async def test_one_that_is_tried_again_and_again_may_still_come() -> None:
    gate = Gate()
    gate.fate = NotReady("no cable")
    gate.opens.set()
    async with gateway(gate) as server:
        client = Client(server.client_api)
        assert server.supervisors[0].state == "down"
        assert await refusal(client, "subscribe") == WAITS
        gate.fate = None
        await until(client, "subscribe", None)


@pytest.mark.usefixtures("at_once")
async def test_one_that_has_failed_for_good_leaves_its_paths_unknown() -> None:
    gate = Gate()
    gate.fate = ConfigError("no such port")
    async with gateway(gate) as server:
        client = Client(server.client_api)
        assert await refusal(client, "read") == WAITS
        gate.opens.set()
        await until(client, "read", UNKNOWN)
        assert "complete" not in (await client.ask(type="discover"))["body"]


@pytest.mark.usefixtures("at_once")
async def test_what_cannot_be_its_path_is_unknown_meanwhile() -> None:
    gate = Gate()
    text = CONFIG.replace('tenant = "alpha"', 'tenant = "alpha"\nrobot = "r1"', 1)
    async with gateway(gate, text) as server:
        client = Client(server.client_api)
        assert await refusal(client, "read", "/sensor/r1/level") == WAITS
        for path in (LEVEL, "/sensor/r2/level", "/sensor/r1", "/tenant/beta/sensor/r1/level"):
            assert await refusal(client, "read", path) == UNKNOWN, path
        assert (await client.ask(type="discover", path="/**"))["body"]["complete"] is False
        assert "complete" not in (await client.ask(type="discover", path="/system/*"))["body"]


@pytest.mark.usefixtures("at_once")
async def test_a_hidden_path_does_not_tell_that_a_backend_opens() -> None:
    gate = Gate()
    async with gateway(gate) as server:
        client = Client(server.client_api, "narrow-narrow-narrow")
        assert await refusal(client, "read") == WAITS  # it could be seen, if it were there
        assert await refusal(client, "read", "/sensor/lazy") == UNKNOWN
        gate.opens.set()
        await until(client, "read", None)
        assert await refusal(client, "read", "/sensor/lazy") == UNKNOWN


@pytest.mark.usefixtures("at_once")
async def test_what_is_declared_early_can_be_subscribed_to_before_it_is_open() -> None:
    gate = Gate()
    gate.before = lambda host: Robot(host).declare()
    async with gateway(gate) as server:
        client = Client(server.client_api)
        assert (await client.ask(type="subscribe", path=LEVEL, id="s"))["status"] == "completed"
        assert await refusal(client, "read") == WAITS
        gate.opens.set()
        await until(client, "read", None)
        assert (await client.update("s"))["body"] == 1.0


@pytest.mark.usefixtures("at_once")
async def test_an_open_backend_that_still_looks_for_what_it_has_may_find_it() -> None:
    gate = Gate()
    gate.before = lambda host: host.discovering(active=True)
    gate.opens.set()
    async with gateway(gate) as server:
        client = Client(server.client_api)
        await until(client, "read", None)
        assert await refusal(client, "read", "/sensor/found") == WAITS
        gate.host.discovering(active=False)
        assert await refusal(client, "read", "/sensor/found") == UNKNOWN


async def test_one_that_opens_quickly_is_there_though_the_machine_stood_still(
    stepped: SteppedClock,
) -> None:
    gate = Gate()
    gate.before = lambda _: stepped.advance(5.0)
    asyncio.get_running_loop().call_later(0.02, gate.opens.set)
    async with gateway(gate, clock=stepped.clock) as server:
        reply = await Client(server.client_api).ask(type="read", path=LEVEL)
        assert reply.get("body") == 1.0
