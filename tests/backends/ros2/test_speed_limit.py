"""The speed limit of a navigator: by its topic, read back as it is in force."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from backends.ros2 import interfaces
from backends.ros2.robot import Navigator, Robot, fresh_domain, robot_of
from rcp_kernel.errors import AdapterUnavailable

pytestmark = [
    pytest.mark.anyio,
    pytest.mark.skipif(not interfaces.have_tools(), reason="nav2_msgs cannot be built"),
]
LIMIT = "param/speed_limit"


async def _reads(robot: Robot) -> Any:
    try:
        return await robot.read(LIMIT)
    except AdapterUnavailable:
        return None


async def test_a_limit_is_what_the_navigator_was_told_last_by_whomever() -> None:
    domain = fresh_domain()
    navigator = Navigator(domain, str(interfaces.built()), shared_memory=False)  # it is killed
    navigator.start()
    try:
        async with robot_of(domain, grace=0.5, poll=0.2) as robot:
            await robot.until(lambda: LIMIT in robot.resources)
            with pytest.raises(AdapterUnavailable):  # it was told none, and has none to read
                await robot.read(LIMIT)
            await robot.backend.write(LIMIT, 0.4)
            assert navigator.tell("truth") == [[False, 0.4]]
            assert await robot.read(LIMIT) == 0.4

            navigator.tell("configure", speed=0.8)

            async def in_force() -> Any:
                navigator.tell("enter_zone", share=25.0)
                return await _reads(robot)

            await robot.until_async(in_force, lambda found: found == pytest.approx(0.2))
            async with robot.backend.watch(LIMIT, None):
                await robot.until(lambda: pytest.approx(0.2) in robot.of(LIMIT))
                navigator.tell("enter_zone", share=50.0)
                await robot.until(lambda: pytest.approx(0.4) in robot.of(LIMIT))
            assert await robot.backend.write(LIMIT, 0.9) == 0.8  # no more than the controller's own
            assert navigator.tell("truth")[-1] == [False, 0.0]  # which is no limit
            assert await robot.read(LIMIT) == 0.8

            await robot.backend.write(LIMIT, 0.3)
            navigator.stop()
            navigator.start()
            await robot.until_async(lambda: _reads(robot), lambda found: found != 0.3)
    finally:
        navigator.stop()


async def test_a_limit_of_zero_is_refused_because_it_would_be_none() -> None:
    domain = fresh_domain()
    navigator = Navigator(domain, str(interfaces.built()))
    navigator.start()
    try:
        async with robot_of(domain) as robot:
            await robot.until(lambda: LIMIT in robot.resources)
            with pytest.raises(msgspec.ValidationError):
                robot.input(LIMIT, 0.0)
    finally:
        navigator.stop()
