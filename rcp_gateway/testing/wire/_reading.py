"""Reads and writes: the values returned, their sources, and the effect on the robot."""

from __future__ import annotations

import itertools

from rcp_gateway.testing._client import Client, Message
from rcp_gateway.testing._serve import ADMIN
from rcp_gateway.testing._suite import eventually, proves
from rcp_gateway.testing.wire._base import Wire, World
from rcp_kernel.clock import parse_time
from rcp_kernel.types import LinearVelocity, Point, PoseStamped, Twist

__all__ = ["Reading"]

FORWARD = {"linear": {"x": 0.5}}
DRIVE = "/actuator/drive"


class Reading(Wire):
    """The two plainest requests."""

    @proves("read.sample")
    async def test_a_read_carries_value_time_and_number(self, world: World) -> None:
        world.publish("sensor/level", 1.0, 2.0)
        numbers = itertools.count(3)
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)

            async def is_fresh(client: Client = client) -> bool:
                world.robot().host.publish("sensor/level", 3.0, 1_700_000_000_123_456_789)
                reply = await client.request("read", "/sensor/level")
                assert (reply["body"], reply["seq"]) == (3.0, next(numbers))
                assert parse_time(reply["source_timestamp"]) == 1_700_000_000_123_456_789
                assert parse_time(reply["timestamp"]) > 1_700_000_000_123_456_789
                return reply["state"] == "fresh"

            # On a busy machine an answer may take longer than the value is fresh.
            await eventually(is_fresh, "a value that has just come is fresh")

    @proves("read.asked")
    async def test_what_is_not_published_is_asked_of_the_robot(self, world: World) -> None:
        client = await world.client()
        for number in (1, 2):
            reply = await client.request("read", "/sensor/asked")
            assert (reply["body"], reply["seq"]) == (3.0, number)
        assert world.robot().reads == ["sensor/asked"] * 2

    @proves("read.watched")
    async def test_what_comes_only_while_watched_is_watched_for_a_read(self, world: World) -> None:
        reply = await (await world.client()).request("read", "/sensor/lazy")
        assert reply["body"] == 7.0
        robot = world.robot()

        async def left() -> bool:
            return robot.left == ["sensor/lazy"]

        await eventually(left, "the source is let go of")

    @proves("read.fields")
    async def test_a_read_projects_on_fields(self, world: World) -> None:
        world.publish("sensor/pose", PoseStamped(Point(1.0, 2.0, 3.0), frame_id="odom"))
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            fields = {"fields": ["position.x", "frame_id"]}
            reply = await client.request("read", "/sensor/pose", body=fields)
            assert reply["body"] == {"position": {"x": 1.0}, "frame_id": "odom"}
            bad = await client.request("read", "/sensor/pose", body={"fields": ["position.w"]})
            assert bad["error"]["code"] == "filter_unsupported"

    @proves("read.fresh")
    async def test_a_read_may_insist_on_asking_the_robot(self, world: World) -> None:
        robot = world.robot()
        robot.values["sensor/level"] = 5.0
        world.publish("sensor/level", 1.0)
        client = await world.client()
        assert (await client.request("read", "/sensor/level"))["body"] == 1.0
        reply = await client.request("read", "/sensor/level", body={"fresh": True})
        assert (reply["body"], robot.reads) == (5.0, ["sensor/level"])

    @proves("read.many")
    async def test_a_pattern_reads_many_and_one_that_fails_spoils_none(self, world: World) -> None:
        world.publish("sensor/level", 1.0)
        world.robot("drone").host.publish("sensor/level", 2.0)
        client = await world.client()
        reply = await client.request("read", "/sensor/**", deadline=0.5)
        found = {item["path"].removeprefix("/tenant/alpha/sensor/"): item for item in reply["body"]}
        assert reply["status"] == "completed"
        assert (found["level"]["body"], found["drone1/level"]["body"]) == (1.0, 2.0)
        assert found["level"]["status"] == "completed"
        assert found["asked"]["body"] == 3.0
        assert found["ghost/level"]["error"]["code"] == "adapter_unavailable"
        assert found["late"]["error"]["code"] == "device_timeout"
        assert (await client.request("read", "/sensor/nothing/*"))["body"] == []

    @proves("read.stale")
    async def test_a_value_whose_source_has_stopped_is_stale(self, world: World) -> None:
        client = await world.client()

        async def stale() -> bool:
            return (await client.request("read", "/sensor/level"))["state"] == "stale"

        async def fresh() -> bool:
            world.publish("sensor/level", 1.0)
            return not await stale()

        await eventually(fresh, "a value that has just come is fresh")
        await eventually(stale, "a value past its deadline is stale")
        await eventually(fresh, "the next one is fresh again")

    @proves("write.completed", "write.cut")
    async def test_a_completed_write_has_changed_the_robot(self, world: World) -> None:
        robot = world.robot()
        for encoding in self.encodings:
            client = await world.client(encoding=encoding)
            for value in (2.0, 0.25):
                reply = await client.request("write", "/param/limit", body=value)
                assert (reply["status"], reply["body"]) == ("completed", value)
                assert robot.values["param/limit"] == value
                assert (await client.request("read", "/param/limit"))["body"] == value
            cut = await client.request("write", "/param/cut", body=5.0)
            assert (cut["status"], cut["body"], robot.values["param/cut"]) == (
                "completed",
                1.0,
                1.0,
            )

    @proves("write.read-back")
    async def test_a_read_of_an_actuator_gives_what_was_last_commanded(self, world: World) -> None:
        client = await world.client()
        await client.request("write", DRIVE, body=FORWARD, valid_for=5.0)
        assert (await client.request("read", DRIVE))["body"]["linear"]["x"] == 0.5
        assert world.robot().writes == [("actuator/drive", Twist(LinearVelocity(0.5)))]

    @proves("write.deadman")
    async def test_a_write_that_nobody_renews_lapses_to_the_safe_value(self, world: World) -> None:
        client, robot = await world.client(), world.robot()
        await client.request("write", DRIVE, body=FORWARD, valid_for=0.05)

        async def at_rest() -> bool:
            return robot.writes[-1] == ("actuator/drive", Twist())

        async def is_reported() -> bool:
            return (await client.request("read", DRIVE))["body"]["linear"]["x"] == 0.0

        await eventually(at_rest, "the safe value is written")
        assert len(robot.writes) == 2
        await eventually(is_reported, "it is read back")

    @proves("write.valid-for")
    async def test_valid_for_without_a_safe_value_is_refused(self, world: World) -> None:
        client = await world.client()
        reply = await client.request("write", "/param/limit", body=1.0, valid_for=1.0)
        assert reply["error"]["code"] == "bad_request"
        assert world.robot().writes == []

    @proves("write.estop")
    async def test_under_an_estop_nothing_moves_until_somebody_who_may_resets_it(
        self, world: World
    ) -> None:
        viewer, operator = await world.client(None), await world.client()
        admin, robot = await world.client(ADMIN), world.robot()
        stop = await viewer.request("execute", "/system/estop", body={"scope": "main"})
        assert (stop["status"], stop["body"]["active"]) == ("completed", True)
        assert robot.halts == 1
        go: Message = {"type": "execute", "path": "/action/go", "body": {"distance": 1}}
        write: Message = {"type": "write", "path": DRIVE, "body": FORWARD}
        for request in (go, write):
            reply = await operator.final(await operator.send(request))
            assert (reply["status"], reply["error"]["code"]) == ("rejected", "estop_active")
        assert (await operator.request("write", "/param/limit", body=1.0))["status"] == "completed"
        reset = {"scope": "main", "reset": True}
        denied = await operator.request("execute", "/system/estop", body=reset)
        assert denied["error"]["code"] == "forbidden"
        done = await admin.request("execute", "/system/estop", body=reset)
        assert done["body"]["active"] is False
        assert robot.ran == []
        assert (await operator.final(await operator.send(go)))["status"] == "completed"
