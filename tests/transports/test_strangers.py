"""What a client that has proved nothing may cost: little, before anything of it is decoded."""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from typing import Any

import httpx
import pytest

from rcp_kernel.errors import BadRequest, PayloadTooLarge
from rcp_kernel.values import Encoding, dump
from rcp_kernel.wire import decode_request, peek_header
from transports.raw import BINARY, TEXT, frame, opened
from transports.robot import KEY, Site, site

CLOSED = "anonymous = false"
OPEN = '[anonymous]\nrole = "operator"'
LONG = "x" * 100_000


def write(text: str = LONG, **more: Any) -> bytes:
    return json.dumps(
        {"type": "write", "id": "w", "path": "/param/text", "body": text, **more}
    ).encode()


def deflated(data: bytes) -> bytes:
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    return (packer.compress(data) + packer.flush(zlib.Z_SYNC_FLUSH))[:-4]


@pytest.mark.parametrize("top", [CLOSED, ""])
async def test_a_stranger_may_send_short_messages_only(top: str) -> None:
    async with site(top=top) as gateway, opened(gateway) as raw:
        raw.send(frame(TEXT, write()))
        told = (await raw.reply())["error"]
        assert (told["code"], told["details"]) == ("payload_too_large", {"limit": 65_536})
        # In fragments, too: no more of them is kept than one may send.
        raw.send(frame(TEXT, write()[:50_000], fin=False), frame(0, write()[50_000:]))
        assert (await raw.reply())["error"]["code"] == "payload_too_large"
        raw.ask(type="hello", id="h", body={"token": KEY})
        hello = await raw.reply()
        assert hello["body"]["limits"]["message"] == 16 * 1024 * 1024
        raw.send(frame(TEXT, write()))
        assert (await raw.reply())["status"] == "completed"


async def test_a_stranger_is_told_how_much_it_may_send() -> None:
    async with site() as gateway, opened(gateway) as raw:
        raw.ask(type="hello", id="h")
        assert (await raw.reply())["body"]["limits"]["message"] == 65_536


async def test_what_a_stranger_sends_compressed_is_not_inflated_beyond_that() -> None:
    extension = {"Sec_WebSocket_Extensions": "permessage-deflate"}
    async with site(top=CLOSED) as gateway, opened(gateway, **extension) as raw:
        packed = deflated(write("x" * 10_000_000))
        assert len(packed) < 20_000
        raw.send(frame(TEXT, packed, rsv=4))
        assert (await raw.reply())["error"]["code"] == "payload_too_large"
        raw.send(
            frame(
                TEXT,
                deflated(json.dumps({"type": "hello", "id": "h", "body": {"token": KEY}}).encode()),
                rsv=4,
            )
        )
        assert (await raw.reply())["id"] == "h"
        raw.send(frame(TEXT, packed, rsv=4))
        assert (await raw.reply())["status"] == "completed"


def segment(num: int, data: bytes, cut: int) -> bytes:
    parts = [data[at : at + cut] for at in range(0, len(data), cut)]
    fields = {"type": "segment", "id": "t", "num": num, "total": len(parts), "size": len(data)}
    fields["sha256"] = hashlib.sha256(data).hexdigest()
    return json.dumps(fields | {"body": base64.b64encode(parts[num]).decode()}).encode()


@pytest.mark.parametrize(("top", "code"), [(CLOSED, "unauthenticated"), ("", "payload_too_large")])
async def test_segments_of_a_stranger_make_nothing_longer(top: str, code: str) -> None:
    async with site(top=top) as gateway, opened(gateway) as raw:
        raw.send(frame(TEXT, segment(0, write(), 20_000)))
        assert (await raw.reply())["error"]["code"] == code


async def test_who_may_command_without_proof_may_send_what_that_takes() -> None:
    async with site(top=OPEN) as gateway, opened(gateway) as raw:
        raw.send(frame(TEXT, write()))
        assert (await raw.reply())["status"] == "completed"
        raw.ask(type="hello", id="h")
        assert (await raw.reply())["body"]["limits"]["message"] == 16 * 1024 * 1024


@pytest.mark.parametrize("method", ["PUT", "POST"])
async def test_over_http_a_stranger_is_bound_too(gateway: Site, method: str) -> None:
    path = "/rcp/v1/messages" if method == "POST" else "/rcp/v1/context/param/text"
    async with httpx.AsyncClient(base_url=gateway.url, timeout=60.0) as client:
        for key, status in ((None, 413), (KEY, 200)):
            headers = {} if key is None else {"authorization": f"Bearer {key}"}
            content = write() if method == "POST" else json.dumps(LONG).encode()
            answer = await client.request(method, path, content=content, headers=headers)
            assert answer.status_code == status, answer.text


async def test_a_long_message_over_the_quota_is_refused_before_it_is_decoded() -> None:
    quota = "[quotas.principal]\nrequests = 0.01\nburst = 1"
    async with site(top=quota) as gateway, opened(gateway, authorization=f"Bearer {KEY}") as raw:
        raw.ask(type="ping", id="p")
        assert (await raw.reply())["status"] == "completed"
        raw.send(frame(TEXT, b'{"type":"write","id":"long","body":[[[' + b"x" * 100_000))
        told = await raw.reply()
        assert (told["type"], told["id"]) == ("write", "long")
        assert told["error"]["code"] == "rate_limited"
        raw.ask(type="execute", id="stop", path="/system/estop", body={})
        assert (await raw.reply())["status"] in ("accepted", "completed", "failed")


@pytest.mark.parametrize("encoding", [Encoding.JSON, Encoding.MSGPACK])
@pytest.mark.parametrize("name", ["k", "x-k"])
def test_an_envelope_of_many_fields_is_refused_by_its_length(encoding: Encoding, name: str) -> None:
    fields = {"type": "read", "id": "a"} | {f"{name}{number}": 1 for number in range(20_000)}
    with pytest.raises(PayloadTooLarge, match="besides its body"):
        decode_request(dump(fields, encoding), encoding)
    with pytest.raises(BadRequest, match="unknown field 'k0'"):
        decode_request(dump({"type": "write", "k0": 1, "body": LONG}, encoding), encoding)


@pytest.mark.parametrize(
    ("head", "told"),
    [
        (b'{"type":"write","id":"a","body":"', ("write", "a")),
        (b'{ "id" : "a", "type" : "nothing", "body":"', ("error", "a")),
        (b'{"body":{"id":"not this","type":"read"},"id":"a","more":"', ("error", None)),
        (b"[", ("error", None)),
    ],
)
def test_of_a_long_message_the_beginning_is_looked_at(
    head: bytes, told: tuple[str, str | None]
) -> None:
    assert peek_header(head + b"x" * 100_000, Encoding.JSON) == told


async def test_a_binary_frame_of_a_stranger_is_as_long_as_a_text(gateway: Site) -> None:
    protocol = {"Sec_WebSocket_Protocol": "rcp.v1.cbor"}
    async with opened(gateway, **protocol) as raw:
        raw.send(frame(BINARY, dump({"type": "ping", "x-a": LONG}, Encoding.CBOR)))
        _, data = await raw.frame()
        assert b"payload_too_large" in data
