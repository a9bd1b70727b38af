from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import msgspec
import pytest

from rcp_gateway.testing import OPERATOR, MemoryClient, ScriptedRobot, serve_backend
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host, Progress
from rcp_kernel.values import DEPTH, Encoding

pytestmark = pytest.mark.anyio
DEPTHS = (DEPTH + 3, 90, 150, 240, 300, 400, 500, 700, 900, 990, 1100, 5_000, 100_000, 2_000_000)


class Node(msgspec.Struct):
    """A value that may hold itself."""

    under: list[Node] = []


async def echo(value: Any, progress: Progress) -> Any:
    return value


@asynccontextmanager
async def anything(_config: msgspec.Struct, host: Host) -> AsyncGenerator[ScriptedRobot]:
    robot = ScriptedRobot(
        host,
        Resource(name="param/any", description="Anything.", value=Any),
        Resource(name="param/map", description="A map.", value=dict[str, Any]),
        Resource(name="param/node", description="A tree.", value=Node),
        Resource(name="sensor/x", description="A number.", value=float, live=True),
        Resource(name="service/echo", description="Echoes.", input=Any, output=Any),
        behaviours={"service/echo": echo},
    )
    robot.measure("sensor/x", 1.0)
    yield robot


def nested(encoding: Encoding, kind: str, depth: int) -> bytes:
    """Write lists in lists, maps in maps, or (`node`) both in turn, so deep; the last is empty."""
    key = b"under" if kind == "node" else b"a"
    if encoding is Encoding.JSON:
        map_, list_, ends = b'{"%b":' % key, b"[", {"list": b"]", "map": b"}", "node": b"]}"}
        last = {"list": b"[]", "map": b"{}", "node": map_ + b"[]}"}
    else:
        cbor = encoding is Encoding.CBOR
        map_ = (b"\xa1%c" if cbor else b"\x81%c") % ((0x60 if cbor else 0xA0) + len(key)) + key
        list_, ends = b"\x81" if cbor else b"\x91", {}
        nothing = {"list": b"\x80" if cbor else b"\x90", "map": b"\xa0" if cbor else b"\x80"}
        last = {**nothing, "node": map_ + nothing["list"]}
    unit = {"list": list_, "map": map_, "node": map_ + list_}[kind]
    times = (depth // 2 if kind == "node" else depth) - 1
    return unit * times + last[kind] + ends.get(kind, b"") * times


def envelope(encoding: Encoding, head: dict[str, str], name: str, value: bytes) -> bytes:
    """Write a request with one field that is written already."""
    if encoding is Encoding.JSON:
        return msgspec.json.encode(head)[:-1] + b',"%b":' % name.encode() + value + b"}"
    size = len(name)
    if encoding is Encoding.MSGPACK:
        fields = b"".join(map(msgspec.msgpack.encode, sum(head.items(), ())))
        return b"%c" % (0x81 + len(head)) + fields + b"%c" % (0xA0 + size) + name.encode() + value
    import cbor2

    fields = b"".join(map(cbor2.dumps, sum(head.items(), ())))
    return b"%c" % (0xA1 + len(head)) + fields + b"%c" % (0x60 + size) + name.encode() + value


REFUSED = ("bad_request", "invalid_value", "payload_too_large", "unsupported_operation")
PLACES = [
    ("list", {"type": "write", "path": "/param/any"}, "body"),
    ("map", {"type": "write", "path": "/param/any"}, "body"),
    ("map", {"type": "write", "path": "/param/map"}, "body"),
    ("node", {"type": "write", "path": "/param/node"}, "body"),
    ("map", {"type": "write", "path": "/param/any", "dry_run": True}, "body"),
    ("list", {"type": "write", "path": "/sensor/x"}, "body"),
    ("list", {"type": "execute", "path": "/service/echo"}, "body"),
    ("map", {"type": "execute", "path": "/service/echo"}, "x-mine"),
    ("list", {"type": "ping"}, "x-mine"),
    ("map", {"type": "ping"}, "type"),
    ("map", {"type": "hello"}, "body"),
    ("map", {"type": "discover"}, "body"),
    ("list", {"type": "batch"}, "body"),
    ("map", {"type": "read", "path": "/sensor/x"}, "body"),
    ("map", {"type": "subscribe", "path": "/sensor/x"}, "body"),
]


async def answered(client: MemoryClient) -> dict[str, Any]:
    """Take the final reply to the one request that is under way."""
    return await client.until(lambda m: m["status"] in ("completed", "failed", "rejected"))


@pytest.mark.parametrize("encoding", list(Encoding))
async def test_what_is_nested_too_deep_is_refused_and_nothing_worse(encoding: Encoding) -> None:
    async with serve_backend(anything, msgspec.Struct()) as served:
        client = MemoryClient(served.server.client_api, OPERATOR, encoding)
        for kind, head, name in PLACES:
            for depth in DEPTHS:
                value = nested(encoding, kind, depth)
                await client.transmit_raw(envelope(encoding, head, name, value))
                reply = await answered(client)
                if head["type"] == "batch" and reply["status"] == "completed":
                    (reply,) = reply["body"]  # what is wrong with a part is said of the part
                code = reply["error"]["code"] if "error" in reply else None
                assert code in REFUSED, (head, depth)
        last = await client.request("read", "/sensor/x")
        assert last["body"] == 1.0


@pytest.mark.parametrize("encoding", list(Encoding))
@pytest.mark.parametrize("kind", ["list", "map", "node"])
async def test_the_depth_is_the_same_in_every_encoding(encoding: Encoding, kind: str) -> None:
    head = {"type": "write", "path": "/param/node" if kind == "node" else "/param/any"}
    async with serve_backend(anything, msgspec.Struct()) as served:
        client = MemoryClient(served.server.client_api, OPERATOR, encoding)
        for depth, code in ((DEPTH, None), (DEPTH + 2, "bad_request")):
            value = nested(encoding, kind, depth)
            await client.transmit_raw(envelope(encoding, head, "body", value))
            reply = await answered(client)
            assert reply.get("error", {}).get("code") == code, depth


async def test_what_is_broad_is_not_deep() -> None:
    async with serve_backend(anything, msgspec.Struct()) as served:
        client = MemoryClient(served.server.client_api, OPERATOR)
        broad = [[{"a": [n]}] for n in range(2_000)]
        assert (await client.request("write", "/param/any", body=broad))["body"] == broad
