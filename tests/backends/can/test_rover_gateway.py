"""A differential drive behind the gateway: set-points that lapse, two clients, profiles, limits."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import can

import rcp_can
from backends.can.rig import channel
from backends.can.rover import Truth, rover_bench, tables, twins
from rcp_gateway.testing import eventually
from rcp_gateway.testing._serve import ADMIN, OPERATOR, serve_backend
from rcp_gateway.testing.backend import Robot

CMD_VEL, MOVE_TO = "actuator/cmd_vel", "action/move_to"
FORWARD = {"linear": {"x": 0.3}}


@asynccontextmanager
async def robot() -> AsyncGenerator[tuple[Robot, Truth]]:
    name = channel()
    line = can.Bus(name, "virtual", ignore_config=True)
    with rover_bench(line) as bench:
        async with serve_backend(next(iter(rcp_can.rcp_backends())), tables(name)) as served:
            await served.supervisor.settled.wait()
            found = Robot(served)

            async def enabled() -> bool:  # a drive whose process is held up may be late
                return (await found.ask("execute", "service/enable"))["status"] == "completed"

            await eventually(enabled, "it is enabled")
            yield found, twins(bench)[2]


async def moves(truth: Truth) -> None:
    async def moving() -> bool:
        return truth.moving[0] > 0.2

    await eventually(moving, "it moves")


async def rests(truth: Truth) -> None:
    async def resting() -> bool:
        return truth.still()

    await eventually(resting, "it rests")


async def test_a_velocity_that_lapses_stops_both_wheels() -> None:
    async with robot() as (rover, truth):
        assert (await rover.ask("write", CMD_VEL, body=FORWARD))["status"] == "completed"
        await moves(truth)
        await rests(truth)  # nobody wrote again
        assert abs(truth.heading) < 0.02
        assert (await rover.ask("write", CMD_VEL, body=FORWARD))["status"] == "completed"
        await moves(truth)


async def test_another_client_cannot_drive_what_an_action_drives() -> None:
    async with robot() as (rover, truth):
        far = {"position": {"x": 5.0, "y": 0.0}, "frame": "odom"}
        moving = await rover.begin(MOVE_TO, far)
        await moves(truth)
        other = rover.served.client(ADMIN)
        for name, body in ((CMD_VEL, FORWARD), ("actuator/left/velocity", 1.0)):
            refused = await other.request("write", rover.path(name), body=body)
            assert refused["error"]["code"] == "mode_forbids", refused
        stop = await other.request("write", rover.path(CMD_VEL), body={})
        assert stop["status"] == "completed", stop
        ended = await rover.client.final(moving)
        assert ended["status"] == "failed", ended
        assert "velocity of zero" in ended["error"]["message"]
        await rests(truth)


async def test_a_stop_in_a_move_leaves_both_wheels_stopped_until_they_are_enabled_again() -> None:
    async with robot() as (rover, truth):
        far = {"position": {"x": 5.0, "y": 0.0}, "frame": "odom"}
        moving = await rover.begin(MOVE_TO, far)
        await moves(truth)
        admin = rover.served.client(ADMIN)
        stop = await admin.request("execute", "/system/estop", body={"reason": "test"})
        assert stop["status"] == "completed", stop
        assert truth.still()
        assert (await rover.client.final(moving))["status"] != "completed"
        refused = await rover.ask("write", CMD_VEL, body=FORWARD)
        assert refused["error"]["code"] == "estop_active", refused
        await admin.request("execute", "/system/estop", body={"reset": True})
        assert truth.still()


async def test_limits_and_profiles_are_told_to_clients() -> None:
    async with robot() as (rover, _):
        resources: dict[str, Any] = rover.resources
        assert resources[CMD_VEL].profiles == ("drive/1.0", "mobile/1.1")
        assert resources["service/reset_system"].profiles == ("power/1.0",)
        client = rover.served.client(OPERATOR)
        for name, body in ((CMD_VEL, {"linear": {"x": 2.0}}), ("param/speed_limit", 2.0)):
            refused = await client.request("write", rover.path(name), body=body)
            assert refused["error"]["code"] == "out_of_range", refused
        limit = await client.request("read", rover.path("param/speed_limit"))
        assert limit["body"] == 1.0
