"""The e-stop and the hold, as the Python clients and `rcpctl` tell of them."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import AsyncGenerator, Callable
from typing import Any

import pytest

import rcp_client
from plugins.client.gateway import ADMIN, BOUND, OPERATOR, Gateway, Robot
from plugins.client.proxy import Proxy
from plugins.client.rcpctl import BIN
from rcp_client.requests import hold_path
from rcp_kernel.errors import DeviceTimeout, UnknownPath
from rcp_kernel.spi import MotionState
from rcp_kernel.types import Twist

pytestmark = pytest.mark.anyio
Connect = Callable[..., rcp_client.Client]
Run = Callable[..., Any]
MORE = """
[safety.groups]
cell = ["/tenant/alpha"]
"""


@pytest.fixture
async def gateway() -> AsyncGenerator[Gateway]:
    async with Gateway(more=MORE, http=True) as made:
        yield made


@pytest.fixture
def rest(gateway: Gateway, monkeypatch: pytest.MonkeyPatch) -> dict[Robot, MotionState]:
    """What each robot measures of its motion; at rest where nothing is said."""
    states: dict[Robot, MotionState] = {}

    def motion(self: Robot, robot: str | None) -> MotionState:
        return states.get(self, MotionState(at_rest=True))

    monkeypatch.setattr(Robot, "motion", motion)
    return states


async def rcpctl(gateway: Gateway, *arguments: str, token: str = OPERATOR) -> tuple[int, str, str]:
    """Run `rcpctl` and return its status, output and errors."""
    program = await asyncio.create_subprocess_exec(
        *(BIN / "rcpctl", *arguments),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env={**os.environ, "RCP_URL": gateway.url, "RCP_TOKEN": token, "RCP_TENANT": "alpha"},
    )
    async with asyncio.timeout(BOUND):
        out, error = await program.communicate()
    assert program.returncode is not None
    return program.returncode, out.decode(), error.decode()


async def test_a_stop_returns_when_every_robot_is_confirmed_at_rest(
    gateway: Gateway, connect: Connect, rest: dict[Robot, MotionState]
) -> None:
    async with asyncio.timeout(BOUND), connect(gateway) as client:
        state = await client.estop(scope="cell")
        assert {name: robot["state"] for name, robot in state["robots"].items()} == {
            "robot": "confirmed"
        }
        assert state["robots"]["robot"]["confirmed"] is not None


async def test_a_stop_that_is_not_confirmed_raises_and_says_who_and_why(
    gateway: Gateway, connect: Connect, rest: dict[Robot, MotionState]
) -> None:
    rest[gateway.robot] = MotionState(at_rest=None, detail="link lost for 3 s")
    async with asyncio.timeout(BOUND), connect(gateway) as client:
        with pytest.raises(DeviceTimeout, match="link lost for 3 s") as caught:
            await client.estop(deadline=0.3)
        assert caught.value.details is not None
        told = caught.value.details["robots"]
        assert (list(told), told["robot"]["state"]) == (["robot"], "commanded")
        assert (await client.read("/system/estop"))["robots"].keys() == {"robot", "other"}


async def test_a_hold_brings_a_robot_to_rest_and_latches_nothing(
    gateway: Gateway, connect: Connect, rest: dict[Robot, MotionState]
) -> None:
    async with asyncio.timeout(BOUND), connect(gateway, tenant="alpha") as client:
        handle = await client.start("/action/go", {"x": 4.0})
        await gateway.robot.started.get()
        assert (await client.hold())["at_rest"] is True
        assert gateway.robot.stopped.qsize()
        with pytest.raises(Exception, match="hold"):
            await handle.result()
        assert (await client.hold("/tenant/alpha"))["at_rest"] is True
        await client.write("/actuator/drive", Twist())
        rest[gateway.robot] = MotionState(at_rest=False, detail="moves at 0.8 m/s")
        with pytest.raises(DeviceTimeout, match=r"0\.8 m/s"):
            await client.hold()
        with pytest.raises(UnknownPath):
            await client.hold("nobody")


async def test_the_blocking_client_holds_and_stops(
    gateway: Gateway, rest: dict[Robot, MotionState]
) -> None:
    def script() -> None:
        with rcp_client.Robot(gateway.url, token=OPERATOR, tenant="alpha") as robot:
            assert robot.hold()["at_rest"]
            assert robot.estop(scope="/tenant/alpha", deadline=5)["active"]

    await asyncio.to_thread(script)


@pytest.mark.parametrize(
    ("robot", "path"),
    [
        (None, "/service/hold"),
        ("rover", "/service/rover/hold"),
        ("arm/left", "/service/arm/left/hold"),
        ("/tenant/alpha", "/tenant/alpha/service/hold"),
        ("/tenant/alpha/rover", "/tenant/alpha/service/rover/hold"),
    ],
)
async def test_a_robot_is_named_as_scopes_are(robot: str | None, path: str) -> None:
    assert hold_path(robot) == path


async def test_rcpctl_shows_how_far_the_stop_of_each_robot_has_come(
    gateway: Gateway, rest: dict[Robot, MotionState]
) -> None:
    code, out, error = await rcpctl(gateway, "estop", "--text", "--reason", "a test")
    assert (code, error) == (0, "")
    head, names, *rows = out.splitlines()
    assert head == "E-stop latched: other, robot."
    assert names.split() == ["ROBOT", "STATE", "REQUESTED", "COMMANDED", "CONFIRMED", "DETAIL"]
    assert [row.split()[:2] for row in rows] == [["other", "confirmed"], ["robot", "confirmed"]]
    code, out, _ = await rcpctl(gateway, "estop", "--reset", "--text", token=ADMIN)
    assert (code, out) == (0, "E-stop reset. Nothing moves until a new command.\n")


async def test_rcpctl_names_who_is_not_confirmed_and_fails(
    gateway: Gateway, rest: dict[Robot, MotionState]
) -> None:
    rest[gateway.robot] = MotionState(at_rest=None, detail="link lost for 3 s")
    code, out, error = await rcpctl(gateway, "estop", "--text", "--timeout", "1")
    assert code == 1
    assert "robot (link lost for 3 s)" in error
    (row,) = [row.split() for row in out.splitlines() if row.startswith("robot")]
    assert (row[1], row[4], row[5:]) == ("commanded", "-", ["link", "lost", "for", "3", "s"])
    code, out, error = await rcpctl(gateway, "estop", "--timeout", "1", "--json")
    assert (code, json.loads(out)["robots"]["other"]["state"]) == (1, "confirmed")
    assert json.loads(error)["error"]["code"] == "device_timeout"
    # The stop of the other one is confirmed: the answer is its own.
    code, out, error = await rcpctl(gateway, "estop", "other", "--text", token=ADMIN)
    assert (code, error) == (0, "rcpctl: not confirmed at rest: robot.\n")
    code, _, error = await rcpctl(gateway, "estop", "other", "--scope", "robot")
    assert (code, "twice" in error) == (2, True)


async def test_rcpctl_says_so_where_no_gateway_can_be_reached(
    full: Gateway, unused_port: int
) -> None:
    code, _, error = await rcpctl(full, "estop", "--url", f"http://127.0.0.1:{unused_port}")
    assert (code, "cannot reach" in error) == (4, True)


async def test_rcpctl_stops_robots_also_where_no_session_is_left(
    full: Gateway, monkeypatch: pytest.MonkeyPatch
) -> None:
    gateway = full
    async with rcp_client.connect(gateway.url, token=ADMIN) as client:
        assert (await rcpctl(gateway, "status", token=ADMIN))[0] == 3
        code, out, error = await rcpctl(gateway, "estop", "--json", token=ADMIN)
        assert (code, json.loads(out)["robots"].keys()) == (0, {"robot", "other"}), error
        moving = MotionState(at_rest=False, detail="moves at 0.8 m/s")
        monkeypatch.setattr(Robot, "motion", lambda *_: moving)
        code, out, error = await rcpctl(gateway, "estop", "--timeout", "1", token=ADMIN)
        assert (code, json.loads(out)["robots"].keys()) == (1, {"robot", "other"})
        assert "moves at 0.8 m/s" in error
        code, _, _ = await rcpctl(gateway, "estop", "--reset", token=ADMIN)
        assert code == 3  # a reset is never tried a second way
        assert (await client.read("/system/estop"))["active"]


async def test_rcpctl_does_not_report_what_may_have_been_executed_as_unreachable(
    gateway: Gateway,
) -> None:
    async with asyncio.timeout(BOUND), Proxy(gateway.port) as proxy:
        go = ("execute", "/action/go", '{"x": 1.0}', "--url", proxy.url)
        running = asyncio.create_task(rcpctl(gateway, *go))
        await gateway.robot.started.get()
        proxy.mute = "down"
        await gateway.stop()
        proxy.cut()
        await gateway.start()
        code, _, error = await running
    assert (code, "`rcpctl commands`" in error) == (1, True), error


@pytest.fixture
async def full() -> AsyncGenerator[Gateway]:
    """A gateway that has room for one session."""
    more = "[quotas.principal]\nsessions = 1\n"
    async with Gateway(more=more, http=True) as made:
        yield made


async def test_rcpctl_holds_one_robot_or_all_of_the_tenant(
    gateway: Gateway, rest: dict[Robot, MotionState]
) -> None:
    for named in ((), ("robot",), ("/tenant/alpha",)):
        code, out, error = await rcpctl(gateway, "hold", *named, "--json")
        assert (code, error) == (0, "")
        assert json.loads(out) == {
            "robot": "robot",
            "path": "/tenant/alpha/service/hold",
            "at_rest": True,
            "detail": "",
        }
    rest[gateway.robot] = MotionState(at_rest=False, detail="moves at 0.8 m/s")
    code, out, _ = await rcpctl(gateway, "hold", "--text")
    assert code == 1
    assert out.splitlines()[1].split()[:4] == ["robot", "not", "at", "rest"]
    code, _, error = await rcpctl(gateway, "hold", "nobody")
    assert code == 3
    assert "The robots are: robot." in error
