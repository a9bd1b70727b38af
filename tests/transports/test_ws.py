from __future__ import annotations

import asyncio
import json
import logging
import socket
import struct
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import cbor2
import msgspec
import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, ConnectionClosedError
from websockets.typing import Subprotocol

from rcp_streams import path_subscription
from transports.raw import TEXT, frame, handshake, opened
from transports.robot import BOUND, KEY, Site, site, until

pytestmark = pytest.mark.anyio
CODECS: dict[str, tuple[Any, Any]] = {
    "json": (json.dumps, json.loads),
    "cbor": (cbor2.dumps, cbor2.loads),
    "msgpack": (msgspec.msgpack.encode, msgspec.msgpack.decode),
}


class Client:
    """A client on an independent library, in one of the encodings."""

    def __init__(self, wire: ClientConnection, encoding: str) -> None:
        self.wire = wire
        self.encode, self.decode = CODECS[encoding]

    async def send(self, **envelope: Any) -> None:
        await self.wire.send(self.encode(envelope))

    async def next(self) -> dict[str, Any]:
        async with asyncio.timeout(BOUND):
            return self.decode(await self.wire.recv())

    async def ask(self, **envelope: Any) -> dict[str, Any]:
        await self.send(**envelope)
        while True:
            reply = await self.next()
            if reply.get("id") == envelope["id"] and reply["type"] == envelope["type"]:
                return reply


@asynccontextmanager
async def client(
    gateway: Site, encoding: str = "json", token: str | None = KEY
) -> AsyncGenerator[Client]:
    headers = {"Authorization": f"Bearer {token}"} if token else {}
    async with connect(
        gateway.ws,
        subprotocols=[Subprotocol(f"rcp.v1.{encoding}")],
        additional_headers=headers,
        max_size=None,
    ) as wire:
        yield Client(wire, encoding)


@pytest.mark.parametrize("encoding", CODECS)
async def test_every_encoding_asks_and_is_answered(gateway: Site, encoding: str) -> None:
    async with client(gateway, encoding) as peer:
        reply = await peer.ask(type="read", id="1", path="/sensor/pose")
        assert reply["path"] == "/tenant/alpha/sensor/pose"
        assert reply["body"]["position"]["x"] == 1.0
        blob = await peer.ask(type="read", id="2", path="/sensor/blob")
        native = encoding != "json"
        assert blob["body"] == (b"0123456789" if native else "MDEyMzQ1Njc4OQ==")


async def test_updates_in_another_encoding_come_in_the_right_frames(gateway: Site) -> None:
    async with client(gateway) as peer:
        body = {"encoding": "cbor", "count": 1}
        await peer.ask(type="subscribe", id="s", path="/sensor/blob", body=body)
        async with asyncio.timeout(BOUND):
            data = await peer.wire.recv()
        assert isinstance(data, bytes)
        assert cbor2.loads(data)["body"] == b"0123456789"
    async with client(gateway, "msgpack") as peer:
        await peer.send(type="subscribe", id="s", path="/sensor/pose", body={"encoding": "json"})
        await peer.next()
        async with asyncio.timeout(BOUND):
            text = await peer.wire.recv()
        assert isinstance(text, str)
        assert json.loads(text)["type"] == "update"


@pytest.mark.parametrize("garbage", ["", "[]", "{", '{"type":"fly"}', "\x00", "[" * 20_000])
async def test_malformed_messages_are_answered_and_the_connection_kept(
    gateway: Site, garbage: str
) -> None:
    async with client(gateway) as peer:
        await peer.wire.send(garbage)
        assert (await peer.next())["error"]["code"] == "bad_request"
        assert (await peer.ask(type="ping", id="p"))["status"] == "completed"


async def test_a_tenant_may_be_named_in_the_handshake(gateway: Site) -> None:
    headers = {"Authorization": f"Bearer {KEY}", "X-RCP-Tenant": "beta"}
    async with connect(gateway.ws, additional_headers=headers) as wire:
        peer = Client(wire, "json")
        reply = await peer.ask(type="read", id="1", path="/sensor/pose")
        assert reply["path"] == "/tenant/beta/sensor/pose"


async def test_without_strangers_hello_has_to_come_first() -> None:
    async with site(top="anonymous = false") as gateway, client(gateway, token=None) as peer:
        early = await peer.ask(type="read", id="1", path="/sensor/pose")
        assert early["error"]["code"] == "unauthenticated"
        wrong = await peer.ask(type="hello", id="2", body={"token": "not-a-key-of-anybody"})
        assert wrong["error"]["code"] == "unauthenticated"
        hello = await peer.ask(type="hello", id="3", body={"token": KEY})
        assert hello["body"]["principal"] == "op"
        reply = await peer.ask(type="read", id="4", path="/tenant/alpha/sensor/pose")
        assert reply["status"] == "completed"


async def test_hello_answers_with_the_limits_of_the_wire(gateway: Site) -> None:
    async with client(gateway) as peer:
        hello = await peer.ask(type="hello", id="1", body={"segment_size": 4096})
        assert hello["body"]["limits"]["segment_size"] == 4096
        assert hello["body"]["heartbeat"] == 15.0


async def test_a_cut_connection_comes_back_to_its_session(gateway: Site) -> None:
    async with opened(gateway, Authorization=f"Bearer {KEY}") as raw:
        raw.ask(type="hello", id="h")
        secret = (await raw.reply())["body"]["resume_token"]
        raw.ask(type="subscribe", id="s", path="/sensor/text")
        await raw.reply()
        first = await raw.reply()
        raw.writer.transport.abort()
    gateway.robot.host.publish("sensor/text", "missed")
    back = {"session": secret, "resume_from": {first["path"]: first["seq"]}}
    async with client(gateway) as peer:
        hello = await peer.ask(type="hello", id="h", body=back)
        assert hello["status"] == "completed"
        update = await peer.next()
        assert (update["body"], update["seq"]) == ("missed", first["seq"] + 1)


async def test_the_old_connection_of_a_session_taken_over_is_closed(gateway: Site) -> None:
    async with client(gateway) as old, client(gateway) as new:
        hello = await old.ask(type="hello", id="1")
        await new.ask(type="hello", id="2", body={"session": hello["body"]["resume_token"]})
        with pytest.raises(ConnectionClosedError) as closed:
            await old.next()
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1008
        assert (await new.ask(type="ping", id="3"))["status"] == "completed"


async def test_a_client_that_reads_slowly_gets_the_newest_and_delays_nobody(gateway: Site) -> None:
    async with opened(gateway) as raw, client(gateway) as quick:
        raw.ask(type="subscribe", id="s", path="/sensor/text")
        await quick.ask(type="subscribe", id="q", path="/sensor/text", body={"initial": False})
        for number in range(400):
            gateway.robot.host.publish("sensor/text", f"{number}:" + "x" * 50_000)
            assert (await quick.next())["body"].startswith(f"{number}:")
        dropped = 0
        while True:
            message = await raw.reply()
            dropped += message.get("dropped", 0)
            if str(message["body"])[:4] == "399:":
                break
        assert dropped > 0
        assert message["dropped"] > 0


async def test_updates_of_megabytes_delay_nobody_and_do_not_pile_up(gateway: Site) -> None:
    async with opened(gateway) as raw, client(gateway) as quick:
        raw.ask(type="subscribe", id="s", path="/sensor/text")
        await quick.ask(type="subscribe", id="q", path="/sensor/text", body={"initial": False})
        outboxes = [
            session.connection.outbox
            for session in gateway.server.gateway.sessions.known.values()
            if session.connection is not None
        ]
        for number in range(20):
            gateway.robot.host.publish("sensor/text", f"{number}:" + "x" * 1_000_000)
            assert (await quick.next())["body"].startswith(f"{number}:")
        # What the operating system has not taken of one update counts; no second one is written.
        assert [0 <= outbox.buffered < 1_100_000 for outbox in outboxes] == [True, True]
        assert max(outbox.buffered for outbox in outboxes) > 0
        while str((await raw.reply())["body"])[:3] != "19:":
            pass


async def test_from_a_client_that_takes_no_replies_nothing_more_is_read(gateway: Site) -> None:
    gateway.robot.host.publish("sensor/text", "x" * 100_000)
    async with opened(gateway) as raw:
        ask = json.dumps({"type": "read", "id": "r", "path": "/sensor/text"})
        raw.ask(type="ping", id="first")
        await raw.reply()
        session = next(iter(gateway.server.gateway.sessions.known.values()))
        assert session.connection is not None
        control = session.connection.outbox.control
        from transports.raw import TEXT, frame

        one = frame(TEXT, ask.encode())
        raw.send(*([one] * 20_000))
        await asyncio.sleep(0.2)
        assert len(session.connection.outbox.control) < 1000
        assert len(control) < 1000
        for _ in range(500):
            assert (await raw.reply())["id"] == "r"


async def test_when_the_gateway_stops_clients_are_told() -> None:
    async with site() as gateway:
        wire = await connect(gateway.ws)
        task = asyncio.ensure_future(wire.recv())
    with pytest.raises(ConnectionClosed) as closed:
        await task
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 1001


async def test_a_session_whose_key_is_gone_is_told_and_closed(gateway: Site) -> None:
    async with client(gateway) as peer:
        await peer.ask(type="ping", id="1")
        config = gateway.server.gateway.settings.config
        gateway.server.gateway.reconfigure(msgspec.structs.replace(config, keys=()))
        assert (await peer.next())["error"]["code"] == "token_expired"
        with pytest.raises(ConnectionClosed) as closed:
            await peer.next()
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1008
    await until(lambda: not gateway.server.gateway.sessions.known)


async def test_nothing_more_is_written_once_a_socket_is_found_broken(
    gateway: Site, caplog: pytest.LogCaptureFixture
) -> None:
    loop, log = asyncio.get_running_loop(), logging.getLogger("asyncio")
    caplog.set_level(logging.WARNING, log.name)
    log.addHandler(caplog.handler)  # the gateway has the root logger
    sock = socket.create_connection(("127.0.0.1", gateway.port))
    sock.setblocking(False)
    await loop.sock_sendall(sock, handshake(Authorization=f"Bearer {KEY}"))
    body = {"qos": {"reliability": "reliable"}}
    asked = {"type": "subscribe", "id": "s", "path": "/sensor/text", "body": body}
    await loop.sock_sendall(sock, frame(TEXT, json.dumps(asked).encode()))
    seen = b""
    async with asyncio.timeout(BOUND):
        while b'"update"' not in seen:
            seen += await loop.sock_recv(sock, 65_536)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    sock.close()  # a reset: the gateway finds out by writing
    for _ in range(20):
        gateway.robot.host.publish("sensor/text", "x" * 20_000)
    sessions = gateway.server.gateway.sessions
    await until(lambda: not any(session.connection for session in sessions.known.values()))
    log.removeHandler(caplog.handler)
    assert not [record for record in caplog.records if "socket.send" in record.getMessage()]


async def test_receivers_that_have_gone_leave_nothing_behind(gateway: Site) -> None:
    before = len(path_subscription._shares)  # noqa: SLF001 - a bound of memory
    path = "/tenant/alpha/sensor/text"
    async with client(gateway) as peer:
        for n in range(50):  # each by a name of its own, as every event stream has
            await peer.send(type="subscribe", id=f"s{n}", path=path)
            while (await peer.next())["type"] != "update":
                pass
            await peer.ask(type="unsubscribe", id=f"u{n}", body={"subscription": f"s{n}"})
            gateway.robot.host.publish("sensor/text", f"the next is {n}")  # nothing holds the last
    assert len(path_subscription._shares) < before + 25  # noqa: SLF001 - a bound of memory
