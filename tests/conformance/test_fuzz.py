"""Whatever bytes come in, the gateway answers, says nothing of itself, and goes on."""

from __future__ import annotations

import asyncio
import itertools
import json
from collections.abc import AsyncGenerator
from typing import Any, ClassVar

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from conformance.wires import LISTENER, WebSocketClient
from rcp_gateway.server import Server
from rcp_gateway.testing import Client, MemoryClient, encode
from rcp_gateway.testing.wire import Wire, World
from rcp_kernel.errors import BY_CODE
from rcp_kernel.values import Encoding

STATUSES = {"accepted", "pending", "in_progress", "completed", "failed", "rejected", "cancelled"}
TYPES = (
    *("read", "write", "execute", "subscribe", "unsubscribe", "cancel", "discover", "status"),
    *("hello", "ping", "batch", "segment", "update", "reply", ""),
)
PATHS = (
    *("/sensor/level", "/param/parcel", "/param/limit", "/actuator/drive", "/action/go"),
    *("/action/line", "/action/dash", "/service/echo", "/service/nothing", "/sensor/pose"),
    *("/system/status", "/system/commands", "/system/sessions", "/system/log", "/system/estop"),
    *("/sensor/*", "/**", "/sensor/ghost/level", "/tenant/beta/sensor/level", "", "/", "*", "//"),
)
WORDS = (
    *("type", "path", "id", "timestamp", "deadline", "version", "idempotency_key", "valid_for"),
    *("dry_run", "command", "body", "x-a", "x-", "num", "total", "size", "sha256", "token"),
)
BODY_WORDS = (
    *("paths", "rate", "on", "deadband", "where", "fields", "history", "initial", "qos"),
    *("encoding", "duration", "count", "field", "lt", "and", "or", "not", "edge", "distance"),
    *("mode", "i64", "u64", "real", "data", "items", "table", "linear", "x", "kind", "op", "q"),
    *("limit", "cursor", "schemas", "fresh", "reset", "scope", "session", "resume_from"),
    *("resume_token", "segment_size", "tenant", "depth", "reliability", "priority"),
)
scalars = (
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(codec="utf-8"), max_size=12)
    | st.sampled_from((*PATHS, "NaN", "Infinity", "5%", "30s", "rise", "native", "json", "wait"))
)
bodies = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(BODY_WORDS), inner, max_size=4)
    ),
    max_leaves=8,
)
envelopes = st.fixed_dictionaries(
    {"type": st.sampled_from(TYPES)},
    optional={
        "path": st.sampled_from(PATHS),
        "id": st.sampled_from(("a", "b", "c")),
        "body": bodies,
        "deadline": st.just(0.2),
    },
) | st.dictionaries(st.sampled_from(WORDS), bodies, max_size=5)
COUNT = itertools.count()


# Where to cut (of 1000), how much, and what to put there instead.
edits = st.lists(
    st.tuples(st.integers(0, 1000), st.integers(0, 3), st.binary(max_size=3)), max_size=3
)
damaged = st.tuples(envelopes, edits) | st.binary(max_size=60)


def written(message: Any, encoding: Encoding) -> bytes:
    """Write an envelope and damage it, or take bytes as they are."""
    if isinstance(message, bytes):
        return message
    data = bytearray(encode(message[0], encoding))
    for place, length, instead in message[1]:
        at = len(data) * place // 1000
        data[at : at + length] = instead
    return bytes(data)


def check(client: Client) -> None:
    """See that nothing in the inbox tells of a fault of the gateway's own."""
    for message in client.inbox:
        text = json.dumps(message, default=str)
        assert "Traceback" not in text
        assert '.py"' not in text
        error = message.get("error")
        if error is not None:
            assert error["code"] in BY_CODE
            assert error["code"] != "internal", message
        if message["type"] not in ("update", "notice", "segment"):
            assert message.get("status") in STATUSES, message
    client.inbox.clear()


class Fuzz(Wire):
    """Two floods, for each encoding."""

    @pytest.fixture
    async def client(self, world: World, request: pytest.FixtureRequest) -> AsyncGenerator[Client]:
        """A client in the encoding of the test."""
        client = await world.client(encoding=request.param)
        yield client
        check(client)

    async def survives(self, client: Client, data: bytes) -> None:
        """Send bytes, and see that the connection still serves."""
        await client.transmit_raw(data)
        async with asyncio.timeout(60):
            reply = await client.request("ping", id=f"ping-{next(COUNT)}")
        assert reply["status"] == "completed"
        check(client)


few = settings(
    max_examples=100,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
every = pytest.mark.parametrize("client", list(Encoding), indirect=True)


class TestInMemory(Fuzz):
    async def connect(self, server: Server, token: str | None, encoding: Encoding) -> Client:
        return MemoryClient(server.client_api, token, encoding)

    @every
    @few
    @given(message=damaged)
    async def test_any_bytes_are_survived(self, client: Client, message: Any) -> None:
        await self.survives(client, written(message, client.encoding))

    @every
    @few
    @given(message=envelopes)
    async def test_any_envelope_is_survived(self, client: Client, message: Any) -> None:
        await self.survives(client, encode(message, client.encoding))


class TestOverWebSocket(Fuzz):
    transports: ClassVar = {"asgi": LISTENER, "ws": {}}

    async def connect(self, server: Server, token: str | None, encoding: Encoding) -> Client:
        return await WebSocketClient.connected(server, token, encoding)

    @every
    @few
    @given(message=damaged)
    async def test_any_bytes_are_survived(self, client: Client, message: Any) -> None:
        await self.survives(client, written(message, client.encoding))

    @every
    @few
    @given(message=envelopes)
    async def test_any_envelope_is_survived(self, client: Client, message: Any) -> None:
        await self.survives(client, encode(message, client.encoding))
