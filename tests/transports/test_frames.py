from __future__ import annotations

import json
import zlib

import pytest

from transports.raw import BINARY, CLOSE, PING, PONG, TEXT, connected, frame, handshake, opened
from transports.robot import KEY, Site, site

pytestmark = pytest.mark.anyio
ASK = b'{"type":"ping","id":"p"}'
OFFER = {"Sec_WebSocket_Extensions": "permessage-deflate; client_max_window_bits"}


async def test_a_message_may_come_in_fragments_with_pings_between(gateway: Site) -> None:
    async with opened(gateway) as raw:
        raw.send(frame(TEXT, ASK[:5], fin=False), frame(0, b"", fin=False))
        raw.send(frame(PING, b"hi"), frame(0, ASK[5:]))
        assert await raw.frame() == (0x80 | PONG, b"hi")
        assert (await raw.reply())["id"] == "p"


async def test_json_is_taken_from_binary_frames_too(gateway: Site) -> None:
    async with opened(gateway) as raw:
        raw.send(frame(BINARY, ASK))
        assert (await raw.reply())["id"] == "p"


async def test_requests_that_come_together_are_all_answered_in_order(gateway: Site) -> None:
    async with opened(gateway) as raw:
        raw.send(*(frame(TEXT, b'{"type":"ping","id":"%d"}' % i) for i in range(200)))
        assert [(await raw.reply())["id"] for _ in range(200)] == [str(i) for i in range(200)]


@pytest.mark.parametrize(
    "wrong",
    [
        frame(TEXT, ASK, masked=False),
        frame(TEXT, ASK, rsv=4),
        frame(TEXT, ASK, rsv=1),
        frame(3, ASK),
        frame(0, ASK),
        frame(TEXT, ASK, fin=False) + frame(TEXT, ASK),
        frame(PING, b"x" * 126),
        frame(PING, b"x", fin=False),
        frame(PING, b"x", rsv=2),
        frame(CLOSE, b"\x03"),
        frame(CLOSE, b"\x03\xed"),
        frame(CLOSE, b"\x03\xee"),
        frame(CLOSE, b"\x13\x88"),
    ],
    ids=[
        "unmasked", "compressed unasked", "reserved bit", "opcode 3", "continues nothing",
        "begins twice", "long ping", "ping in parts", "ping with a reserved bit",
        "half a close code", "close code 1005", "close code 1006", "close code 5000",
    ],
)  # fmt: skip
async def test_a_breach_of_the_protocol_closes_with_1002(gateway: Site, wrong: bytes) -> None:
    async with opened(gateway) as raw:
        raw.send(wrong)
        assert await raw.closed() == 1002
        await raw.ended()


async def test_text_that_is_not_utf8_is_answered_and_closes_with_1007(gateway: Site) -> None:
    async with opened(gateway) as raw:
        raw.send(frame(TEXT, b'{"type":"ping","id":"x","body":"\xff"}'))
        reply = await raw.reply()
        assert (reply["id"], reply["error"]["code"]) == ("x", "bad_request")
        assert await raw.closed() == 1007
    async with opened(gateway) as raw:
        raw.send(frame(TEXT, b'{"type":"\xc3', fin=False), frame(0, b'\x28"}'))
        assert (await raw.reply())["error"]["code"] == "bad_request"
        assert await raw.closed() == 1007


async def test_text_cut_inside_a_character_is_one_message(gateway: Site) -> None:
    data = '{"type":"ping","id":"é"}'.encode()
    cut = data.index(b"\xc3") + 1
    async with opened(gateway) as raw:
        raw.send(frame(TEXT, data[:cut], fin=False), frame(0, data[cut:]))
        assert (await raw.reply())["id"] == "é"


@pytest.mark.parametrize("code", [1000, 1001, 3000, 4999])
async def test_a_close_is_answered_with_its_own_code(gateway: Site, code: int) -> None:
    async with opened(gateway) as raw:
        raw.send(frame(CLOSE, code.to_bytes(2, "big") + b"bye"))
        assert await raw.frame() == (0x88, code.to_bytes(2, "big"))
        await raw.ended()


async def test_a_close_without_a_code_is_answered_without_one(gateway: Site) -> None:
    async with opened(gateway) as raw:
        raw.send(frame(CLOSE))
        assert await raw.frame() == (0x88, b"")
        await raw.ended()


async def test_a_message_too_long_is_refused_and_the_connection_kept() -> None:
    async with site(more="[limits]\nmessage = 2048") as gateway, opened(gateway) as raw:
        raw.send(frame(TEXT, b'{"type":"ping","id":"' + b"x" * 2100 + b'"}'))
        assert (await raw.reply())["error"]["code"] == "payload_too_large"
        raw.send(frame(TEXT, b"x" * 2000, fin=False), frame(0, b"x" * 2000, fin=False))
        raw.send(frame(0, b"x" * 2000))
        assert (await raw.reply())["error"]["code"] == "payload_too_large"
        raw.ask(type="ping", id="alive")
        assert (await raw.reply())["id"] == "alive"


async def test_a_frame_beyond_all_measure_closes_with_1009() -> None:
    async with site(more="[limits]\nmessage = 2048") as gateway, opened(gateway) as raw:
        raw.send(frame(TEXT, b"x" * 70_000))
        assert await raw.closed() == 1009


async def test_a_silent_peer_is_pinged_twice_and_cut() -> None:
    async with site(more="[limits]\nheartbeat = 0.05") as gateway, opened(gateway) as raw:
        assert await raw.frame() == (0x89, b"")
        assert await raw.frame() == (0x89, b"")
        await raw.ended()


async def test_a_peer_that_answers_pings_stays() -> None:
    async with site(more="[limits]\nheartbeat = 0.03") as gateway, opened(gateway) as raw:
        for _ in range(6):
            assert await raw.frame() == (0x89, b"")
            raw.send(frame(PONG))


async def test_compression_goes_both_ways_where_it_is_agreed() -> None:
    async with (
        site(asgi='compression = "always"\ncompress_above = 100') as gateway,
        opened(gateway, **OFFER, Authorization=f"Bearer {KEY}") as raw,
    ):
        assert b"permessage-deflate; server_no_context_takeover" in raw.head
        text = {"type": "write", "id": "w", "path": "/param/text", "body": "ha" * 5000}
        raw.send(frame(TEXT, _deflated(json.dumps(text).encode()), rsv=4))
        first, payload = await raw.frame()
        assert first == 0xC1
        assert len(payload) < 1000
        assert json.loads(_inflated(payload))["body"] == "ha" * 5000
        packed = _deflated(ASK)
        raw.send(frame(TEXT, packed[:3], rsv=4, fin=False), frame(0, packed[3:]))
        assert (await raw.reply())["id"] == "p"


async def test_a_compressed_bomb_is_refused() -> None:
    async with (
        site(more="[limits]\nmessage = 4096") as gateway,
        opened(gateway, **OFFER) as raw,
    ):
        raw.send(frame(TEXT, _deflated(b" " * 1_000_000), rsv=4))
        assert (await raw.reply())["error"]["code"] == "payload_too_large"


async def test_a_damaged_compressed_message_closes(gateway: Site) -> None:
    async with opened(gateway, **OFFER) as raw:
        raw.send(frame(TEXT, b"\xff\xff\xff\xff", rsv=4))
        assert await raw.closed() == 1007


@pytest.mark.parametrize(
    "headers",
    [
        {**OFFER, "Sec_WebSocket_Protocol": "rcp.v1.cbor"},
        {"Sec_WebSocket_Extensions": "permessage-deflate; server_max_window_bits=8"},
        {"Sec_WebSocket_Extensions": "permessage-deflate; unheard_of"},
        {"Sec_WebSocket_Extensions": "x-webkit-deflate-frame"},
        {"Sec_WebSocket_Extensions": "permessage-deflate; client_no_context_takeover=1"},
        {"Sec_WebSocket_Extensions": "permessage-deflate; server_no_context_takeover=true"},
        {"Sec_WebSocket_Extensions": "permessage-deflate; client_max_window_bits=7"},
        {"Sec_WebSocket_Extensions": "permessage-deflate; client_max_window_bits=16"},
        {"Sec_WebSocket_Extensions": "permessage-deflate; client_max_window_bits=015"},
        {"Sec_WebSocket_Extensions": "permessage-deflate; client_max_window_bits="},
        {"Sec_WebSocket_Extensions": 'permessage-deflate; client_max_window_bits="x y"'},
        {"Sec_WebSocket_Extensions": "permessage-deflate; server_max_window_bits"},
        {"Sec_WebSocket_Extensions": "permessage-deflate; server_max_window_bits=1.5"},
        {"Sec_WebSocket_Extensions": "permessage-deflate;"},
        {"Sec_WebSocket_Extensions": "permessage-deflate;;client_max_window_bits"},
        {"Sec_WebSocket_Extensions": 'x; a="b, permessage-deflate, c"'},
        {"Sec_WebSocket_Extensions": ",,;=;,"},
        {},
    ],
)
async def test_compression_is_declined_where_it_does_not_fit(
    gateway: Site, headers: dict[str, str]
) -> None:
    async with opened(gateway, **headers) as raw:
        assert b"Extensions" not in raw.head


@pytest.mark.parametrize(
    ("offer", "more"),
    [
        ("permessage-deflate; client_max_window_bits", ""),
        ('permessage-deflate; client_max_window_bits="10"; server_no_context_takeover', ""),
        ("permessage-deflate; server_max_window_bits=15", "; server_max_window_bits=15"),
        ("permessage-deflate; server_max_window_bits=9, permessage-deflate", ""),
        ("permessage-deflate; nonsense, x, Permessage-Deflate", ""),
    ],
)
async def test_the_first_offer_that_is_valid_is_accepted(
    gateway: Site, offer: str, more: str
) -> None:
    async with opened(gateway, Sec_WebSocket_Extensions=offer) as raw:
        both = "server_no_context_takeover; client_no_context_takeover"
        agreed = f"permessage-deflate; {both}{more}"
        assert f"Sec-WebSocket-Extensions: {agreed}\r\n".encode() in raw.head


async def test_offers_may_stand_in_several_headers(gateway: Site) -> None:
    request = handshake(Sec_WebSocket_Extensions="permessage-deflate")
    request = request.replace(b"\r\n\r\n", b"\r\nSec-WebSocket-Extensions: x\r\n\r\n")
    async with connected(gateway) as raw:
        raw.send(request)
        assert b"permessage-deflate" in await raw.reader.readuntil(b"\r\n\r\n")


def _deflated(data: bytes) -> bytes:
    made = zlib.compressobj(wbits=-15)
    return (made.compress(data) + made.flush(zlib.Z_SYNC_FLUSH))[:-4]


def _inflated(data: bytes) -> bytes:
    return zlib.decompressobj(-15).decompress(data + b"\x00\x00\xff\xff")
