"""Envelopes: what is no request is refused in words, with the id that could be read."""

from __future__ import annotations

import itertools
from typing import cast

import cbor2
import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kernel.world import World
from rcp_kernel.clock import iso, iso_bytes, parse_time
from rcp_kernel.errors import BY_CODE, BadRequest, RcpError, VersionUnsupported
from rcp_kernel.values import Encoding, parse
from rcp_kernel.wire import Reply, decode_request, encode_reply, failure, peek_header

ENCODE = {
    Encoding.JSON: msgspec.json.encode,
    Encoding.MSGPACK: msgspec.msgpack.encode,
    Encoding.CBOR: cbor2.dumps,
}


@pytest.mark.parametrize("encoding", list(Encoding))
def test_a_request_reads_the_same_in_every_encoding(encoding: Encoding) -> None:
    envelope = {"type": "write", "path": "/param/x", "id": "c", "body": [1, 2.5], "x-trace": "t"}
    request = decode_request(ENCODE[encoding](envelope), encoding)
    assert (request.type, request.path, request.id) == ("write", "/param/x", "c")
    assert request.custom == {"x-trace": "t"}
    assert parse(request.body, request.encoding) == [1, 2.5]


@pytest.mark.parametrize("encoding", list(Encoding))
def test_a_reply_repeats_custom_fields_and_reads_the_same(encoding: Encoding) -> None:
    reply = Reply(type="read", id="c", path="/p", body={"x": 1.5}, seq=3, custom={"x-trace": "t"})
    assert parse(encode_reply(reply, encoding), encoding) == {
        "type": "read", "id": "c", "path": "/p", "status": "completed", "body": {"x": 1.5},
        "seq": 3, "x-trace": "t",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("text", "part"),
    [
        (b"", "empty"),
        (b"[]", "Expected `object`"),
        (b'{"type": "fly"}', "`type` must be one of read, write"),
        (b'{"type": "read", "paht": "/x"}', "unknown field 'paht'"),
        (b'{"type": "read", "id": 7}', "$.id"),
        (b'{"type": "read", "id": ""}', "$.id"),
        (b'{"type": "read", "deadline": 0}', "$.deadline"),
        (b'{"type": "read", "timestamp": "noon"}', "'noon' is not a timestamp"),
        (b'{"type": "read", "x-": 1}', "unknown field 'x-'"),
        (b'{"type": "write", "body": NaN}', "malformed"),
    ],
)
def test_what_is_no_request_is_refused_in_words(text: bytes, part: str) -> None:
    with pytest.raises(BadRequest) as caught:
        decode_request(text, Encoding.JSON)
    assert part in caught.value.message


def test_an_unknown_version_is_answered_with_those_that_are_known() -> None:
    with pytest.raises(VersionUnsupported) as caught:
        decode_request(b'{"type":"ping","version":"2"}', Encoding.JSON)
    assert caught.value.details == {"supported": ["1"]}


@pytest.mark.parametrize(
    "text",
    [b'{"type":"write","id":"c-7","body":NaN}', b'{"id":"c-7","type":"write","body":"\xff"}'],
)
def test_the_id_of_a_broken_message_is_found_where_it_can_be(text: bytes) -> None:
    assert peek_header(text, Encoding.JSON)[1] == "c-7"


@given(st.binary(max_size=200), st.sampled_from(list(Encoding)))
def test_random_bytes_are_a_request_or_a_typed_refusal(data: bytes, encoding: Encoding) -> None:
    try:
        decode_request(data, encoding)
    except RcpError as error:
        type_, id_ = peek_header(data, encoding)
        encode_reply(failure(error, type_, id_), encoding)


def test_every_code_has_an_http_status_a_remedy_and_a_final_status() -> None:
    for code, error in BY_CODE.items():
        reply = failure(error("why"), "read")
        assert reply.final
        assert reply.error is not None
        assert reply.error["code"] == code
        assert reply.error["remedy"]
        assert 400 <= error.http < 600


@given(st.integers(0, 2**62))
def test_a_time_written_is_the_time_read(ns: int) -> None:
    assert [parse_time(iso(ns)) for _ in range(2)] == [ns, ns]
    assert [iso_bytes(ns) for _ in range(2)] == [iso(ns).encode()] * 2


def test_a_time_of_numpy_spoils_no_other() -> None:
    ns = 1_800_000_000_123_456_789
    assert iso(cast("int", np.int64(ns))) == iso(ns)
    assert iso_bytes(ns + 1) == iso(ns + 1).encode()
    assert iso_bytes(cast("int", np.int64(ns))) == iso(ns).encode()


@pytest.mark.parametrize("digits", ["+50000000", "25_000_000", " 25000000", "25000000 "])
def test_digits_that_are_none_are_no_time(digits: str) -> None:
    assert parse_time("2026-05-29T16:12:04.250000000Z")
    with pytest.raises(BadRequest):
        parse_time(f"2026-05-29T16:12:04.{digits.ljust(9)[:9]}Z")


@pytest.mark.parametrize(
    ("text", "ns"),
    [
        ("2026-05-29T14:12:04Z", 1_780_063_924_000_000_000),
        ("2026-05-29T14:12:04.5Z", 1_780_063_924_500_000_000),
        ("2026-05-29T16:12:04+02:00", 1_780_063_924_000_000_000),
        ("2026-05-29T16:12:04.2500+02:00", 1_780_063_924_250_000_000),  # as long as the next one
        ("2026-05-29T16:12:04.250000000Z", 1_780_071_124_250_000_000),
        ("2026-05-29T16:12:04.250000000z", 1_780_071_124_250_000_000),
        (1_780_063_924, 1_780_063_924_000_000_000),
        (1.5, 1_500_000_000),
    ],
)
def test_a_time_is_iso_or_seconds(text: str | float, ns: int) -> None:
    assert [parse_time(text) for _ in range(2)] == [ns, ns]  # once read and once remembered


@pytest.mark.anyio
async def test_a_request_is_answered_alike_at_once_and_by_its_handler(world: World) -> None:
    world.robot.host.publish("sensor/level", 1.5)
    quick, common = world.client(), world.client()
    common.connection._at_once = {}  # noqa: SLF001 - the shortcut is compared with the usual way
    asked = ({"type": "read", "path": "/tenant/alpha/sensor/level"}, {"type": "ping"})
    for request, id_ in itertools.product(asked, ("a", 'quo"te', "ünï")):
        replies = [await client.ask(id=id_, **request) for client in (quick, common)]
        for reply in replies:
            del reply["timestamp"]
        assert replies[0] == replies[1]
        assert list(replies[0]) == list(replies[1])
    world.robot.host.publish("sensor/level", float("nan"))
    refusals = [
        await c.ask(type="read", path="/tenant/alpha/sensor/level") for c in (quick, common)
    ]
    assert [r["error"]["code"] for r in refusals] == ["device_rejected"] * 2
