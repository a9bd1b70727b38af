"""What WebSocket has beside envelopes: subprotocols, origins, segments."""

from __future__ import annotations

import base64
import hashlib
import json
from typing import Any, ClassVar

import pytest
import websockets
from websockets.asyncio.client import connect

from conformance.wires import BASE, LISTENER, WebSocketClient, address, bearer
from rcp_gateway.server import Server
from rcp_gateway.testing import Client, Message, decode, encode, proves
from rcp_gateway.testing.wire import Wire, World
from rcp_kernel.values import Encoding

SIZE = 4096


def segments(data: bytes, encoding: Encoding, id_: str = "t-1") -> list[Message]:
    """Cut a message as the contract says."""

    parts = [data[i : i + SIZE] for i in range(0, len(data), SIZE)]
    whole = {"size": len(data), "sha256": hashlib.sha256(data).hexdigest(), "total": len(parts)}
    text = encoding is Encoding.JSON
    return [
        {
            "type": "segment",
            "id": id_,
            "num": i,
            **whole,
            "body": base64.b64encode(part).decode() if text else part,
        }
        for i, part in enumerate(parts)
    ]


class TestWs(Wire):
    offers = frozenset({"ws", "rest"})
    transports: ClassVar = {"asgi": LISTENER, "ws": {}}

    async def connect(self, server: Server, token: str | None, encoding: Encoding) -> Client:
        return await WebSocketClient.connected(server, token, encoding)

    def url(self, world: World) -> str:
        return address(world.server).replace("http", "ws", 1) + BASE + "/ws"

    async def refusal(self, world: World, **options: Any) -> int:
        with pytest.raises(websockets.InvalidStatus) as caught:
            await connect(self.url(world), proxy=None, **options)
        return caught.value.response.status_code

    @proves("ws.subprotocol", "rest.proof")
    async def test_the_subprotocol_chooses_the_encoding(self, world: World) -> None:
        async with connect(self.url(world), proxy=None) as socket:
            await socket.send('{"type": "ping"}')
            assert json.loads(await socket.recv())["status"] == "completed"
        strange = [websockets.Subprotocol("rcp.v9.json")]
        assert await self.refusal(world, subprotocols=strange) == 400
        headers = bearer("not-a-known-key")
        assert await self.refusal(world, additional_headers=headers) == 401

    @proves("ws.origin")
    async def test_a_page_of_another_origin_is_refused(self, world: World) -> None:
        origin = websockets.Origin("https://evil.example")
        assert await self.refusal(world, origin=origin) == 403
        own = websockets.Origin(address(world.server))
        async with connect(self.url(world), proxy=None, origin=own) as socket:
            await socket.send('{"type": "ping"}')
            await socket.recv()

    @proves("ws.segments")
    async def test_what_a_client_sends_in_segments_is_handled_as_one(self, world: World) -> None:
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            items = [0.5] * 10_000
            message: Message = {
                "type": "write",
                "id": "big",
                "path": "/param/parcel",
                "body": {"items": items},
            }
            cut = segments(encode(message, encoding), encoding)
            assert len(cut) > 2
            for i, segment in enumerate(reversed(cut)):  # in any order, between other messages
                await client.transmit(segment)
                if i == 1:
                    assert (await client.request("ping"))["status"] == "completed"
            reply = await client.final("big")
            assert (reply["status"], reply["body"]["items"]) == ("completed", items)

    @proves("ws.segments")
    async def test_what_is_too_long_for_the_client_comes_in_segments(self, world: World) -> None:
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            hello = await client.request("hello", body={"segment_size": SIZE})
            assert hello["body"]["limits"]["segment_size"] == SIZE
            id_ = await client.send(type="discover")
            first = await client.until(lambda m: m["type"] == "segment")
            parts = {first["num"]: first}
            while len(parts) < first["total"]:
                segment = await client.until(lambda m: m["type"] == "segment")
                parts[segment["num"]] = segment
            whole = b"".join(_bytes(parts[i]["body"]) for i in range(first["total"]))
            assert len(whole) == first["size"] > SIZE
            assert hashlib.sha256(whole).hexdigest() == first["sha256"]

            assert decode(whole, encoding)["id"] == id_

    @proves("ws.segment-corrupt")
    async def test_a_transfer_that_does_not_match_is_refused(self, world: World) -> None:
        client = await world.client()
        message = {"type": "ping", "id": "big", "x-fill": "x" * 10_000}
        for harm in ({"sha256": "0" * 64}, {"size": 3}):
            for segment in segments(encode(message, Encoding.JSON), Encoding.JSON, str(harm)[:20]):
                await client.transmit(segment | harm)
            reply = await client.until(lambda m: "error" in m)
            assert reply["error"]["code"] in ("segment_corrupt", "bad_request")
        assert (await client.request("ping"))["status"] == "completed"


def _bytes(body: Any) -> bytes:

    return base64.b64decode(body) if isinstance(body, str) else body
