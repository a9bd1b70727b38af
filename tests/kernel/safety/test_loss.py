"""A command that ends with the link: its error says what becomes of the robot, and that is done."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncGenerator, Callable
from pathlib import Path

import pytest

from kernel.safety.scripted import ADMIN, DRIVE, FAST, GO, Scripted, estop, scripted, scripted_world
from kernel.world import BOUND, Client, World, settled
from rcp_kernel.errors import AdapterUnavailable
from rcp_kernel.spi import Host, Progress
from rcp_kernel.tree.entry import RobotUnit

pytestmark = pytest.mark.anyio


@pytest.fixture
async def world() -> AsyncGenerator[World]:
    async with scripted_world() as made:
        yield made


async def lose(world: World, admin: Client) -> None:
    """Begin an action and lose the link under it."""
    robot = scripted(world)
    go = admin.send(type="execute", path=GO, body=1)
    async with asyncio.timeout(BOUND):
        await robot.started.get()
    robot.lost = "the link is cut"
    robot.host.report("the link is cut", down=True)
    final = await admin.final(go)
    assert (final["status"], final["error"]["code"]) == ("failed", "adapter_unavailable")
    assert final["error"]["details"]["on_loss"] == "land"
    message = "commands it to land when the link is restored (on_loss = land)"
    assert message in final["error"]["message"]
    robot.sent.clear()


def back(robot: Scripted) -> None:
    """Have the link return."""
    robot.lost = ""
    robot.host.link_restored()
    robot.host.report(None)


async def test_the_policy_is_carried_out_once_when_contact_returns(world: World) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    audit = admin.send(type="subscribe", path="/system/audit", body={"initial": False})
    await lose(world, admin)
    back(robot)
    async with asyncio.timeout(BOUND):
        await robot.recovered.wait()
    record = (await admin.update(audit))["body"]
    while record["what"] != "recovery":
        record = (await admin.update(audit))["body"]
    assert (record["robot"], record["message"], record["path"]) == ("r1", "landed", GO)
    back(robot)
    read = await admin.ask(type="write", path=DRIVE, body=FAST, valid_for=BOUND)
    assert read["status"] == "completed"
    assert robot.sent == ["recover", "write 1"]


async def test_a_robot_that_lost_nothing_is_left_alone(world: World) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    robot.host.report("the link is cut", down=True)
    back(robot)
    await admin.ask(type="write", path=DRIVE, body=FAST, valid_for=BOUND)
    assert robot.sent == ["write 1"]


async def test_a_latched_robot_is_stopped_and_not_recovered(world: World) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    await lose(world, admin)
    await estop(admin, deadline=0.1)
    back(robot)
    assert robot.sent == ["hold_stop"]
    assert (await estop(admin))["status"] == "completed"
    assert "recover" not in robot.sent


async def test_a_reset_does_not_bring_back_what_an_estop_ended(world: World) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    await lose(world, admin)
    await estop(admin, deadline=0.1)
    back(robot)
    assert (await estop(admin))["status"] == "completed"
    assert (await estop(admin, reset=True))["status"] == "completed"
    robot.host.report("the link is cut", down=True)  # once more, with nothing to lose
    back(robot)
    await admin.ask(type="write", path=DRIVE, body=FAST, valid_for=BOUND)
    assert "recover" not in robot.sent
    assert robot.sent[-1] == "write 1"


async def test_what_no_halt_has_reached_is_settled_after_a_reset_too(world: World) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    await lose(world, admin)
    await estop(admin, deadline=0.1)
    assert (await estop(admin, reset=True))["status"] == "completed"
    back(robot)
    async with asyncio.timeout(BOUND):
        await robot.recovered.wait()


class Slow(Scripted):
    """Takes its time to end what is cancelled, and does not know what has become of it then."""

    async def execute(self, name: str, value: object, progress: Progress) -> object:
        self.started.put_nowait(value)
        with contextlib.suppress(asyncio.CancelledError):
            await self.release.wait()
        await self.release.wait()
        raise AdapterUnavailable("the hold was not answered")


async def test_a_command_that_fails_after_the_reset_was_not_lost() -> None:
    async with scripted_world(make=Slow) as world:
        robot, admin = scripted(world), world.client(ADMIN)
        go = admin.send(type="execute", path=GO, body=1)
        async with asyncio.timeout(BOUND):
            await robot.started.get()
        assert (await estop(admin))["status"] == "completed"
        assert (await estop(admin, reset=True))["status"] == "completed"
        robot.release.set()
        final = await admin.final(go)
        assert final["error"]["code"] == "adapter_unavailable"
        assert "on_loss" not in final["error"].get("details", {})
        assert world.server.gateway.registry.entries[GO].unit.loss.command is None


async def test_an_estop_ends_a_recovery_that_is_being_tried(world: World) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    await lose(world, admin)
    robot.host.link_restored()  # heard, and lost again at once: the recovery fails
    robot.host.report(None)
    await estop(admin, deadline=0.1)
    robot.lost = ""
    assert (await estop(admin))["status"] == "completed"
    assert (await estop(admin, reset=True))["status"] == "completed"
    assert world.server.gateway.registry.entries[GO].unit.loss.command is None


async def test_a_new_command_takes_the_place_of_the_recovery(world: World) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    await lose(world, admin)
    robot.lost = ""
    robot.host.report(None)
    go = admin.send(type="execute", path="/tenant/alpha/action/r1/cut_in", body=1)
    async with asyncio.timeout(BOUND):
        await robot.started.get()
    robot.host.link_restored()
    robot.release.set()
    assert (await admin.final(go))["status"] == "completed"
    assert robot.sent == ["execute action/cut_in"]


async def test_a_recovery_that_fails_is_tried_again(world: World) -> None:
    robot, admin = scripted(world), world.client(ADMIN)
    await lose(world, admin)
    robot.host.link_restored()  # heard, and lost again at once
    robot.host.report(None)
    robot.lost = ""
    async with asyncio.timeout(BOUND):
        await robot.recovered.wait()


async def test_a_command_that_a_killed_gateway_left_behind_is_settled_by_the_next(
    tmp_path: Path,
) -> None:
    store = tmp_path / "rcp.db"
    async with scripted_world(store=store) as world:
        robot, admin = scripted(world), world.client(ADMIN)
        admin.send(type="execute", path=GO, body=1)
        async with asyncio.timeout(BOUND):
            await robot.started.get()
        await settled(world.server.gateway.store)
        kept = [store.with_name(f"rcp.db{end}").read_bytes() for end in ("", "-wal", ".head")]
    killed = tmp_path / "killed" / "rcp.db"
    killed.parent.mkdir()
    killed.write_bytes(kept[0])
    killed.with_name("rcp.db-wal").write_bytes(kept[1])
    killed.with_name("rcp.db.head").write_bytes(kept[2])
    async with scripted_world(store=killed) as world:
        robot = scripted(world)
        async with asyncio.timeout(BOUND):
            await robot.recovered.wait()
        assert robot.sent == ["recover"]


class Unheard(Scripted):
    """Fails its cancel, as a robot does whose link is gone and not yet known to be."""

    async def execute(self, name: str, value: object, progress: Progress) -> object:
        self.started.put_nowait(value)
        try:
            await self.release.wait()
        except asyncio.CancelledError:
            raise AdapterUnavailable("the hold was not answered") from None


async def test_a_cancel_that_does_not_reach_the_robot_is_not_called_cancelled() -> None:
    async with scripted_world(make=Unheard) as world:
        robot, admin = scripted(world), world.client(ADMIN)
        go = admin.send(type="execute", path=GO, body=1)
        async with asyncio.timeout(BOUND):
            await robot.started.get()
        await admin.ask(type="cancel", path=GO)
        final = await admin.final(go)
        assert (final["status"], final["error"]["code"]) == ("failed", "adapter_unavailable")
        assert final["error"]["details"]["on_loss"] == "land"


class Late(Scripted):
    """Answers a halt when it is told to."""

    async def halt(self) -> None:
        self.halting.set()
        await self.answers.wait()

    def __init__(self, host: Host) -> None:
        super().__init__(host)
        self.halting, self.answers = asyncio.Event(), asyncio.Event()


async def test_a_reset_of_a_robot_in_reach_begins_no_recovery() -> None:
    async with scripted_world(make=Late) as world:
        robot, admin = scripted(world), world.client(ADMIN)
        assert isinstance(robot, Late)
        await lose(world, admin)
        robot.lost = ""
        robot.host.report(None)
        await estop(admin, deadline=0.1)
        assert (await estop(admin, reset=True))["status"] == "completed"
        robot.host.report("the link is cut", down=True)  # once more, with nothing to lose
        back(robot)
        await admin.ask(type="write", path=DRIVE, body=FAST, valid_for=BOUND)
        assert "recover" not in robot.sent
        assert robot.sent[-1] == "write 1"


class Twice(Scripted):
    """Loses another command while it recovers from the first."""

    def __init__(self, host: Host) -> None:
        super().__init__(host)
        self.recoveries, self.first, self.second = 0, asyncio.Event(), asyncio.Event()

    async def recover(self, robot: str | None) -> str:
        self.recoveries += 1
        self.first.set()
        await self.release.wait()
        if self.recoveries > 1:
            self.second.set()
        return "landed"


async def test_a_command_lost_during_a_recovery_is_settled_by_another() -> None:
    async with scripted_world(make=Twice) as world:
        robot, admin = scripted(world), world.client(ADMIN)
        assert isinstance(robot, Twice)
        await lose(world, admin)
        back(robot)
        async with asyncio.timeout(BOUND):
            await robot.first.wait()
            assert world.server.gateway.registry.entries[GO].unit.loss.note(GO, 0)
            robot.release.set()
            await robot.second.wait()


class Last(Twice):
    """Loses another command when the recovery from the first has just ended."""

    async def recover(self, robot: str | None) -> str:
        self.recoveries += 1
        if self.recoveries == 1:
            asyncio.get_running_loop().call_soon(self.lose)
        else:
            self.second.set()
        return "landed"

    def lose(self) -> None:
        self.first.set()
        self.unit().loss.note(GO, 0)
        self.host.link_restored()

    unit: Callable[[], RobotUnit]


async def test_a_command_lost_at_the_end_of_a_recovery_is_settled_by_another() -> None:
    async with scripted_world(make=Last) as world:
        robot, admin = scripted(world), world.client(ADMIN)
        assert isinstance(robot, Last)
        robot.unit = lambda: world.server.gateway.registry.entries[GO].unit
        await lose(world, admin)
        back(robot)
        async with asyncio.timeout(BOUND):
            await robot.second.wait()


async def test_a_halt_that_is_answered_after_the_reset_ends_what_was_lost() -> None:
    async with scripted_world(make=Late) as world:
        robot, admin = scripted(world), world.client(ADMIN)
        assert isinstance(robot, Late)
        unit = world.server.gateway.registry.entries[GO].unit
        assert unit.loss.note(GO, 0)
        stopped = admin.send(type="execute", path="/system/estop", body={})
        async with asyncio.timeout(BOUND):
            await robot.halting.wait()
        robot.host.report("nothing is heard of it", down=True)
        assert (await estop(admin, reset=True))["status"] == "completed"
        assert unit.loss.command is not None
        robot.answers.set()
        await admin.final(stopped)
        assert unit.loss.command is None
