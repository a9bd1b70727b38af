"""Services and actions whose packages are not installed, with servers that have them."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from backends.ros2 import interfaces
from backends.ros2.robot import (
    BOUND,
    Fleet,
    Jointed,
    Peer,
    Robot,
    Wheels,
    fresh_domain,
    ignore,
    robot_of,
)
from rcp_kernel.errors import AdapterUnavailable, ConfigError, DeviceRejected
from rcp_ros2.cdr import Codec, Malformed
from rcp_ros2.definitions import define_text
from rcp_ros2.idl import load
from rcp_ros2.services import reader
from rcp_ros2.texts import Texts
from rcp_ros2.well_known import VERSIONS

pytestmark = pytest.mark.anyio
HIDDEN = (*interfaces.PACKAGES, "std_srvs", "test_msgs")
SHARE = Path(sys.prefix, "share")
MAP = {
    "/service/set_bool": {"service": "/set_bool"},
    "/service/add": {"service": "/add"},
    "/action/fibonacci": {"action": "/fibonacci"},
}
SET_BOOL = "bool data\n---\nbool success\nstring message\n"


@pytest.fixture(autouse=True)
def _not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hide packages that other tests of this process import."""
    for package in HIDDEN:
        for name in (package, f"{package}.msg", f"{package}.srv", f"{package}.action"):
            monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setattr("rcp_ros2.idl._defined", {})


@asynccontextmanager
async def robot_with(domain: int, *names: str, **config: Any) -> AsyncIterator[Robot]:
    async with robot_of(domain, **config) as robot:
        await robot.until(lambda: robot.resources.keys() >= set(names))
        yield robot


@pytest.fixture(scope="module")
def wheels() -> Iterator[tuple[int, Wheels]]:
    domain = fresh_domain()
    rover = Wheels(domain, str(interfaces.built_apart()))
    rover.start()
    yield domain, rover
    rover.stop()


@pytest.fixture(scope="module")
def jointed() -> Iterator[tuple[int, Jointed]]:
    domain = fresh_domain()
    arm = Jointed(domain, str(interfaces.built_apart()))
    arm.start()
    yield domain, arm
    arm.stop()


needs_tools = pytest.mark.skipif(not interfaces.have_tools(), reason="nav2_msgs cannot be built")


@needs_tools
async def test_a_rover_goes_where_it_is_sent(wheels: tuple[int, Wheels]) -> None:
    domain, rover = wheels
    told: list[Any] = []
    async with robot_with(domain, "action/move_to") as robot:
        goal = robot.input("action/move_to", {"position": {"x": 0.4, "y": 0.0}, "frame": "odom"})
        result = await robot.backend.execute(
            "action/move_to", goal, lambda feedback=None, **_: told.append(feedback)
        )
        refused = {"position": {"x": 500.0, "y": 0.0}, "frame": "odom"}
        with pytest.raises(DeviceRejected, match="rejected the goal"):
            await robot.execute("action/move_to", refused)
    assert rover.tell("truth")["x"] == pytest.approx(0.4, abs=0.1)
    assert result.error_code == 0
    assert any(one is not None and one.distance_remaining > 0 for one in told)


@needs_tools
async def test_a_rover_that_is_stopped_cancels_its_goal(wheels: tuple[int, Wheels]) -> None:
    domain, rover = wheels
    async with robot_with(domain, "action/move_to") as robot:
        goal = robot.input("action/move_to", {"position": {"x": 30.0, "y": 0.0}, "frame": "odom"})
        moving = asyncio.Event()
        going = asyncio.create_task(
            robot.backend.execute("action/move_to", goal, lambda *_, **__: moving.set())
        )
        async with asyncio.timeout(BOUND):
            await moving.wait()
        going.cancel()
        with pytest.raises(asyncio.CancelledError):
            await going
        assert rover.tell("truth")["running"] == 0


@needs_tools
async def test_an_arm_moves_its_joints(jointed: tuple[int, Jointed]) -> None:
    domain, arm = jointed
    async with robot_with(domain, "action/move_joints") as robot:
        result = await robot.execute(
            "action/move_joints", {"positions": {"elbow": 0.3}, "speed": 1.0}
        )
    assert result.positions["elbow"] == pytest.approx(0.3, abs=0.05)
    assert arm.tell("truth")["joints"]["elbow"] == pytest.approx(0.3, abs=0.05)


async def test_interfaces_come_from_a_folder(domain: int, peer: Peer) -> None:
    async with robot_with(domain, "service/add", map=MAP, interfaces=[str(SHARE)]) as robot:
        for on in (True, False):
            assert (await robot.execute("service/set_bool", {"data": on})).success
        added = await robot.execute(
            "service/add", {"int64_value": -5, "string_value": "aé", "uint64_value": 2**64 - 1}
        )
        assert (added.int64_value, added.string_value) == (-4, "éa")
        assert added.uint64_value == 2**64 - 1
        told: list[Any] = []
        goal = robot.input("action/fibonacci", {"order": 4})
        result = await robot.backend.execute(
            "action/fibonacci", goal, lambda feedback=None, **_: told.append(feedback)
        )
        assert list(result.sequence) == [0, 1, 1, 2, 3]
        assert list(told[-1].sequence) == [0, 1, 1, 2, 3]
        with pytest.raises(DeviceRejected, match="aborted"):
            await robot.execute("action/fibonacci", {"order": 0})
        assert robot.resources["service/set_bool"].input is not None


async def test_a_text_in_the_configuration_is_enough(domain: int, peer: Peer) -> None:
    texts = {"std_srvs/srv/SetBool": SET_BOOL}
    only = {"/service/set_bool": MAP["/service/set_bool"]}
    async with robot_with(domain, "service/set_bool", map=only, types=texts) as robot:
        for on in (True, False):
            assert (await robot.execute("service/set_bool", {"data": on})).message == "switched"
        with pytest.raises(DeviceRejected, match="it is so already"):
            await robot.execute("service/set_bool", {"data": False})


async def test_a_text_of_another_version_is_not_used(domain: int, peer: Peer) -> None:
    texts = {"std_srvs/srv/SetBool": SET_BOOL.replace("bool data", "int32 data")}
    only = {"/service/set_bool": MAP["/service/set_bool"]}
    async with robot_with(domain, "service/set_bool", map=only, types=texts) as robot:
        with pytest.raises(AdapterUnavailable, match="another version") as refused:
            await robot.backend.execute("service/set_bool", None, ignore)
    assert "`interfaces`" in str(refused.value.remedy)


async def test_a_folder_that_is_not_there_is_told(domain: int) -> None:
    with pytest.raises(ConfigError, match="no folder /nowhere"):
        async with robot_of(domain, interfaces=["/nowhere"]):
            pass


@needs_tools
async def test_feedback_of_another_version_is_described_by_the_server(
    jointed: tuple[int, Jointed],
) -> None:
    domain, _ = jointed
    name = "control_msgs/action/FollowJointTrajectory"
    [text] = VERSIONS[name]
    goal, result, _ = text.split("---\n")
    texts = {name: f"{goal}---\n{result}---\nint32 index\n"}
    told: list[Any] = []
    async with robot_with(domain, "action/move_joints", types=texts) as robot:
        value = robot.input("action/move_joints", {"positions": {"elbow": 0.1}, "speed": 1.0})
        await robot.backend.execute(
            "action/move_joints", value, lambda feedback=None, **_: told.append(feedback)
        )
    assert any(one is not None and "elbow" in one.positions for one in told)


@pytest.fixture
def introspected() -> Iterator[int]:
    domain = fresh_domain()
    fleet = Fleet(domain, "/fleet/r1")
    fleet.start()
    fleet.tell("introspect", space="/fleet/r1")
    yield domain
    fleet.stop()


async def test_a_service_whose_calls_are_published_needs_no_text(introspected: int) -> None:
    async with robot_of(
        introspected, map={"/service/dock": {"service": "/fleet/r1/dock"}}
    ) as robot:
        await robot.until(lambda: robot.resources["service/dock"].output is not Any, 20.0)
        answer = await robot.execute("service/dock", {"data": True})
    assert (answer.success, answer.message) == (True, "docked: True")


def test_a_server_without_hashes_is_taken_for_the_oldest() -> None:
    texts = Texts({}, ())
    name = "nav2_msgs/action/NavigateToPose"
    assert "std_msgs/Empty result" in next(texts.of(name, hashed=False))
    assert "error_msg" in next(texts.of(name))
    given = Texts({"std_srvs/srv/SetBool": SET_BOOL}, ())
    assert next(given.of("std_srvs/srv/SetBool", hashed=False)) == SET_BOOL


def test_a_message_that_is_cut_off_is_no_answer() -> None:
    define_text("std_srvs/srv/SetBool", SET_BOOL)
    response = load("std_srvs/srv/SetBool", "srv").Response
    with pytest.raises(Malformed):
        reader(Codec(response))(response())
