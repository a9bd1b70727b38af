from __future__ import annotations

import base64
import hashlib
from typing import Any

import cbor2
import msgspec
import pytest

from rcp_kernel.values import Encoding
from rcp_ws import segments
from transports.raw import opened
from transports.robot import KEY, Site, site
from transports.test_ws import Client, client

pytestmark = pytest.mark.anyio
WORD = "0123456789" * 1000


def cut(data: bytes, length: int, id_: str = "t", **facts: Any) -> list[dict[str, Any]]:
    bodies = [data[i : i + length] for i in range(0, len(data), length)]
    whole = {"size": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    return [
        {"type": "segment", "id": id_, "num": n, "total": len(bodies), "body": body} | whole | facts
        for n, body in enumerate(bodies)
    ]


def write_of(peer: Client, text: str = WORD) -> bytes:
    data = peer.encode({"type": "write", "id": "w", "path": "/param/text", "body": text})
    return data if isinstance(data, bytes) else data.encode()


async def send(peer: Client, segment: dict[str, Any]) -> None:
    if peer.encode({}) == "{}":
        segment = segment | {"body": base64.b64encode(segment["body"]).decode()}
    await peer.send(**segment)


async def assemble(peer: Client) -> Any:
    """Take the segments of one transfer and return its message."""
    parts: dict[int, bytes] = {}
    while True:
        segment = await peer.next()
        assert segment["type"] == "segment", segment
        body = segment["body"]
        parts[segment["num"]] = base64.b64decode(body) if isinstance(body, str) else body
        if len(parts) == segment["total"]:
            data = b"".join(parts[n] for n in range(len(parts)))
            assert (len(data), hashlib.sha256(data).hexdigest()) == (
                segment["size"],
                segment["sha256"],
            )
            return peer.decode(data)


@pytest.mark.parametrize("encoding", ["json", "cbor", "msgpack"])
async def test_a_long_request_may_come_in_segments_in_any_order(
    gateway: Site, encoding: str
) -> None:
    async with client(gateway, encoding) as peer:
        first, *rest = cut(write_of(peer), 3000)
        for segment in [*rest[:-1], first]:
            await send(peer, segment)
        await peer.send(type="ping", id="between")
        assert (await peer.next())["id"] == "between"
        await send(peer, rest[-1])
        reply = await peer.next()
        assert (reply["id"], reply["body"]) == ("w", WORD)


@pytest.mark.parametrize("encoding", ["json", "cbor", "msgpack"])
async def test_a_long_reply_comes_in_segments_once_that_is_agreed(
    gateway: Site, encoding: str
) -> None:
    async with client(gateway, encoding) as peer:
        await peer.ask(type="write", id="w", path="/param/text", body=WORD)
        whole = await peer.ask(type="read", id="1", path="/param/text", body={"fresh": False})
        await peer.ask(type="hello", id="h", body={"segment_size": 1024})
        await peer.send(type="write", id="w2", path="/param/text", body=WORD)
        reply = await assemble(peer)
        assert (reply["id"], reply["body"]) == ("w2", WORD)
        assert "error" in whole or whole["body"] == WORD


async def test_short_messages_overtake_a_long_one(gateway: Site) -> None:
    async with client(gateway) as peer:
        await peer.ask(type="hello", id="h", body={"segment_size": 1024})
        gateway.robot.host.publish("sensor/text", "x" * 3_000_000)
        await peer.send(type="subscribe", id="s", path="/sensor/text")
        assert (await peer.next())["type"] == "subscribe"
        assert (await peer.next())["num"] == 0
        await peer.send(type="ping", id="p")
        seen = 1
        while (message := await peer.next())["type"] == "segment":
            seen += 1
        assert message["id"] == "p"
        while (await peer.next())["num"] != message.get("total", 2930) - 1:
            seen += 1
            if seen > 2900:
                break
        assert seen > 100


async def test_a_lost_segment_of_the_gateways_is_sent_again(gateway: Site) -> None:
    async with client(gateway) as peer:
        await peer.ask(type="hello", id="h", body={"segment_size": 1024})
        await peer.send(type="write", id="w", path="/param/text", body=WORD)
        first = await peer.next()
        for _ in range(first["total"] - 1):
            await peer.next()
        await peer.send(type="segment", id=first["id"], resend=[0, 2])
        again = [await peer.next(), await peer.next()]
        assert again[0] == first
        assert again[1]["num"] == 2
        await peer.send(type="segment", id="t-99", resend=[0])
        assert (await peer.next())["error"]["code"] == "segment_missing"
        await peer.send(type="segment", id=first["id"], resend=[4000])
        assert (await peer.next())["error"]["code"] == "segment_missing"


async def test_a_segment_that_did_not_come_is_asked_for_again(gateway: Site) -> None:
    async with client(gateway) as peer:
        segments = cut(write_of(peer), 3000)
        for segment in [segments[0], *segments[2:]]:
            await send(peer, segment)
        assert await peer.next() == {"type": "segment", "id": "t", "resend": [1]}
        await send(peer, segments[1])
        assert (await peer.next())["id"] == "w"


async def test_a_transfer_that_stops_is_given_up_by_name() -> None:
    async with site(ws="segment_timeout = 0.05") as gateway, client(gateway) as peer:
        await send(peer, cut(write_of(peer), 3000)[0])
        reply = await peer.next()
        assert (reply["type"], reply["id"]) == ("segment", "t")
        assert reply["error"]["code"] == "segment_missing"
        assert reply["error"]["details"]["missing"] == [1, 2, 3]
        assert (await peer.ask(type="ping", id="p"))["status"] == "completed"


@pytest.mark.parametrize(
    "facts",
    [{"sha256": "0" * 64}, {"size": 9999}, {"size": 20_000}],
    ids=["hash", "too small a size", "too large a size"],
)
async def test_a_transfer_that_is_not_what_it_promised_is_corrupt(
    gateway: Site, facts: dict[str, Any]
) -> None:
    async with client(gateway) as peer:
        for segment in cut(write_of(peer), 5000, **facts):
            await send(peer, segment)
        reply = await peer.next()
        assert (reply["id"], reply["error"]["code"]) == ("t", "segment_corrupt")


async def test_segments_of_two_messages_under_one_id_are_corrupt(gateway: Site) -> None:
    async with client(gateway) as peer:
        await send(peer, cut(write_of(peer), 3000)[0])
        await send(peer, cut(write_of(peer, "other" * 2000), 3000)[1])
        assert (await peer.next())["error"]["code"] == "segment_corrupt"
        await send(peer, cut(write_of(peer), 3000)[0] | {"id": "u", "num": 7})
        assert (await peer.next())["error"]["code"] == "segment_corrupt"


async def test_transfers_have_limits_of_size_and_number() -> None:
    async with (
        site(ws="transfers = 2\nsegments = 10", more="[limits]\nmessage = 20000") as gateway,
        client(gateway) as peer,
    ):
        await send(peer, cut(b"x" * 20_001, 10_000)[0])
        assert (await peer.next())["error"]["code"] == "payload_too_large"
        await send(peer, cut(b"x" * 11, 1)[0])
        assert (await peer.next())["error"]["code"] == "payload_too_large"
        for number in range(3):
            await send(peer, cut(b"x" * 20, 10, id_=f"n{number}")[0])
        reply = await peer.next()
        assert (reply["id"], reply["error"]["code"]) == ("n2", "queue_full")


@pytest.mark.parametrize(
    "text",
    [
        '{"type":"segment","id":"t"}',
        '{"type":"segment","id":"t","num":-1,"total":1,"size":1,"sha256":"x","body":""}',
        '{"type":"segment","id":"t","resend":"all"}',
    ],
)
async def test_a_malformed_segment_is_a_bad_request(gateway: Site, text: str) -> None:
    async with client(gateway) as peer:
        await peer.wire.send(text)
        assert (await peer.next())["error"]["code"] == "bad_request"


async def test_a_message_that_only_speaks_of_segments_is_none(gateway: Site) -> None:
    async with client(gateway) as peer:
        reply = await peer.ask(type="write", id="1", path="/param/text", body="a segment")
        assert reply["body"] == "a segment"


@pytest.mark.parametrize("encoding", list(Encoding))
def test_no_value_is_made_of_a_message_that_only_speaks_of_segments(
    monkeypatch: pytest.MonkeyPatch, encoding: Encoding
) -> None:
    monkeypatch.setattr("rcp_ws.segments.parse", None)  # it would make all values of a long one
    message = {"type": "write", "path": "/param/text", "body": {"type": "a segment", "n": [1, 2]}}
    encode = {"json": msgspec.json.encode, "msgpack": msgspec.msgpack.encode, "cbor": cbor2.dumps}
    assert segments.read(encode[encoding.value](message), encoding) is None


async def test_without_an_agreement_long_messages_go_whole(gateway: Site) -> None:
    gateway.robot.host.publish("sensor/text", "x" * 2_000_000)
    async with opened(gateway, Authorization=f"Bearer {KEY}") as raw:
        raw.ask(type="read", id="1", path="/sensor/text")
        assert len((await raw.reply())["body"]) == 2_000_000
