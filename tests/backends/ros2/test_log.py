"""`/rosout` as an event."""

from __future__ import annotations

import time

import pytest

from backends.ros2.robot import BOUND, RobotNodes, robot_of
from rcp_kernel.errors import AdapterUnavailable
from rcp_kernel.values import Encoding, value_type

pytestmark = pytest.mark.anyio

LOG = "event/log"


async def test_what_nodes_log_is_told_with_its_place_and_time(
    nodes_domain: int, robot_nodes: RobotNodes
) -> None:
    async with robot_of(nodes_domain, expose=["/rosout"]) as robot:
        await robot.until(lambda: LOG in robot.resources)
        robot_nodes.tell("log", level="error", text="wheel lost")
        await robot.until(lambda: any(r.text == "wheel lost" for r in robot.of(LOG)))
        ((record, stamp),) = [
            (value.decode(), stamp)
            for _, value, stamp in robot.samples
            if value.decode().text == "wheel lost"
        ]
        assert (record.level, record.node) == ("error", "monitor")
        assert record.file.endswith("robot_nodes.py")
        assert (record.function, record.line > 0) == ("log", True)
        assert stamp is not None
        assert abs(time.time_ns() - stamp) < BOUND * 1e9
        assert value_type(robot.resources[LOG].value).encode(record, Encoding.JSON)


async def test_records_below_the_wanted_level_are_left_out(
    nodes_domain: int, robot_nodes: RobotNodes
) -> None:
    async with robot_of(nodes_domain, expose=["/rosout"], log={"level": "warn"}) as robot:
        await robot.until(lambda: LOG in robot.resources)
        robot_nodes.tell("log", level="info", text="humming")
        robot_nodes.tell("log", level="warn", text="creaking")
        await robot.until(lambda: any(r.text == "creaking" for r in robot.of(LOG)))
        assert {r.level for r in robot.of(LOG)} <= {"warn", "error", "fatal"}


async def test_a_log_without_a_record_says_so(nodes_domain: int, robot_nodes: RobotNodes) -> None:
    async with robot_of(nodes_domain, expose=["/rosout"], log={"level": "fatal"}) as robot:
        await robot.until(lambda: LOG in robot.resources)
        with pytest.raises(AdapterUnavailable, match="no node has logged at this level"):
            await robot.read(LOG)


async def test_the_log_is_not_offered_unless_it_is_named(
    nodes_domain: int, robot_nodes: RobotNodes
) -> None:
    async with robot_of(nodes_domain, expose=["/diagnostics"]) as robot:
        await robot.until(lambda: "event/diagnostics" in robot.resources)
        assert LOG not in robot.resources
