"""Batches: what they cost and how long their answers are is bounded, whatever stands in them."""

from __future__ import annotations

from typing import Any

import pytest

from kernel.world import World, world_of
from rcp_kernel.model import Resource
from rcp_requests.pages import MOST_BATCH

pytestmark = pytest.mark.anyio
LONG = "x" * (MOST_BATCH // 8)
ECHO = {"type": "execute", "path": "/service/echo", "body": LONG}
QUICK = {"type": "execute", "path": "/service/echo", "body": "quick"}
SLOW = {"type": "execute", "path": "/action/go", "body": 4.0}
TEXT = Resource(name="sensor/text", description="A text.", value=str, live=True)


async def test_reads_beyond_the_room_of_a_batch_are_referred_to_requests_of_their_own() -> None:
    async with world_of() as world:
        client = world.client()
        world.robot.add(TEXT)
        world.robot.host.publish("sensor/text", LONG)
        reads = [{"type": "read", "path": "/sensor/text", "id": f"r{n}"} for n in range(20)]
        reply = await client.ask(type="batch", body=reads)
        received = [part for part in reply["body"] if "body" in part]
        left = [part for part in reply["body"] if "error" in part]
        assert (len(received), len(received) + len(left)) == (7, 20)  # with their quotes, seven fit
        assert {part["body"] for part in received} == {LONG}
        assert [part["id"] for part in reply["body"]] == [f"r{n}" for n in range(20)]
        assert {part["error"]["code"] for part in left} == {"payload_too_large"}
        assert left[0]["error"]["remedy"] == "Send this request on its own, not in a batch."
        assert len((await client.ask(**reads[-1]))["body"]) == len(LONG)


async def test_the_first_answer_of_a_batch_is_told_however_long_it_is() -> None:
    async with world_of() as world:
        world.robot.add(TEXT)
        world.robot.host.publish("sensor/text", LONG * 10)
        read = {"type": "read", "path": "/sensor/text"}
        reply = await world.client().ask(type="batch", body=[read, read])
        first, second = reply["body"]
        assert len(first["body"]) == len(LONG) * 10
        assert second["error"]["code"] == "payload_too_large"


async def test_what_has_happened_is_never_told_as_a_failure_for_want_of_room() -> None:
    async with world_of() as world:
        reply = await world.client().ask(type="batch", body=[ECHO] * 10)
        told = [(part["status"], part.get("truncated", False)) for part in reply["body"]]
        assert told == [("completed", False)] * 7 + [("completed", True)] * 3
        assert all("body" not in part and "command" in part for part in reply["body"][7:])


@pytest.mark.parametrize("body", [{}, {"reason": "reset the arm first"}])
async def test_an_estop_goes_before_the_rest_of_its_batch(body: dict[str, Any]) -> None:
    async with world_of() as world:
        parts: list[dict[str, Any]] = [
            {"type": "write", "path": "/actuator/drive", "body": {"linear": {"x": 0.5}}},
            {"type": "execute", "path": "/system/estop", "body": body},
        ]
        reply = await world.client().ask(type="batch", body=parts)
        write, stop = reply["body"]
        assert (write["error"]["code"], stop["status"]) == ("estop_active", "completed")


@pytest.mark.parametrize("size", [257, 100_000])
async def test_a_batch_that_is_too_long_is_not_read_to_its_end(world: World, size: int) -> None:
    reply = await world.client().ask(type="batch", body=[1] * size)
    assert reply["error"]["code"] == "bad_request"
    assert reply["message"] == "a batch has at most 256 envelopes"


async def test_a_part_that_takes_long_keeps_no_other_from_its_turn(world: World) -> None:
    client = world.client()
    batch = client.send(type="batch", body=[SLOW, QUICK, {"type": "cancel", "path": "/action/go"}])
    slow, quick, cancel = (await client.final(batch))["body"]
    assert (slow["status"], quick["body"], cancel["status"]) == ("cancelled", "quick", "completed")
