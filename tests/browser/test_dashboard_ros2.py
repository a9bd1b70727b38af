"""The dashboard in front of a real ROS 2 robot: each thing is drawn where its frames say."""

from __future__ import annotations

import asyncio
import importlib.util
import os
import re
from collections.abc import AsyncGenerator, Generator

import pytest
from playwright.async_api import Browser, Locator, expect
from rosbags.typesys import Stores, get_typestore

from browser.scenery import hues, layer, stands
from browser.watched import Watched, log_in, watched
from configuration import backend, key, listener, table
from serving import serving

if importlib.util.find_spec("rclpy") is None:
    pytest.skip("no ROS 2 here", allow_module_level=True)

from backends.ros2.robot import Eyes, fresh_domain
from browser.meshes import HUES, PACKAGE, PLACES, visuals, write

pytestmark = pytest.mark.anyio
_BOUND = 60.0  # s
_KEY = "operator-of-the-eyes"
MARKERS = "visualization_msgs/msg/MarkerArray"


@pytest.fixture(scope="module")
def domain() -> int:
    return fresh_domain()


@pytest.fixture(scope="module")
def eyes(domain: int) -> Generator[Eyes]:
    """Run the robot for all tests of this file."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    found = Eyes(domain, visuals())
    found.start()
    yield found
    found.stop()


@pytest.fixture(scope="module")
def url(eyes: Eyes, domain: int, tmp_path_factory: pytest.TempPathFactory) -> Generator[str]:
    """Run a gateway in front of it."""
    folder = tmp_path_factory.mktemp("eyes")
    write(folder)
    assets = {"paths": {PACKAGE: folder}}
    types = {MARKERS: get_typestore(Stores.ROS2_JAZZY).generate_msgdef(MARKERS, ros_version=2)[0]}
    text = (
        listener()
        + table("plugins.dashboard")
        + backend("eyes", use="ros2", domain_id=domain, expose=["/**"], assets=assets, types=types)
        + key("eyes-operator", _KEY, role="operator")
    )
    with serving(folder / "rcp.toml", text) as found:
        yield found


@pytest.fixture
async def tab(browser: Browser, url: str) -> AsyncGenerator[Watched]:
    async with watched(browser, url) as found:
        await found.open()
        await found.connected()
        await log_in(found.page, _KEY)
        yield found


async def scene(tab: Watched, query: str = "") -> None:
    await tab.open(f"scene?robot=eyes{query}")
    await expect(layer(tab, "scan", "/sensor/scan")).to_be_attached(timeout=_BOUND * 1000)


async def test_each_thing_is_drawn_where_its_frames_say(tab: Watched) -> None:
    await scene(tab)
    await expect(tab.page.get_by_test_id("layers")).to_have_attribute("data-fixed", "map")
    await stands(layer(tab, "scan", "sensor/scan"), 3, 3.2, 0.3)
    await stands(layer(tab, "cloud", "sensor/points"), 2, 4.1, 0.5)
    await stands(layer(tab, "cloud", "lidar/points"), 5, 1, 1)
    await stands(layer(tab, "map", "/map"), -5, -5, 0)
    await stands(layer(tab, "path", "/plan"), 1, 0, 0)
    await stands(layer(tab, "pose", "/goal_pose"), 2, 2, 0)
    await stands(layer(tab, "robot", "/robot_description"), 3, 1, 0)
    await stands(layer(tab, "frames", "laser"), 3, 1.2, 0.3)
    await expect(layer(tab, "scan", "sensor/scan")).to_have_attribute("data-count", "9")
    await expect(layer(tab, "cloud", "sensor/points")).to_have_attribute("data-count", "441")
    await expect(layer(tab, "map", "/map")).to_have_attribute("data-count", "14400")
    await expect(tab.page.locator("[data-testid=layer][data-layer=robot]")).to_have_count(1)
    await expect(tab.page.get_by_test_id("where")).to_have_text("3.00, 1.00 m, 90° in map")
    await expect(layer(tab, "cloud", "lost/points")).to_contain_text(
        "no transform from nowhere to map"
    )
    await tab.shoot("ros2-scene-2d")
    middle = (3.0, 1.0)
    assert (await hues(tab, 3, 3.2, middle))["red"] > 3
    assert (await hues(tab, 2, 4.1, middle))["green"] > 20
    await tab.page.get_by_role("button", name="3D").click()
    await expect(tab.page.get_by_test_id("scene")).to_have_attribute("data-drawn", "3d")
    await tab.shoot("ros2-scene-3d")


async def test_markers_of_a_type_that_is_not_installed_are_drawn_in_their_frames(
    tab: Watched, eyes: Eyes
) -> None:
    await scene(tab)
    things = layer(tab, "markers", "/things")
    await expect(things).to_have_attribute("data-count", "3")
    await expect(things.locator(".bad")).to_have_text(
        "⚠ no transform from nowhere to map (1 marker)"
    )
    for lift in (0.5, 1.5):
        eyes.tell("raise_mast", lift=lift)
        await stands(things, 0, 2.9, (lift + 1) / 2)  # halfway between the two
    assert (await hues(tab, -3, 5, (3.0, 1.0)))["blue"] > 20
    await tab.shoot("ros2-markers")


async def test_another_frame_may_stand_still(tab: Watched) -> None:
    await scene(tab)
    await tab.page.get_by_label("Fixed frame").select_option("base_link")
    await stands(layer(tab, "scan", "sensor/scan"), 2.2, 0, 0.3)
    await stands(layer(tab, "cloud", "sensor/points"), 3.1, 1, 0.5)
    await stands(layer(tab, "robot", "/robot_description"), 0, 0, 0)
    await stands(layer(tab, "frames", "map"), -1, 3, 0)
    await tab.page.reload()
    await stands(layer(tab, "path", "/plan"), -1, 2, 0)


async def test_a_robot_with_a_tree_of_its_own_stands_in_that(tab: Watched) -> None:
    """The names of its frames are those of the other robot's."""
    await scene(tab)
    await stands(layer(tab, "scan", "twin/scan"), -3, 4, 0)
    await stands(layer(tab, "frames", "twin: base_link"), -3, 3, 0)
    await stands(layer(tab, "scan", "sensor/scan"), 3, 3.2, 0.3)


async def test_clouds_have_the_colours_that_are_asked_for(tab: Watched) -> None:
    await scene(tab)
    await expect(layer(tab, "cloud", "sensor/points")).to_have_attribute("data-by", "rgb")
    await expect(layer(tab, "cloud", "lidar/points")).to_have_attribute("data-by", "intensity")
    await tab.page.get_by_label("Colour of clouds").select_option("height")
    await expect(layer(tab, "cloud", "sensor/points")).to_have_attribute("data-by", "height")
    await stands(layer(tab, "cloud", "sensor/points"), 2, 4.1, 0.5)
    assert (await hues(tab, 2, 4.1, (3.0, 1.0)))["green"] < 20  # flat, and so as blue as can be


async def test_links_are_moved_by_joint_states_and_else_by_transforms(
    tab: Watched, eyes: Eyes
) -> None:
    await scene(tab)
    finger, other = layer(tab, "link", "finger"), layer(tab, "link", "other_finger")
    await tab.page.get_by_text("links", exact=False).first.click()
    await stands(finger, 2.9, 1.5, 0.4)  # beyond its limit, as it is told to be
    await stands(other, 3.1, 1.5, 0.4)
    eyes.tell("bend", joint="finger_joint", value=0.02)
    await stands(finger, 2.98, 1.5, 0.4)
    await stands(other, 3.02, 1.5, 0.4)
    eyes.tell("raise_mast", lift=0.3)
    await stands(layer(tab, "link", "mast"), 3, 0.8, 0.3)
    eyes.tell("raise_mast", lift=1.3)
    await stands(layer(tab, "link", "mast"), 3, 0.8, 1.3)
    await stands(layer(tab, "link", "charger"), -2, -2, 0)  # a base of its own


async def test_pictures_of_every_kind_are_shown(tab: Watched) -> None:
    tab.expected.append("willReadFrequently")
    await tab.open("camera?robot=eyes")
    cameras = tab.page.get_by_test_id("camera")
    await expect(cameras).to_have_count(4)
    for path in ("camera/image/jpeg", "depth/image", "far/image", "camera/compressed"):
        camera = tab.page.locator(f"[data-testid=camera][data-path$='/{path}']")
        await expect(camera).to_have_attribute("data-frames", re.compile(r"\d"))
        await expect(camera).to_have_attribute("data-stale", "false")
        if path in ("depth/image", "far/image"):
            await expect(camera).to_contain_text("white 0.50 m … black 4.00 m")
            assert await shades(camera) == [0, 255, 40]
    await tab.page.locator("[data-path$='camera/image/jpeg'] input").check()
    raw = tab.page.locator("[data-testid=camera][data-path$='camera/image']")
    await expect(raw).to_have_attribute("data-frames", re.compile(r"\d"))
    await expect(raw.get_by_role("alert")).to_have_count(0)
    await tab.shoot("ros2-camera")


async def shades(camera: Locator) -> list[int]:
    """Read the red of three pixels of a row."""
    return await camera.locator("canvas").first.evaluate(
        "(canvas) => [4, 20, 50].map((x) => canvas.getContext('2d').getImageData(x, 9, 1, 1).data[0])"
    )


async def test_a_fix_stands_on_the_map(tab: Watched) -> None:
    await tab.open("map")
    await expect(tab.page.get_by_test_id("map")).to_have_attribute("data-tracks", "1")
    await expect(tab.page.locator("main")).to_contain_text("47.500000°, 8.500000°")


async def test_meshes_are_got_from_the_robot_and_one_that_is_not_there_is_told(
    tab: Watched,
) -> None:
    requests: list[str | bytes] = []
    noted = requests.append
    tab.page.on("websocket", lambda one: one.on("framesent", lambda sent: noted(sent)))  # noqa: PLW0108
    await tab.page.reload()
    await scene(tab)
    await tab.page.get_by_label("Fixed frame").select_option("base_link")
    robot = layer(tab, "robot", "/robot_description")
    await expect(robot).to_contain_text(f"package://{PACKAGE}/meshes/none.stl")
    await expect(robot).to_contain_text("has no file 'meshes/none.stl'")
    await stands(robot, 0, 0, 0)
    for mesh, place in PLACES.items():
        seen: dict[str, int] = {}
        async with asyncio.timeout(_BOUND):
            while seen.get(HUES[mesh], 0) < 40:
                seen = await hues(tab, *place, (0.0, 0.0))
    await tab.page.get_by_role("button", name="3D").click()
    await expect(tab.page.get_by_test_id("scene")).to_have_attribute("data-drawn", "3d")
    await tab.shoot("ros2-meshes")
    assert await robot.locator(".bad").count() == 1
    assert "\n" not in await robot.locator(".bad").inner_text()
    assert len([one for one in requests if "red.stl" in str(one)]) == 1  # though it is drawn twice
