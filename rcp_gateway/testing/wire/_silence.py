"""Section 3 of the contract: never silent, and every error says what to do."""

from __future__ import annotations

from typing import Any

from rcp_gateway.testing._client import BOUND, Client, Message
from rcp_gateway.testing._serve import VIEWER
from rcp_gateway.testing._suite import proves
from rcp_gateway.testing.wire._base import Wire, World

__all__ = ["Silence"]

FINAL = {"completed", "failed", "rejected", "cancelled"}
WAIT = {"distance": 1.0, "mode": "wait"}
MIXED: tuple[tuple[Message, str | None], ...] = (
    ({"type": "read", "path": "/sensor/level"}, None),
    ({"type": "write", "path": "/param/limit", "body": 1.0}, None),
    ({"type": "execute", "path": "/service/nothing"}, None),
    ({"type": "read", "path": "/sensor/absent"}, "unknown_path"),
    ({"type": "read", "path": "nowhere"}, "invalid_path"),
    ({"type": "write", "path": "/param/limit", "body": 99}, "out_of_range"),
    ({"type": "write", "path": "/param/limit", "body": "fast"}, "invalid_value"),
    ({"type": "write", "path": "/sensor/level", "body": 1}, "unsupported_operation"),
    ({"type": "write", "path": "/param/refused", "body": 1}, "device_rejected"),
    ({"type": "read", "path": "/sensor/ghost/level"}, "adapter_unavailable"),
    ({"type": "read", "path": "/sensor/silent", "deadline": 0.5}, "deadline_exceeded"),
    ({"type": "read", "path": "/sensor/crashed"}, "internal"),
    ({"type": "read", "path": "/sensor/late"}, "device_timeout"),
    ({"type": "ping", "version": "9"}, "version_unsupported"),
    ({"type": "dance"}, "bad_request"),
    ({"type": "execute", "path": "/action/short", "body": WAIT}, None),
)
"""Valid, invalid and unanswerable requests, each with its final code; None allows any."""


async def _flood(client: Client, count: int) -> dict[str, list[Message]]:
    """Send `count` mixed requests at once and collect every final reply by id."""
    wanted = {f"m-{i}" for i in range(count)}
    for i in range(count):
        await client.send({"deadline": BOUND, **MIXED[i % len(MIXED)][0]}, id=f"m-{i}")
    found: dict[str, list[Message]] = {}
    for _ in range(count):
        reply = await client.until(lambda m: m.get("status") in FINAL)
        found.setdefault(reply["id"], []).append(reply)
    assert set(found) == wanted
    assert (await client.request("ping"))["status"] == "completed"
    found["late"] = [m for m in client.inbox if m.get("status") in FINAL]
    return found


def _check(found: dict[str, list[Message]], *also: str) -> None:
    assert found.pop("late") == []
    for id_, replies in found.items():
        assert len(replies) == 1, id_
        code = MIXED[int(id_[2:]) % len(MIXED)][1]
        assert code is None or replies[0]["error"]["code"] in (code, *also), replies


class Silence(Wire):
    """Whatever happens, there is one answer, and it helps."""

    @proves("silence.mixed")
    async def test_a_thousand_mixed_requests_get_a_thousand_final_replies(
        self, world: World
    ) -> None:
        world.publish("sensor/level", 1.0)
        client = await world.client()
        # All at once may take a busy machine longer than the gateway lets any of them wait.
        _check(await _flood(client, 1000), "deadline_exceeded")

    @proves("silence.mixed-plain")
    async def test_every_one_of_many_mixed_requests_is_answered_once(self, world: World) -> None:
        world.publish("sensor/level", 1.0)
        _check(await _flood(await world.client(), 64))

    @proves("silence.unknown")
    async def test_what_nobody_can_serve_is_answered_with_the_reason(self, world: World) -> None:
        client = await world.client()
        for request in (
            {"type": "read"},
            {"type": "write", "body": 1},
            {"type": "execute"},
            {"type": "cancel"},
            {"type": "cancel", "command": "cmd-never-was"},
        ):
            reply = await client.final(await client.send(request))
            assert reply["status"] == "rejected", reply
            assert reply["error"]["remedy"], reply

    @proves("silence.dead")
    async def test_a_backend_that_is_not_there_is_told_at_once(self, world: World) -> None:
        client = await world.client()
        for request in (
            {"type": "read", "path": "/sensor/ghost/level"},
            {"type": "write", "path": "/param/ghost/limit", "body": 1.0},
            {"type": "execute", "path": "/action/ghost/go", "body": {"distance": 1.0}},
        ):
            reply = await client.final(await client.send(request))
            assert reply["error"]["code"] == "adapter_unavailable", reply
            assert reply["error"]["origin"] == "ghost"
            assert reply["error"]["retryable"] is True
            assert "nobody answers" in reply["message"]

    @proves("silence.dies")
    async def test_a_command_whose_backend_dies_midway_ends_with_the_reason(
        self, world: World
    ) -> None:
        client = await world.client()
        id_ = await client.send(type="execute", path="/action/go", body=WAIT)
        await client.until(lambda m: m.get("status") == "in_progress")
        world.robot().host.report("the battery fell out", down=True)
        reply = await client.final(id_)
        assert (reply["status"], reply["error"]["code"]) == ("failed", "adapter_unavailable")
        assert "battery fell out" in reply["message"]

    @proves("silence.size")
    async def test_a_message_that_is_too_long_is_told_as_such(self, world: World) -> None:
        client = await world.client()
        id_ = await client.send(type="write", path="/param/label", body="x" * 300_000)
        reply = await client.until(lambda m: m.get("status") == "rejected")
        assert reply["error"]["code"] == "payload_too_large"
        assert reply["error"]["details"]["limit"] == 262144
        assert reply.get("id") in (None, id_)

    @proves("error.shape")
    async def test_an_error_says_all_that_the_contract_lists(self, world: World) -> None:
        client = await world.client()
        reply = await client.request("write", "/param/limit", body=9)
        error = reply["error"]
        assert error.keys() >= {
            *("code", "message", "origin", "path", "remedy", "retryable", "details", "trace_id")
        }
        assert error["message"] == reply["message"]
        assert error["path"] == reply["path"] == "/tenant/alpha/param/limit"
        assert (error["origin"], error["retryable"]) == ("gateway", False)

    @proves("error.range")
    async def test_out_of_range_names_field_value_bound_and_unit(self, world: World) -> None:
        client = await world.client()
        reply = await client.request("write", "/param/limit", body=9.0)
        message = (
            "Failed to apply configuration: parameter 'limit' exceeds allowed range: 9.0 > 2.5 m/s"
        )
        assert (reply["error"]["code"], reply["message"]) == ("out_of_range", message)
        body = {"distance": -200.5}
        deep = (await client.request("execute", "/action/go", body=body))["error"]
        assert (deep["code"], deep["details"]["pointer"]) == ("out_of_range", "/distance")
        assert "-200.5" in deep["message"]
        assert deep["details"]["unit"] == "m"

    @proves("error.pointer")
    async def test_a_value_that_fails_the_schema_names_the_field(self, world: World) -> None:
        client = await world.client()
        bad: tuple[tuple[Any, str], ...] = (
            ({"linear": {"x": "fast"}}, "/linear/x"),
            ({"linear": [1, 2]}, "/linear"),
            ("forward", ""),
        )
        for body, pointer in bad:
            error = (await client.request("write", "/actuator/drive", body=body))["error"]
            assert (error["code"], error["details"]["pointer"]) == ("invalid_value", pointer)

    @proves("error.unsupported")
    async def test_what_a_resource_does_not_offer_is_refused_with_what_it_does(
        self, world: World
    ) -> None:
        client = await world.client()
        for type_, path, allowed in (
            ("write", "/sensor/level", ["read", "subscribe"]),
            ("execute", "/param/limit", ["read", "write", "subscribe"]),
            ("read", "/action/go", ["execute"]),
            ("write", "/param/fixed", ["read"]),
        ):
            fields = {} if type_ == "read" else {"body": 1}
            error = (await client.request(type_, path, **fields))["error"]
            assert error["code"] == "unsupported_operation"
            assert error["details"]["allowed"] == allowed

    @proves("error.forbidden", "rights.anonymous")
    async def test_what_the_principal_may_not_do_is_forbidden(self, world: World) -> None:
        world.publish("sensor/level", 1.0)
        for token in (VIEWER, None):
            client = await world.client(token)
            assert (await client.request("read", "/sensor/level"))["body"] == 1.0
            for type_, path, body in (
                ("write", "/param/limit", 1),
                ("execute", "/action/go", {"distance": 1}),
            ):
                reply = await client.request(type_, path, body=body)
                assert (reply["status"], reply["error"]["code"]) == ("rejected", "forbidden")
        assert (world.robot().writes, world.robot().ran) == ([], [])

    @proves("error.device-rejected", "error.device-timeout", "error.link")
    async def test_what_the_robot_makes_of_it_has_a_code_of_its_own(self, world: World) -> None:
        client = await world.client()
        refused = await client.request("write", "/param/refused", body=1.0)
        assert refused["error"]["code"] == "device_rejected"
        assert "the valve is locked" in refused["message"]
        late = await client.request("read", "/sensor/late")
        assert (late["status"], late["error"]["code"]) == ("failed", "device_timeout")
        cut = await client.request("read", "/sensor/cut")
        assert cut["error"]["code"] == "adapter_unavailable"
        assert refused["error"]["origin"] == late["error"]["origin"] == "main"

    @proves("error.internal")
    async def test_a_crash_says_nothing_of_the_code(self, world: World) -> None:
        client = await world.client()
        crash = {"distance": 1, "mode": "crash"}
        for reply in (
            await client.request("read", "/sensor/crashed"),
            await client.request("execute", "/action/go", body=crash),
        ):
            assert (reply["status"], reply["error"]["code"]) == ("failed", "internal")
            assert reply["error"]["trace_id"]
            assert "secret" not in str(reply)
            assert "Traceback" not in str(reply)
            assert "ZeroDivision" not in str(reply)

    @proves("error.queue-full")
    async def test_more_than_may_be_in_flight_is_queue_full(self, world: World) -> None:
        client = await world.client()
        world.limit(in_flight=8)
        ids = [await client.send(type="read", path="/sensor/silent") for _ in range(9)]
        reply = await client.final(ids[-1])
        assert (reply["error"]["code"], reply["error"]["retryable"]) == ("queue_full", True)
        for id_ in ids[:-1]:
            assert (await client.final(id_))["error"]["code"] == "deadline_exceeded"
