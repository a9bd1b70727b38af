"""What the inventory learns of a robot from its description and diagnostics."""

from __future__ import annotations

from typing import Any

import pytest

from backends.ros2.robot import RobotNodes, robot_of
from rcp_kernel.spi import RobotFacts
from rcp_ros2.description import JointLimits, parse

pytestmark = pytest.mark.anyio
URDF = """<robot name="reacher">
<joint name="a" type="revolute"><limit lower="-1" upper="2" velocity="0.5"/></joint>
<joint name="b" type="continuous"><limit lower="0" upper="0" velocity="1"/></joint>
<joint name="c" type="prismatic"/><joint name="d" type="fixed"/>
<joint name="e" type="revolute"><limit lower="nan" upper="two"/></joint>
</robot>"""


def test_a_description_has_a_name_and_the_limits_that_it_tells() -> None:
    found = parse(URDF)
    assert found.name == "reacher"
    assert found.joints == {
        "a": JointLimits(-1.0, 2.0, 0.5),
        "b": JointLimits(speed=1.0, continuous=True),
        "c": JointLimits(),
        "e": JointLimits(),
    }


@pytest.mark.parametrize(
    "text", ["", "<robot", "<sdf/>", '<!DOCTYPE robot [<!ENTITY a "b">]><robot/>']
)
def test_what_is_no_description_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        parse(text)


async def test_a_robot_is_described_when_it_is_known(
    nodes_domain: int, robot_nodes: RobotNodes
) -> None:
    expose = ["/diagnostics", "/robot_description"]
    async with robot_of(nodes_domain, expose=expose) as robot:
        robot_nodes.tell("describe", text=URDF)
        robot_nodes.tell("diagnose", name="motor", level=0)

        async def facts() -> Any:
            return robot.facts.get(None, RobotFacts())

        whole = RobotFacts(model="reacher", serial="hw-1")
        await robot.until_async(facts, lambda found: found == whole)
    robot_nodes.tell("hush", name="motor")
