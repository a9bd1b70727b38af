"""The guard on ROS 2: a real subscriber, action server and service are told to stop."""

from __future__ import annotations

import importlib.util
import os
import tempfile
import threading
import time
from typing import Any

import psutil
import pytest

from plugins.guard.bench import WITHIN, Bench, bench, until
from rcp_guard.senders import ros2
from timing import in_one_of_three_attempts, in_time_under, measured_load

pytestmark = [pytest.mark.anyio, pytest.mark.paired]
if importlib.util.find_spec("rclpy") is None:
    pytest.skip("rclpy is not installed", allow_module_level=True)
HEADER = "00010000"  # CDR, little-endian
WAITS = 60.0  # s


@pytest.fixture(autouse=True)
def on_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_LOG_DIR", tempfile.gettempdir())
    if "HOME" not in os.environ:
        monkeypatch.setenv("HOME", tempfile.gettempdir())


def plan(domain: int) -> dict[str, Any]:
    zero = {"topic": "/cmd_vel", "type": "geometry_msgs/msg/Twist", "reliable": True}
    halt = {"name": "/halt", "type": "std_srvs/srv/SetBool"}
    data = {
        "domain_id": domain,
        "publishers": [
            {"topic": "/strange", "type": "no_such/msg/Type", "data": HEADER},
            zero | {"data": HEADER + 48 * "00"},
        ],
        "cancel": ["/go"],
        "services": [halt | {"data": HEADER + "01"}],
    }
    return {"sender": "ros2", "data": data, "period": 0.05}


@pytest.mark.parametrize("peers", ["", "10.0.0.7"])
async def test_peers_on_other_machines_are_still_discovered(
    monkeypatch: pytest.MonkeyPatch, peers: str
) -> None:
    changed = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTDDS_BUILTIN_TRANSPORTS")
    for name in (*changed, "FASTRTPS_DEFAULT_PROFILES_FILE"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    monkeypatch.setenv("ROS_STATIC_PEERS", peers)
    ros2._leave_shared_memory_out()  # noqa: SLF001  # pyright: ignore[reportPrivateUsage]
    alone = os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SYSTEM_DEFAULT"
    assert ("FASTDDS_DEFAULT_PROFILES_FILE" in os.environ) == alone == (not peers)
    assert os.environ["FASTDDS_BUILTIN_TRANSPORTS"] == "UDPv4"


@pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")  # of ROS's own parser
def test_a_plan_that_replaces_another_goes_on_with_its_node(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from backends.ros2.robot import fresh_domain

    monkeypatch.setattr(ros2, "_leave_shared_memory_out", lambda: None)  # it sets the environment
    monkeypatch.setattr(ros2, "_FOLLOWS", WAITS)
    data = plan(fresh_domain())["data"]
    first = ros2.open_sender(data)
    shared = first._shared  # noqa: SLF001  # pyright: ignore[reportPrivateUsage]
    closing = threading.Thread(target=first.close)
    closing.start()
    end = time.monotonic() + WAITS
    while shared.users:
        assert time.monotonic() < end
        time.sleep(0.001)  # the other thread tells nobody
    second = ros2.open_sender(data | {"cancel": ["/go", "/come"]})
    closing.join(WAITS)
    assert not closing.is_alive()
    assert second._shared is shared  # noqa: SLF001  # pyright: ignore[reportPrivateUsage]
    second.send()
    monkeypatch.setattr(ros2, "_FOLLOWS", 0.0)
    second.close()
    assert not ros2._nodes  # noqa: SLF001  # pyright: ignore[reportPrivateUsage]


async def nearly_ready(scene: Bench) -> bool:
    facts = await scene.gateway.ask("guard", do="guard")
    plans = facts["guard"]["plans"]
    detail = plans[0]["detail"] or "" if plans else ""
    if "no_such/msg/Type" not in detail or "no s" in detail.replace("no_such", ""):
        return False
    assert "guard_sender" in facts["warnings"]
    return True


async def shared_memory(scene: Bench) -> list[str]:
    """List the guard's files that a killed gateway could leave locked."""
    pid = (await scene.gateway.ask("guard", do="guard"))["pid"]
    files = {one.path for one in psutil.Process(pid).memory_maps()}
    assert any("librmw" in path for path in files)  # the middleware is there
    return [path for path in files if "/dev/shm/fastdds" in path]


@pytest.mark.parametrize("how", ["SIGSTOP", "SIGKILL", "gil"])
@in_one_of_three_attempts
async def test_topics_goals_and_services_are_told(how: str) -> None:
    from backends.ros2.robot import fresh_domain

    domain = fresh_domain()
    async with bench(lambda _port: plan(domain), device=("ros2", str(domain))) as scene:
        device = scene.device
        await device.until(lambda fact: fact.get("told") == "running")
        # Ready but for the type that is not there, which does not keep the rest from being sent.
        await until(lambda: nearly_ready(scene))
        assert not await shared_memory(scene)
        await scene.drive()
        with measured_load() as load:
            at = await scene.freeze(how)
            seconds = await scene.stopped("topic") - at
            halted = await device.until(lambda fact: fact.get("by") == "service")
            cancelled = await device.until(lambda fact: fact.get("told") == "cancelled")
        assert halted["told"] is True
        print(  # noqa: T201 - the measured times
            f"ros2, {how}: topic after {seconds:.3f} s, service after {halted['at'] - at:.3f} s, "
            f"goal cancelled after {cancelled['at'] - at:.3f} s"
        )
        for one in (seconds, halted["at"] - at, cancelled["at"] - at):
            in_time_under(load, one, WITHIN)
