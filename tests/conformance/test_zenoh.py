"""The wire suite over Zenoh: a client as a hub is one, without the gateway's own pipe code."""

from __future__ import annotations

import asyncio
import json
import secrets
import struct
import threading
from collections.abc import Iterator

import pytest

pytest.importorskip("zenoh")

import zenoh
from zenoh.handlers import Callback

from ports import free_port
from rcp_gateway.server import Server
from rcp_gateway.testing import BOUND, Client, TransportSuite, decode
from rcp_kernel.values import Encoding

_HEAD = struct.Struct("<cBQ")
_BEAT = struct.Struct("<?4Qdqdd")
_CONTROL, _BULK = 1, 3
_WHOLE = 61_440


class ZenohClient(Client):
    """One link, with all that a peer owes: numbers, acknowledgements, heartbeats."""

    def __init__(self, session: zenoh.Session, encoding: Encoding) -> None:
        super().__init__(encoding)
        suffix = "" if encoding is Encoding.MSGPACK else f".{encoding.value}"
        link = f"kit/{secrets.token_hex(4)}{suffix}"
        self._session = session
        self._loop = asyncio.get_running_loop()
        self._up = f"rcp/alpha/r7/in/{link}"
        self._sent = [0] * 4
        self._bytes = [0] * 4
        self._parts: list[list[bytes]] = [[] for _ in range(4)]
        self._arrived: asyncio.Queue[tuple[bytes, bytes]] = asyncio.Queue()
        self._gone, self._ended = False, asyncio.Event()

        def arrived(sample: zenoh.Sample) -> None:
            head = sample.attachment
            assert head is not None
            item = head.to_bytes(), sample.payload.to_bytes()
            self._loop.call_soon_threadsafe(self._arrived.put_nowait, item)

        self._messages = session.declare_subscriber(
            f"rcp/alpha/r7/out/{link}", Callback(arrived, indirect=False)
        )
        self._token = session.liveliness().declare_token(f"rcp/alpha/r7/link/{link}")
        self._tasks = [asyncio.create_task(self._read()), asyncio.create_task(self._beat())]

    async def _read(self) -> None:
        while True:
            head, data = await self._arrived.get()
            kind, place, _ = _HEAD.unpack(head)
            if kind == b"e":
                self._ended.set()
            if kind in b"mp":
                await self.reading.wait()
                self._parts[place].append(data)
                self._bytes[place] += len(data)
                self._put(b"a", place, self._bytes[place])
            if kind == b"m":
                whole = b"".join(self._parts[place])
                self._parts[place].clear()
                self.received(decode(whole, self.encoding))

    async def _beat(self) -> None:
        while True:
            beat = _BEAT.pack(False, *self._bytes, 0.0, 0, 0.0, 0.0)
            self._put(b"h", _CONTROL, 0, beat)
            await asyncio.sleep(0.5)

    def _put(self, kind: bytes, place: int, number: int, data: bytes = b"") -> None:
        if not self._gone:
            self._session.put(
                self._up,
                data,
                attachment=_HEAD.pack(kind, place, number),
                # The suite does not connect again, as a hub does after a loss on a busy machine.
                congestion_control=zenoh.CongestionControl.BLOCK,
            )

    async def transmit_raw(self, data: bytes) -> None:
        place = _BULK if len(data) > _WHOLE else _CONTROL
        for at in range(0, len(data) or 1, _WHOLE):
            self._sent[place] += 1
            kind = b"p" if at + _WHOLE < len(data) else b"m"
            self._put(kind, place, self._sent[place], data[at : at + _WHOLE])

    async def close(self) -> None:
        if not self._gone:
            self._gone = True
            self.resume()
            self._token.undeclare()
            async with asyncio.timeout(BOUND):
                await self._ended.wait()
            for task in self._tasks:
                task.cancel()
            await asyncio.gather(*self._tasks, return_exceptions=True)
            self._messages.undeclare()


class TestZenoh(TransportSuite):
    @pytest.fixture(autouse=True)
    def router(self, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
        """A router, which the gateway of the suite joins."""
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        table = {"gateway": "r7", "tenant": "alpha", "connect": [endpoint]}
        monkeypatch.setattr(type(self), "transports", {"zenoh": table})
        config = zenoh.Config()
        for key, value in (
            ("mode", "router"),
            ("listen/endpoints", [endpoint]),
            ("scouting/multicast/enabled", False),
        ):
            config.insert_json5(key, json.dumps(value))
        with zenoh.open(config) as session:
            self._session, self._joined = session, threading.Event()
            token = session.liveliness().declare_subscriber(
                "rcp/alpha/r7/alive", Callback(lambda _: self._joined.set(), indirect=False)
            )
            yield
            token.undeclare()

    async def connect(self, server: Server, token: str | None, encoding: Encoding) -> Client:
        assert await asyncio.to_thread(self._joined.wait, BOUND)
        client = ZenohClient(self._session, encoding)
        if token is not None:
            reply = await client.request("hello", body={"token": token})
            assert reply["status"] == "completed", reply
        return client
