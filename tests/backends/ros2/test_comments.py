"""Comments of message texts, frames and units in what the gateway tells of a path."""

from __future__ import annotations

from typing import Any

import pytest
from nav_msgs.msg import Odometry
from sensor_msgs.msg import BatteryState
from std_srvs.srv import SetBool

from backends.ros2.robot import Fleet, robot_of
from rcp_kernel.values import value_type
from rcp_ros2.comments import comments_of, first_sentence, parsed
from rcp_ros2.types import inward, outward


def test_an_installed_type_tells_what_its_authors_wrote() -> None:
    whole, fields = comments_of(Odometry)
    assert first_sentence(whole) == (
        "This represents an estimate of a position and velocity in free space"
    )
    assert fields["pose"] == "Estimated pose that is typically relative to a fixed world frame."
    battery = comments_of(BatteryState).fields
    assert battery["voltage"] == "Voltage in Volts (Mandatory)"
    assert battery["cell_voltage"].endswith("set each to NaN")
    assert "1 charging, 2 discharging" in battery["power_supply_status"]


def test_parts_of_a_service_have_their_own() -> None:
    assert comments_of(SetBool.Request).fields["data"].startswith("e.g. for hardware enabling")
    assert "success" in comments_of(SetBool.Response).fields


def test_schemas_carry_them_both_ways() -> None:
    for made in (outward(BatteryState), inward(BatteryState)):
        shown = str(value_type(made).schema)
        assert "Voltage in Volts (Mandatory)" in shown
    odometry = value_type(outward(Odometry)).schema
    assert "estimate of a position" in str(odometry)


def test_a_text_is_read_whatever_its_habits() -> None:
    whole, fields = parsed(
        """# Said of all of it,
# in two lines.

# Above a field.
float64 a
float64 b  # behind it
           # and further on

# of nothing in particular

uint8 MODE_OFF=0
uint8 MODE_ON = 1 # not of a field
uint8 mode
Other[<=3] plain
"""
    )
    assert whole == "Said of all of it, in two lines."
    assert fields == {
        "a": "Above a field.",
        "b": "behind it and further on",
        "mode": "(0 off, 1 on)",
    }
    assert parsed("# Of the whole.\nfloat64 x") == ("Of the whole.", {})
    assert parsed("") == ("", {})


@pytest.mark.anyio
async def test_a_path_tells_comment_unit_and_frame(fleet_domain: int, fleet: Fleet) -> None:
    odom: dict[str, Any] = {"topic": "odom", "type": "nav_msgs/msg/Odometry"}
    mapping = {
        "/sensor/pose": {**odom, "field": "pose.pose", "frame": "odom"},
        "/sensor/odom": odom,
    }
    async with robot_of(fleet_domain, namespace="/fleet/r1", map=mapping) as robot:
        await robot.until(lambda: len(robot.resources) == 2)
        pose, whole = robot.resources["sensor/pose"], robot.resources["sensor/odom"]
    assert whole.description == (
        "nav_msgs/msg/Odometry on topic /fleet/r1/odom: this represents an estimate of a position "
        "and velocity in free space."
    )
    assert pose.description == "pose.pose of nav_msgs/msg/Odometry on topic /fleet/r1/odom."
    schema = value_type(pose.value).schema
    assert schema["frame_id"] == "odom"
    assert "'unit': 'm'" in str(schema)
