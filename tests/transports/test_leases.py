"""Leases of those who have no connection, beside those who have one; who loses one is told."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator
from contextlib import AsyncExitStack, aclosing
from typing import Any, TypeVar

import httpx
import msgspec
import pytest

from conformance.wires import BASE, LISTENER, HttpClient, SseClient, WebSocketClient
from rcp_gateway.server import Server
from rcp_gateway.testing import OPERATOR, Client, Message, serve
from rcp_gateway.testing.wire import DEAD, ROBOT, configuration
from rcp_gateway.testing.wire._robot import WireRobot
from rcp_kernel.config.file import GatewayConfig, KeyConfig
from rcp_kernel.values import Encoding
from transports.robot import until

pytestmark = pytest.mark.anyio
BOUND = 60.0  # s a whole test may take
C = TypeVar("C", bound=Client)
AGENT = "agent-of-this-test"
LEVEL = "/tenant/alpha/sensor/level"
TRANSPORTS: dict[str, dict[str, object]] = {"asgi": LISTENER, "http": {}, "ws": {}, "sse": {}}


def config(role: str = "agent") -> GatewayConfig:
    made = configuration(TRANSPORTS)
    keys = (*made.keys, KeyConfig(name="agent", role=role, key=AGENT))
    return msgspec.structs.replace(made, keys=keys)


class Clients:
    """Clients of one gateway, which are let go of in the end."""

    def __init__(self, server: Server, stack: AsyncExitStack) -> None:
        self._server = server
        self._stack = stack

    @property
    def robot(self) -> WireRobot:
        """The robot of tenant alpha."""
        backend = getattr(self._server.supervisors[0].backend, "inner", None)
        assert isinstance(backend, WireRobot)
        return backend

    @property
    def connected(self) -> bool:
        """Whether anybody has a connection."""
        known = self._server.gateway.sessions.known
        return any(one.connection is not None for one in known.values())

    def reconfigure(self, to: GatewayConfig) -> None:
        """Change the rules of the running gateway."""
        self._server.gateway.reconfigure(to)

    def _kept(self, client: C) -> C:
        self._stack.push_async_callback(client.close)
        return client

    def http(self, token: str) -> HttpClient:
        """Return who asks by single requests."""
        return self._kept(HttpClient(self._server, token, Encoding.JSON))

    async def listener(self, token: str) -> Client:
        """Return who listens to a stream of events and asks by single requests."""
        made = self._kept(SseClient(self._server, token, Encoding.JSON))
        await made.subscribe(LEVEL)
        return made

    async def websocket(self, token: str) -> Client:
        """Return who has a connection, and is greeted."""
        made = self._kept(await WebSocketClient.connected(self._server, token, Encoding.JSON))
        assert code(await made.request("hello")) == "completed"
        return made


@pytest.fixture
async def clients() -> AsyncGenerator[Clients]:
    async with (
        serve(config(), ROBOT, DEAD) as served,
        AsyncExitStack() as stack,
        asyncio.timeout(BOUND),
    ):
        yield Clients(served.server, stack)


async def lease(client: Client, do: str = "acquire", **fields: Any) -> Message:
    if "lease" not in fields:
        fields.setdefault("scope", "/tenant/alpha/actuator")
    return await client.request("execute", "/system/leases", body={"do": do, **fields})


async def drive(client: Client) -> str:
    return code(await client.request("write", "/actuator/drive", body={"linear": {"x": 0.5}}))


async def limit(client: Client) -> str:
    return code(await client.request("write", "/param/limit", body=1.0))


def code(reply: Message) -> str:
    return reply.get("error", {}).get("code", reply["status"])


async def test_single_requests_of_a_key_hold_renew_and_release_a_part_of_the_tree(
    clients: Clients,
) -> None:
    holder, other = clients.http(OPERATOR), await clients.websocket(AGENT)
    held = (await lease(holder, ttl=30, reason="mapping"))["body"]
    assert (held["holder"], held["session"], held["reason"]) == ("operator", None, "mapping")
    assert await drive(holder) == "completed"
    assert await drive(other) == "lease_held"
    assert await limit(other) == "completed"  # beside the sub-tree
    refused = await holder.http.put(f"{BASE}/context/actuator/drive", json={})
    assert refused.status_code == 200
    by_hand = await holder.http.post(
        f"{BASE}/context/system/leases",
        json={"do": "renew", "lease": held["lease"], "ttl": 60},
    )
    assert by_hand.status_code == 200
    assert by_hand.json()["body"]["expires"] > held["expires"]
    seen = (await other.request("read", "/system/leases"))["body"]
    assert [one["lease"] for one in seen] == [held["lease"]]

    elsewhere = await clients.websocket(OPERATOR)  # the key's lease is that of all its sessions
    assert await drive(elsewhere) == "completed"
    assert code(await lease(elsewhere, "release", lease=held["lease"])) == "completed"
    assert code(await lease(holder, "renew", lease=held["lease"])) == "lease_required"
    assert await drive(other) == "completed"


async def test_http_says_who_holds_it_and_when_to_come_back(clients: Clients) -> None:
    assert code(await lease(clients.http(OPERATOR))) == "completed"
    agent = clients.http(AGENT).http
    refused = await agent.put(f"{BASE}/context/actuator/drive", json={"linear": {"x": 0.5}})
    assert refused.status_code == 423
    error = refused.json()["error"]
    assert (error["code"], error["details"]["holder"]) == ("lease_held", "operator")
    assert 0 < error["retry_after"] <= 10
    assert int(refused.headers["retry-after"]) <= 10


async def test_all_who_act_by_a_key_are_told_when_its_lease_is_taken(clients: Clients) -> None:
    agent, stream = await clients.websocket(AGENT), await clients.listener(AGENT)
    single = clients.http(AGENT)
    held = (await lease(single))["body"]
    person = clients.http(OPERATOR)
    assert code(await lease(person)) == "lease_held"
    assert code(await lease(person, take=True, reason="by hand")) == "completed"
    for loser in (agent, stream):
        told = await loser.notice("lease_lost")
        assert (told["lease"], told["scope"]) == (held["lease"], held["scope"])
        assert (told["by"], told["reason"]) == ("operator", "by hand")
        assert await drive(loser) == "lease_lost"
    assert await drive(single) == "lease_lost"
    assert await drive(person) == "completed"


async def test_a_session_loses_its_lease_to_single_requests_and_is_told(clients: Clients) -> None:
    agent, other = await clients.websocket(AGENT), clients.http(AGENT)
    assert code(await lease(agent)) == "completed"
    assert await drive(agent) == "completed"
    assert await drive(other) == "lease_held"  # what one session has acquired is its own
    person = clients.http(OPERATOR)
    assert code(await lease(person, take=True, reason="by hand")) == "completed"
    assert (await agent.notice("lease_lost"))["reason"] == "by hand"
    assert await drive(agent) == "lease_lost"
    assert code(await lease(person, "release")) == "completed"
    assert await drive(agent) == "lease_lost"
    assert code(await lease(agent)) == "completed"
    assert await drive(agent) == "completed"


async def test_a_lease_that_a_key_does_not_renew_lapses_and_its_listener_is_told(
    clients: Clients,
) -> None:
    listener = await clients.listener(AGENT)
    assert code(await lease(listener, ttl=0.2)) == "completed"
    told = await listener.notice("lease_lost")
    assert (told["by"], told["reason"]) == ("the gateway", "the lease expired")
    assert await drive(clients.http(OPERATOR)) == "completed"


async def events(
    http: httpx.AsyncClient, last: str | None = None
) -> AsyncGenerator[tuple[str, Message]]:
    """Read the events of a stream, each with its id."""
    headers = {} if last is None else {"last-event-id": last}
    id_ = ""
    async with http.stream("GET", f"{BASE}/events?path={LEVEL}", headers=headers) as response:
        async for line in response.aiter_lines():
            field, _, text = line.partition(": ")
            if field == "id":
                id_ = text
            elif field == "data":
                yield id_, json.loads(text)


async def test_a_listener_that_was_away_hears_of_the_loss_on_return(clients: Clients) -> None:
    agent, person = clients.http(AGENT), clients.http(OPERATOR)
    assert code(await lease(agent)) == "completed"
    clients.robot.host.publish("sensor/level", 1.0)
    async with aclosing(events(agent.http)) as stream:
        last, _ = await anext(stream)
    await until(lambda: not clients.connected)
    assert code(await lease(person, take=True, reason="by hand")) == "completed"
    async with aclosing(events(agent.http, last)) as stream:
        async for _, message in stream:
            if message.get("code") == "lease_lost":
                assert message["reason"] == "by hand"
                return
    pytest.fail("the stream ended without it")


@pytest.mark.parametrize("listens", [False, True])
async def test_a_lease_is_handed_to_a_person_who_has_no_connection_to_command_by(
    clients: Clients, *, listens: bool
) -> None:
    agent = await clients.websocket(AGENT)
    person = await clients.listener(OPERATOR) if listens else clients.http(OPERATOR)
    if not listens:
        assert await drive(person) == "completed"  # known by what it asked for
    assert code(await lease(agent)) == "completed"
    given = (await lease(agent, "hand_over", to="operator"))["body"]
    assert (given["holder"], given["session"]) == ("operator", None)
    assert (await agent.notice("lease_given"))["to"] == "operator"
    if listens:
        assert (await person.notice("lease_given"))["by"] == "agent"
    assert await drive(person) == "completed"
    assert await drive(agent) == "lease_held"


async def test_a_lease_of_a_key_that_may_command_no_more_ends(clients: Clients) -> None:
    agent = clients.http(AGENT)
    assert code(await lease(agent)) == "completed"
    assert await drive(clients.http(OPERATOR)) == "lease_held"
    clients.reconfigure(config("viewer"))
    assert await drive(clients.http(OPERATOR)) == "completed"
