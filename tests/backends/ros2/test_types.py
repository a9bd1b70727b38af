"""Types that are not installed: made of text, or learnt from those who have them."""

from __future__ import annotations

import asyncio
import importlib
import sys
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from backends.ros2.robot import Fleet, Robot, robot_of
from rcp_kernel.errors import AdapterUnavailable
from rcp_ros2 import Ros2Config, idl
from rcp_ros2.definitions import BadText, define_text, parse
from rcp_ros2.idl import MissingType, Primitive, Ref, Sequence, Text, fields_of, load
from rcp_ros2.made import is_made
from rcp_ros2.support import type_hash

pytestmark = pytest.mark.anyio

ODOMETRY = """
# a comment
std_msgs/Header header
string child_frame_id   # of the child
geometry_msgs/PoseWithCovariance pose
geometry_msgs/TwistWithCovariance twist
int8 SOME=3
"""


@pytest.fixture
def bare(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let nav_msgs and std_srvs not be installed, and nothing be known of them."""
    real = importlib.import_module

    def found(name: str, *rest: Any) -> Any:
        if name.startswith(("nav_msgs", "std_srvs", "odd_msgs")):
            raise ImportError(f"No module named '{name}'")
        return real(name, *rest)

    monkeypatch.setattr(idl, "importlib", SimpleNamespace(import_module=found))
    monkeypatch.setattr(idl, "_defined", dict(idl._defined))  # noqa: SLF001 - types are defined once in a process


async def moved(robot: Robot) -> Any:
    await robot.until(lambda: "sensor/odom" in robot.resources)
    await robot.until(lambda: robot.resources["sensor/odom"].native)
    async with robot.backend.watch("sensor/odom", None):
        return await robot.first("sensor/odom")


async def test_a_type_is_made_of_its_text(domain: int, peer: object, bare: None) -> None:
    types = {"nav_msgs/msg/Odometry": ODOMETRY}
    mapping = {"topic": "/odom", "type": "nav_msgs/msg/Odometry"}
    async with robot_of(domain, map={"/sensor/odom": mapping}, types=types) as robot:
        odom = await moved(robot)
    assert is_made(load("nav_msgs/msg/Odometry"))
    assert (odom.header.frame_id, odom.child_frame_id) == ("odom", "base_link")
    assert odom.twist.covariance[0] == 0.5
    assert robot.samples[0][2] is not None


async def test_a_type_that_nobody_has_installed_is_learnt_from_its_publisher(
    domain: int, peer: object, bare: None
) -> None:
    async with robot_of(domain, expose=["/odom"]) as robot:
        odom = await moved(robot)
    assert is_made(load("nav_msgs/msg/Odometry"))
    assert (odom.header.frame_id, odom.child_frame_id) == ("odom", "base_link")
    assert odom.pose.pose.orientation.w == 1.0


async def test_a_service_type_that_is_not_installed_stays_an_error_with_a_way_out(
    domain: int, peer: object, bare: None
) -> None:
    async with robot_of(domain, map={"/service/reset": {"service": "/reset"}}) as robot:
        await robot.until(lambda: "service/reset" in robot.resources)
        with pytest.raises(AdapterUnavailable, match="std_srvs/srv/Trigger is not installed"):
            await robot.execute("service/reset")


async def test_a_made_type_is_spoken(fleet_domain: int, fleet: Fleet, bare: None) -> None:
    types = {"nav_msgs/msg/Odometry": ODOMETRY}
    mapping = {"topic": "/fleet/r1/set_odom", "type": "nav_msgs/msg/Odometry"}
    async with robot_of(fleet_domain, map={"/actuator/odom": mapping}, types=types) as robot:
        await robot.until(lambda: robot.resources.get("actuator/odom") is not None)
        assert is_made(load("nav_msgs/msg/Odometry"))
        told = {
            "child_frame_id": "base",
            "pose": {"pose": {"position": {"x": 2.5}}, "covariance": [0.5, 0.25, *[0.0] * 34]},
        }
        await robot.backend.write("actuator/odom", robot.input("actuator/odom", told))
        await robot.until_async(
            lambda: asyncio.to_thread(fleet.tell, "placed", space="/fleet/r1"),
            lambda placed: placed == ["base", 2.5, [0.5, 0.25]],
        )
        with pytest.raises(msgspec.ValidationError):
            robot.input("actuator/odom", {"pose": {"covariance": [0.0]}})


def test_a_text_is_the_type_that_the_generator_makes_of_it(bare: None) -> None:
    define_text("nav_msgs/msg/Odometry", ODOMETRY)
    made = load("nav_msgs/msg/Odometry")
    known = "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"
    assert type_hash("nav_msgs/msg/Odometry", fields_of(made)).hex() == known


def test_every_form_of_a_field_is_read(bare: None) -> None:
    text = """
        byte a
        char b 7
        string<=5 c "x"
        wstring d
        float64[3] e
        int32[<=4] f [1, 2]
        string<=2[] g
        Other[2] h
        uint8 K=1
        ================================================================================
        MSG: odd_msgs/Other
        bool yes
    """
    define_text("odd_msgs/msg/Odd", "\n".join(line.strip() for line in text.splitlines()))
    fields = {f.name: f.type for f in fields_of(load("odd_msgs/msg/Odd"))}
    assert fields == {
        "a": Primitive("octet"),
        "b": Primitive("uint8"),
        "c": Text(5, wide=False),
        "d": Text(None, wide=True),
        "e": Sequence(Primitive("float64"), 3, None),
        "f": Sequence(Primitive("int32"), None, 4),
        "g": Sequence(Text(2, wide=False), None, None),
        "h": Sequence(Ref(load("odd_msgs/msg/Other")), 2, None),
    }


def test_a_text_that_is_none_is_refused_with_its_line() -> None:
    with pytest.raises(BadText, match=r"'float64 1x' in the text of a_msgs/msg/A"):
        parse("a_msgs/msg/A", "float64 1x")
    with pytest.raises(ValueError, match="is not valid in"):
        Ros2Config(types={"a_msgs/msg/A": "nonsense"})


@pytest.mark.parametrize(
    "name",
    ["this/srv/Offer", "idlelib/idle/Main", "os.path/msg/Name", "../x/msg/Y", "antigravity/X"],
)
def test_the_name_of_a_type_imports_nothing_else(name: str) -> None:
    before = set(sys.modules)
    with pytest.raises(MissingType):
        load(name, "srv")
    assert not {"this", "idlelib", "antigravity"} & (set(sys.modules) - before)
