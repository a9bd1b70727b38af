"""The state of one robot of a backend: it is down, and the others are not touched."""

from __future__ import annotations

from collections.abc import AsyncGenerator

import pytest
from prometheus_client.parser import text_string_to_metric_families

from kernel.motion.test_fleets import FAST, YARD, Yard, yard
from kernel.motion.test_latches import ADMIN, GUEST, estop
from kernel.world import World, world_of
from rcp_kernel.spi import RobotLink
from steps import finished

pytestmark = pytest.mark.anyio
WHY = "no heartbeat for 3 s"


@pytest.fixture
async def world() -> AsyncGenerator[World]:
    async with world_of(YARD, Yard) as made:
        yield made


async def test_requests_to_a_robot_that_is_down_are_refused_and_the_others_served(
    world: World,
) -> None:
    client, host = world.client(ADMIN), world.robot.host
    for name in ("r1", "r2"):
        world.robot.measure(f"sensor/{name}/level", 1.0)
    host.report(WHY, down=True, robot="r1")
    for request in (
        {"type": "read", "path": "/sensor/r1/level"},
        {"type": "write", "path": "/actuator/r1/drive", "body": FAST},
        {"type": "execute", "path": "/action/r1/go", "body": 1},
    ):
        reply = await client.ask(**request)
        assert reply["error"]["code"] == "adapter_unavailable", reply
        assert reply["error"]["retryable"]
        assert WHY in reply["error"]["message"]
    read = await client.ask(type="read", path="/sensor/r2/level")
    assert (read["body"], read["state"]) == (1.0, "fresh")
    host.report(None, robot="r1")
    assert (await client.ask(type="read", path="/sensor/r1/level"))["body"] == 1.0


async def test_the_commands_of_that_robot_end_and_no_others(world: World) -> None:
    client = world.client(ADMIN)
    ids = [client.send(type="execute", path=f"/action/{r}/go", body=1) for r in ("r1", "r2")]
    for _ in ids:
        await world.robot.started.get()
    world.robot.host.report(WHY, down=True, robot="r1")
    lost = await client.final(ids[0])
    assert (lost["status"], lost["error"]["code"]) == ("failed", "adapter_unavailable")
    world.robot.release.set()
    assert (await client.final(ids[1]))["status"] == "completed"


async def test_the_status_the_robots_and_the_metrics_say_which(world: World) -> None:
    client, host = world.client(ADMIN), world.robot.host
    host.report("weak signal", robot="r1")
    host.report(WHY, down=True, robot="r2")
    report = (await client.ask(type="status"))["body"]
    assert report["state"] == "degraded"
    backend = report["backends"][0]
    assert backend["state"] == "ready"
    states = {n: (one["state"], one["detail"]) for n, one in backend["robots"].items()}
    assert states == {"r1": ("degraded", "weak signal"), "r2": ("down", WHY)}
    listed = (await client.ask(type="read", path="/system/robots"))["body"]
    shown = {one["path"]: one["state"] for one in listed}
    assert shown["/tenant/alpha/r1"] == "degraded", shown
    assert shown["/tenant/alpha/r2"] == "down"
    assert await _up(world) == {"r1": 1.0, "r2": 0.0}
    host.report(None, robot="r1")
    host.report(None, robot="r2")
    report = (await client.ask(type="status"))["body"]
    assert (report["state"], report["backends"][0]["robots"]) == ("ok", {})


class Fleet(Yard):
    """A yard whose robots have gateways of their own; it fails to tell of the link with one."""

    has_gateways = True

    def robot_link(self, robot: str) -> RobotLink:
        """Tell of the link with another."""
        if robot == "r1":
            raise SystemExit
        return RobotLink(latency=0.02, sent=5, received=7, lost=1)


async def test_a_backend_that_cannot_tell_of_one_link_hides_no_others() -> None:
    async with world_of(YARD, Fleet) as world:
        assert await _up(world) == {"r1": 1.0, "r2": 1.0}
        link = "rcp_robot_link"
        for name, value in (("_latency_seconds", 0.02), ("_sent_bytes", 5), ("s_lost", 1)):
            assert await _samples(world, f"{link}{name}") == {"r2": value}
        report = (await world.client(ADMIN).ask(type="status"))["body"]
        assert report["backends"][0]["last_error"].startswith("robot_link: PluginExit(")


async def test_a_guest_sees_the_link_of_no_hidden_robot() -> None:
    async with world_of(YARD, Fleet) as world:
        assert await _samples(world, "rcp_robot_link_sent_bytes", GUEST) == {}


async def _up(world: World) -> dict[str, float]:
    return await _samples(world, "rcp_robot_up")


async def _samples(world: World, name: str, token: str = ADMIN) -> dict[str, float]:
    session = world.client(token).connection.session
    text = finished(world.server.client_api.metrics(session)).decode()
    families = {family.name: family for family in text_string_to_metric_families(text)}
    return {s.labels["robot"]: s.value for s in families[name].samples}


async def test_a_robot_that_is_hidden_is_hidden_in_the_status_too() -> None:
    seen = '{ operations = ["execute"], paths = ["/system/estop"] }'
    more = '{ operations = ["read"], paths = ["/system/status"] }'
    async with world_of(YARD.replace(seen, f"{seen}, {more}"), Yard) as world:
        for robot in ("r1", "r2"):
            world.robot.host.report(WHY, down=True, robot=robot)
        report = (await world.client(GUEST).ask(type="status"))["body"]
        assert set(report["backends"][0]["robots"]) == {"r1"}


async def test_a_latched_robot_that_returns_is_stopped_first(world: World) -> None:
    host = world.robot.host
    await estop(world.client(ADMIN), scope="/tenant/alpha/r1")
    host.report(WHY, down=True, robot="r1")
    yard(world).halted.clear()
    yard(world).alone.clear()
    host.link_restored("r1")
    assert world.server.supervisors[0].unit("r1").state == "degraded"
    await yard(world).alone.wait()
    assert set(yard(world).halted) == {"r1"}
    assert world.server.supervisors[0].unit("r2").state == "ready"
