"""Section 3 of the protocol: valid messages, and the replies to invalid ones."""

from __future__ import annotations

import time
from typing import Any

from rcp_gateway.testing._client import Message, encode
from rcp_gateway.testing._suite import proves
from rcp_gateway.testing.wire._base import Wire, World
from rcp_kernel.values import Encoding

__all__ = ["Envelopes"]

STATUSES = {"accepted", "pending", "in_progress", "completed", "failed", "rejected", "cancelled"}
IDS = ("c-17", "1", "ä€𝄞", "a b/c?\n", "x" * 128)
BAD_IDS: tuple[Any, ...] = ("", "x" * 129, 17, [], {})
NO_TIMES: tuple[Any, ...] = ("now", "2026-05-29", "2026-13-01T00:00:00Z", True, [], 1e300)
NO_DEADLINES: tuple[Any, ...] = (0, -1, "2", [], 1e9)
MALFORMED: tuple[Any, ...] = (
    {},
    {"path": "/sensor/level"},
    {"type": 3},
    {"type": "reed", "path": "/sensor/level"},
    {"type": "read", "path": 5},
    {"type": "read", "path": "/sensor/level", "dry_run": "yes"},
    {"type": "read", "path": "/sensor/level", "version": 1},
    {"type": "write", "path": "/param/limit", "body": 1, "valid_for": -1},
    {"type": "read", "~encoding": "cbor", "path": "/sensor/level"},
    {"type": "read", "x-": {"a": 1}, "path": "/sensor/level"},
    [],
    [{"type": "ping"}],
    "ping",
    None,
    7,
)
ANY_OF: tuple[Message, ...] = (
    {"type": "ping"},
    {"type": "read", "path": "/sensor/level"},
    {"type": "read", "path": "/sensor/asked"},
    {"type": "read", "path": "/sensor/absent"},
    {"type": "write", "path": "/param/limit", "body": 9},
    {"type": "write", "path": "/param/limit", "body": 1},
    {"type": "execute", "path": "/service/nothing"},
    {"type": "discover", "body": {"limit": 1}},
    {"type": "status"},
    {"type": "batch", "body": []},
)
NOT_TEXT = {
    Encoding.JSON: (b"", b"{", b"\xff\xfe", b'{"type": "ping"} x', b"{" * 12_000, b"NaN"),
    Encoding.CBOR: (b"", b"\xa1", b"\xff", b"\xa1\x01\x02", b"\xc1\x00", b"\x81" * 12_000),
    Encoding.MSGPACK: (b"", b"\x81", b"\xc1", b"\x81\x01\x02", b"\x91" * 12_000),
}


def _nested(encoding: Encoding, depth: int) -> bytes:
    """Encode a ping with lists nested to this depth, in a custom field."""
    if encoding is Encoding.JSON:
        return b'{"type":"ping","x-deep":' + b"[" * depth + b"]" * depth + b"}"
    if encoding is Encoding.CBOR:
        return b"\xa2\x64type\x64ping\x66x-deep" + b"\x81" * (depth - 1) + b"\x80"
    return b"\x82\xa4type\xa4ping\xa6x-deep" + b"\x91" * (depth - 1) + b"\x90"


class Envelopes(Wire):
    """The fields of a request, one by one."""

    @proves("envelope.id", "envelope.reply")
    async def test_the_answer_repeats_type_and_id(self, world: World) -> None:
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            for id_ in IDS:
                reply = await client.request("ping", id=id_)
                assert (reply["type"], reply["id"]) == ("ping", id_)
                assert reply["status"] in STATUSES
                assert reply["timestamp"].endswith("Z")

    @proves("envelope.no-id")
    async def test_a_request_without_an_id_is_answered_without_one(self, world: World) -> None:
        client = await world.client()
        await client.transmit({"type": "ping"})
        assert "id" not in await client.final(None)

    @proves("envelope.bad-id")
    async def test_an_id_that_is_none_is_refused(self, world: World) -> None:
        client = await world.client()
        for id_ in BAD_IDS:
            await client.transmit({"type": "ping", "id": id_})
            reply = await client.until(lambda m: m.get("status") == "rejected")
            assert reply["error"]["code"] == "bad_request", id_

    @proves("envelope.malformed")
    async def test_a_malformed_envelope_is_refused_and_the_connection_kept(
        self, world: World
    ) -> None:
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            for message in MALFORMED:
                await client.transmit_raw(encode(message, encoding))
                reply = await client.final(None)
                assert reply["error"]["code"] == "bad_request", message
            assert (await client.request("ping"))["status"] == "completed"

    @proves("envelope.bytes")
    async def test_what_is_not_text_of_the_encoding_is_refused_and_the_connection_kept(
        self, world: World
    ) -> None:
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            for data in NOT_TEXT[encoding]:
                await client.transmit_raw(data)
                reply = await client.final(None)
                assert reply["error"]["code"] == "bad_request", data[:20]
            assert (await client.request("ping"))["status"] == "completed"

    @proves("envelope.depth")
    async def test_what_is_nested_too_deep_is_refused_and_the_connection_kept(
        self, world: World
    ) -> None:
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            for depth in (100, 600, 900, 1_100, 12_000):
                await client.transmit_raw(_nested(encoding, depth))
                reply = await client.final(None)
                assert reply["error"]["code"] == "bad_request", depth
            assert (await client.request("ping"))["status"] == "completed"

    @proves("envelope.salvage")
    async def test_an_envelope_that_cannot_be_read_is_answered_under_its_id(
        self, world: World
    ) -> None:
        client = await world.client()
        assert (await client.request("reed", id="a"))["id"] == "a"
        await client.transmit_raw(b'{"type": "ping", "id": "b", }')
        assert (await client.final("b"))["error"]["code"] == "bad_request"

    @proves("envelope.types")
    async def test_a_type_that_is_none_is_refused_with_those_that_are(self, world: World) -> None:
        reply = await (await world.client()).request("reed")
        assert reply["error"]["code"] == "bad_request"
        assert all(word in reply["message"] for word in ("read", "subscribe", "hello", "batch"))

    @proves("envelope.unknown-field")
    async def test_an_unknown_field_is_refused_and_named(self, world: World) -> None:
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            reply = await client.request("read", "/sensor/level", deadlin=2)
            assert reply["error"]["code"] == "bad_request"
            assert "deadlin" in reply["message"]

    @proves("envelope.custom")
    async def test_fields_of_the_clients_own_come_back(self, world: World) -> None:
        world.publish("sensor/level", 1.0)
        custom = {"x-note": "hällo", "x-deep": {"a": [1, None, True]}}
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            for request in ANY_OF:
                reply = await client.final(await client.send(request, **custom))
                assert {k: reply.get(k) for k in custom} == custom, (request, reply)

    @proves("envelope.custom-command")
    async def test_fields_of_the_clients_own_stay_on_the_command(self, world: World) -> None:
        client = await world.client()
        go: Message = {"type": "execute", "path": "/action/go", "body": {"distance": 1}}
        id_ = await client.send(go, **{"x-mission": "m-1"})
        assert {reply["x-mission"] for reply in await client.replies(id_)} == {"m-1"}
        listed = await client.request("read", "/system/commands")
        assert "m-1" in str(listed["body"])

    @proves("envelope.version")
    async def test_another_version_is_refused_with_those_that_are_spoken(
        self, world: World
    ) -> None:
        client = await world.client()
        assert (await client.request("ping", version="1"))["status"] == "completed"
        reply = await client.request("ping", version="2")
        assert reply["error"]["code"] == "version_unsupported"
        assert reply["error"]["details"]["supported"] == ["1"]

    @proves("envelope.timestamp")
    async def test_a_timestamp_is_a_time_in_either_form(self, world: World) -> None:
        client = await world.client()
        moment = time.time()
        iso = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(moment))
        good = (f"{iso}Z", f"{iso}.123456789Z", int(moment), moment, 0, "1999-12-31T23:59:59Z")
        for stamp in good:
            assert (await client.request("ping", timestamp=stamp))["status"] == "completed", stamp
        for stamp in (*NO_TIMES, iso):
            reply = await client.request("ping", timestamp=stamp)
            assert reply["error"]["code"] == "bad_request", stamp

    @proves("envelope.stale")
    async def test_a_command_from_another_time_is_stale_and_changes_nothing(
        self, world: World
    ) -> None:
        client = await world.client()
        drive = {"linear": {"x": 0.5}}
        for stamp in (time.time() - 2, time.time() + 5):
            reply = await client.request("write", "/actuator/drive", body=drive, timestamp=stamp)
            assert (reply["status"], reply["error"]["code"]) == ("rejected", "stale_command")
        assert world.robot().writes == []
        now = time.time()
        good = await client.request("write", "/actuator/drive", body=drive, timestamp=now)
        assert good["status"] == "completed"

    @proves("envelope.deadline")
    async def test_the_answer_comes_within_the_deadline(self, world: World) -> None:
        client = await world.client()
        for request in (
            {"type": "read", "path": "/sensor/silent"},
            {"type": "write", "path": "/param/slow", "body": 1},
            {"type": "execute", "path": "/action/go", "body": {"distance": 1, "mode": "wait"}},
        ):
            started = time.monotonic()
            reply = await client.final(await client.send(request, deadline=0.2))
            assert reply["error"]["code"] == "deadline_exceeded", reply
            assert "within 0.2 s" in reply["message"] or "in time" in reply["message"]
            assert time.monotonic() - started > 0.15
        assert world.robot().stopped == ["action/go"]

    @proves("envelope.bad-deadline")
    async def test_a_deadline_that_is_none_is_refused(self, world: World) -> None:
        client = await world.client()
        for deadline in NO_DEADLINES:
            reply = await client.request("read", "/sensor/asked", deadline=deadline)
            assert reply["error"]["code"] == "bad_request", deadline

    @proves("envelope.in-flight")
    async def test_a_slow_answer_holds_no_other_back(self, world: World) -> None:
        client = await world.client()
        slow = await client.send(type="read", path="/sensor/silent", deadline=0.5)
        assert (await client.request("ping"))["status"] == "completed"
        assert not [message for message in client.inbox if message["id"] == slow]
        assert (await client.final(slow))["error"]["code"] == "deadline_exceeded"

    @proves("envelope.duplicate")
    async def test_an_id_in_flight_cannot_be_used_again(self, world: World) -> None:
        client = await world.client()
        read: Message = {"type": "read", "path": "/sensor/silent", "id": "x", "deadline": 1.5}
        await client.send(read)
        await client.send(read)
        replies = [await client.final("x"), await client.final("x")]
        assert [r["error"]["code"] for r in replies] == ["duplicate_request", "deadline_exceeded"]
        assert (await client.request("ping", id="x"))["status"] == "completed"

    @proves("envelope.ping")
    async def test_a_ping_is_answered(self, world: World) -> None:
        assert (await (await world.client()).request("ping"))["status"] == "completed"
