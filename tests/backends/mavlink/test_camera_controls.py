"""Zoom, focus and video as the camera reports them, and a place that stays in view."""

from __future__ import annotations

import math
from collections.abc import AsyncIterator
from typing import Any

import pytest

from backends.mavlink.flying import airborne
from backends.mavlink.puppet import Puppet, station
from backends.mavlink.test_equipment import error, estop
from backends.mavlink.test_gateway import LAT, LON, Pilot, flying
from rcp_gateway.testing import eventually


@pytest.fixture
async def pilot() -> AsyncIterator[Pilot]:
    async with flying() as found:
        airborne(found.vehicle)
        await found.ready()
        yield found


async def test_a_camera_zooms_focuses_and_records(pilot: Pilot) -> None:
    camera = pilot.vehicle.camera
    assert (await pilot.do("service/camera/zoom", {"level": 0.25}))["status"] == "completed"
    assert camera.zoom == pytest.approx(25.0)
    assert (await pilot.do("service/camera/focus", {"level": 1.0}))["status"] == "completed"
    assert camera.focus == pytest.approx(100.0)
    assert (await pilot.do("service/camera/focus", {}))["status"] == "completed"
    for on in (True, False):
        done = await pilot.do("service/camera/video", {"on": on, "camera": 1})
        assert done["status"] == "completed", done
        assert (camera.recording_since is not None) == on


async def test_a_place_stays_in_view_until_the_stop(pilot: Pilot) -> None:
    vehicle = pilot.vehicle
    place = {"latitude": LAT + 20 / 111_319.49, "longitude": LON}
    assert (await pilot.do("service/camera/look_at", place))["status"] == "completed"
    await eventually(
        lambda: _is(abs(math.radians(vehicle.mount.pitch) + math.pi / 4) < 0.1), "it looks down"
    )
    vehicle.flight.aim((20.0, 20.0), -20.0)
    await eventually(lambda: _is(abs(vehicle.body.e - 20) < 1), "it has moved")
    await eventually(
        lambda: _is(abs(_bearing(vehicle) + math.pi / 2) < 0.15),
        "it still looks there, to the west",
    )
    assert (await pilot.do("service/camera/look_ahead"))["status"] == "completed"
    assert vehicle.mount.region is None
    await estop(pilot)
    assert error(await pilot.do("service/camera/look_at", place)) == "estop_active"


def _bearing(vehicle: Any) -> float:
    return math.remainder(vehicle.body.yaw + math.radians(vehicle.mount.yaw), math.tau)


async def test_a_camera_that_does_not_do_it_or_is_not_there_is_told() -> None:
    async with station(Puppet()) as found:
        none = await found.do("service/camera/zoom", {"level": 0.5})
        assert error(none) == "precondition_failed", none
        puppet = found.puppet
        puppet.results[531] = lambda _: 0
        silent = await found.do("service/camera/zoom", {"level": 0.5, "camera": 1})
        assert error(silent) == "not_implemented", silent
        puppet.results[512] = _another_zoom(puppet)
        other = await found.do("service/camera/zoom", {"level": 0.5, "camera": 1})
        assert error(other) == "device_timeout"
        assert "does not show it" in other["message"]


def _another_zoom(puppet: Puppet) -> Any:
    def report(command: Any) -> int:
        if command.param1 == 260:
            puppet.send("CAMERA_SETTINGS", 0, 0, 10.0, 0.0)
        return 0

    return report


async def _is(truth: bool) -> bool:  # noqa: FBT001 - for `eventually`, which awaits
    return truth
