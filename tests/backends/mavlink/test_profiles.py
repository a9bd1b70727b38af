"""What the profiles of vehicles mean, as the simulated vehicle itself has it."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncGenerator, Mapping
from contextlib import asynccontextmanager
from typing import Any, ClassVar

import pytest

import rcp_mavlink
from backends.mavlink.flying import agrees, airborne, on_the_ground, skip, speed, twin
from backends.mavlink.relay import commander
from backends.mavlink.test_gateway import Pilot, flying
from hurry import Hurried
from rcp_gateway.testing import Body, ProfileSuite, Robot, eventually
from rcp_mavlink import enu
from rcp_mavlink.fences import is_enabled
from rcp_mavlink.measurement import SETTLED
from rcp_mavlink_sim import Twin, Vehicle
from rcp_mavlink_sim.modes import Mode

LOITER = 5
_STILL = 0.35  # m/s below which the backend counts a vehicle that holds its place as at rest


class VehicleProfiles(Hurried, ProfileSuite):
    """Looks at the body behind the messages: its own north, east and down."""

    kind = next(iter(rcp_mavlink.rcp_backends()))
    complete_within = 60.0
    speed = 1.5
    vehicle_kind: ClassVar[str]
    device: Twin

    @asynccontextmanager
    async def twin(self) -> AsyncGenerator[Twin]:
        # It looks to the north-west, so that no axis of the map is one of the body.
        async with twin(vehicle=self.vehicle_kind, heading=-45.0, noise=0.0) as running:
            yield running

    def table(self) -> Mapping[str, Any]:
        link = f"udpout:127.0.0.1:{self.device.ports[0][1]}"
        return {"links": [link], "silence": 5.0, "feedback_timeout": 5.0, "timeout": 1.0}

    @asynccontextmanager
    async def served_by_device(self) -> AsyncGenerator[Any]:
        async with super().served_by_device() as robot:
            # Home is where it is armed; without this, it would move when a test arms it.
            self.vehicle.set_home(None)
            seen = self.backend.robots[""]

            async def known() -> bool:
                return seen.vehicle.home is not None and seen.vehicle.fix is not None

            await eventually(known, "its place and its home are known")
            await seen.parameters.complete.wait()
            yield robot

    @property
    def vehicle(self) -> Vehicle:
        return self.device.vehicle

    async def body(self) -> Body:
        body, (north, east) = self.vehicle.body, self.vehicle.home_place()
        s, c = math.sin(body.yaw), math.cos(body.yaw)
        return Body(
            x=body.e - east,
            y=body.n - north,
            z=-body.d,
            yaw=math.remainder(math.pi / 2 - body.yaw, math.tau),
            forward=body.vn * c + body.ve * s,
            left=body.vn * s - body.ve * c,
            up=-body.vd,
            yaw_rate=-body.r,
            still=_STILL,
        )

    async def at_rest(self) -> bool:
        return not self.vehicle.armed or speed(self.vehicle) < _STILL

    async def charge(self) -> float:
        return self.vehicle.battery.charge

    async def armed(self) -> bool:
        return self.vehicle.armed

    async def powered(self) -> bool:
        return self.vehicle.armed

    async def geographic(self) -> tuple[float, float]:
        return self.vehicle.geographic()

    async def land(self) -> None:
        on_the_ground(self.vehicle)
        await agrees(self.backend, self.vehicle)


class TestCopterProfiles(VehicleProfiles):
    """It hovers."""

    vehicle_kind = "copter"
    profiles = ("mobile", "aerial", "battery", "power")
    near = 0.6
    hop = 6.0

    async def make_ready(self) -> None:
        airborne(self.vehicle)
        await agrees(self.backend, self.vehicle)

    @pytest.mark.parametrize("_time", range(3))  # it depends on when the next position comes
    async def test_a_hold_at_the_start_of_a_motion_waits_for_its_end(
        self, robot: Robot, _time: int
    ) -> None:
        await self.make_ready()
        measurement = self.backend.robots[""].measurement

        async def settled() -> bool:
            return measurement.still_for > SETTLED

        await eventually(settled, "telemetry has shown it still for long")
        await self.drive(self.speed)
        while speed(self.vehicle) < 0.1:  # noqa: ASYNC110 - the vehicle tells nobody
            await asyncio.sleep(0.001)
        await self.do("execute", "service/hold")
        body = await self.body()
        assert not body.moves, f"the hold is completed, but the robot moves: {body}"


class GroundProfiles(VehicleProfiles):
    """It keeps to the ground, and faces its direction of travel."""

    profiles = ("mobile", "battery", "power")
    near = 1.1
    hop = 6.0

    async def make_ready(self) -> None:
        vehicle = self.vehicle
        vehicle.flight.set_mode(Mode.GUIDED)
        assert vehicle.arm()
        vehicle.pilot.hold()
        skip(vehicle, lambda: speed(vehicle) < _STILL)
        seen = self.backend.robots[""].vehicle

        async def same() -> bool:
            return seen.armed and seen.mode == "GUIDED" and seen.fix.speed < _STILL

        await eventually(same, "the gateway sees it armed, in GUIDED, at rest")


class TestRoverProfiles(GroundProfiles):
    vehicle_kind = "rover"


class TestBoatProfiles(GroundProfiles):
    vehicle_kind = "boat"
    near = 1.6


class TestPlaneProfiles(VehicleProfiles):
    """It circles around its goals."""

    vehicle_kind = "plane"
    profiles = ("aerial", "battery")
    near = 110.0
    hop = 600.0
    height = 50.0
    level = 10.0
    limit = 15.0

    async def make_ready(self) -> None:
        vehicle = self.vehicle
        if vehicle.body.landed:
            vehicle.flight.set_mode(Mode.TAKEOFF)
            assert vehicle.arm()
            skip(vehicle, lambda: -vehicle.body.d > 45)
        vehicle.flight.set_mode(Mode.GUIDED)
        await agrees(self.backend, vehicle)

    async def land(self) -> None:
        vehicle = self.vehicle
        assert vehicle.body.landed, "a plane lands only where an approach was planned"
        await agrees(self.backend, vehicle)


# A goal of the profile, and what goes wrong on the way to it


def far(**more: Any) -> dict[str, Any]:
    return {"position": {"x": 0.0, "y": 900.0, "z": 20.0}, **more}


@asynccontextmanager
async def aloft(**options: Any) -> AsyncGenerator[Pilot]:
    async with flying(options) as pilot:
        airborne(pilot.vehicle)
        await pilot.ready()
        await pilot.served.life.backend.robots[""].parameters.complete.wait()
        yield pilot


async def begun(pilot: Pilot) -> str:
    """Send it far away; return the request's id once it moves."""
    id_ = await pilot.client.send(type="execute", path="/tenant/t/action/move_to", body=far())

    async def moves() -> bool:
        return speed(pilot.vehicle) > 2.0

    await eventually(moves, "it moves")
    return id_


async def test_a_goal_that_loses_its_link_on_the_way_has_failed() -> None:
    async with aloft() as pilot:
        id_ = await begun(pilot)
        pilot.twin.muted = True
        final = await pilot.client.final(id_, 30.0)
        assert (final["status"], final["error"]["code"]) == ("failed", "adapter_unavailable")
        assert not final["error"]["retryable"]


async def test_a_goal_whose_link_is_lost_with_the_acknowledgement_has_failed() -> None:
    async with aloft() as pilot:
        place = pilot.vehicle.flight.aim

        def aim(*given: Any) -> None:
            place(*given)
            pilot.twin.muted = True  # it flies, and nothing more is heard of it

        pilot.vehicle.flight.aim = aim  # type: ignore[method-assign]
        final = await pilot.do("action/move_to", far())
        assert speed(pilot.vehicle) > 1.0
        assert (final["status"], final["error"]["retryable"]) == ("failed", False), final


async def test_a_goal_that_a_second_ground_station_ends_has_failed_with_its_mode() -> None:
    async with (
        aloft() as pilot,
        commander(pilot.twin.ports[0]) as other,
    ):
        id_ = await begun(pilot)
        other.mode(LOITER)
        final = await pilot.client.final(id_, 30.0)
        assert final["status"] == "failed", final
        assert final["error"]["code"] == "device_rejected", final
        assert "LOITER" in final["message"]
        assert pilot.vehicle.flight.mode is Mode.LOITER


@pytest.mark.parametrize(
    "goal",
    [
        {"position": {"x": 0.0, "y": 90.0}},
        {"position": {"x": 90.0, "y": 0.0}},
        {"position": {"x": 0.0, "y": 0.0, "z": 80.0}},
    ],
)
async def test_a_goal_outside_the_fence_is_refused_before_anything_moves(goal: Any) -> None:
    given = {"FENCE_ENABLE": 1, "FENCE_RADIUS": 50, "FENCE_ALT_MAX": 60, "DISARM_DELAY": 0}
    async with aloft(parameters=given) as pilot:
        vehicle = pilot.vehicle
        seen = pilot.served.life.backend.robots[""].vehicle

        async def fenced() -> bool:
            return is_enabled(seen)

        await eventually(fenced, "the fence is seen to be on")
        before = (vehicle.body.n, vehicle.body.e, vehicle.body.d)
        reply = await pilot.do("action/move_to", goal)
        assert (reply["status"], reply["error"]["code"]) == ("rejected", "device_rejected"), reply
        assert "fence" in reply["message"]
        after = (vehicle.body.n, vehicle.body.e, vehicle.body.d)
        assert math.dist(before, after) < 1.0


@pytest.mark.parametrize(
    "goal",
    [far(frame="odom"), far(north=3.0), far(latitude=47.0, longitude=8.0)],
)
async def test_a_goal_that_is_not_clear_is_refused(goal: Any) -> None:
    async with aloft() as pilot:
        reply = await pilot.do("action/move_to", goal)
        assert (reply["status"], reply["error"]["code"]) == ("rejected", "invalid_value"), reply
        assert speed(pilot.vehicle) < 0.5


async def test_a_goal_without_a_height_keeps_the_present_one() -> None:
    async with aloft() as pilot:
        reply = await pilot.do("action/move_to", {"position": {"x": 8.0, "y": -5.0}})
        assert reply["status"] == "completed", reply
        body = pilot.vehicle.body
        assert (body.e, body.n) == (pytest.approx(8.0, abs=1.0), pytest.approx(-5.0, abs=1.0))
        assert -body.d == pytest.approx(20.0, abs=1.5)


async def test_the_native_fields_are_beside_those_of_the_profiles() -> None:
    async with aloft(noise=0.0) as pilot:
        velocity = await pilot.read("sensor/velocity")
        assert {"groundspeed", "airspeed", "climb", "heading", "throttle"} <= velocity.keys()
        battery = await pilot.read("sensor/battery")
        assert battery["battery_remaining"] == battery["percentage"]
        assert battery["current"] == -battery["current_battery"] < 0
        assert battery["voltage"] == pytest.approx(pilot.vehicle.battery.voltage, abs=0.1)


async def test_a_reset_in_the_air_is_refused() -> None:
    async with aloft() as pilot:
        reply = await pilot.do("service/reset_system")
        assert (reply["status"], reply["error"]["code"]) == ("rejected", "precondition_failed")
        assert pilot.vehicle.armed
        assert not pilot.vehicle.body.landed


async def test_a_velocity_keeps_to_the_speed_limit() -> None:
    async with aloft() as pilot:
        path = "/tenant/t/param/speed_limit"
        reply = await pilot.client.request("write", path, body=2.0)
        assert reply["status"] == "completed", reply
        assert pilot.vehicle.params["WPNAV_SPEED"] == 200.0
        for name, value in (
            ("actuator/cmd_vel", {"linear": {"x": 3.0, "y": 4.0}}),
            ("actuator/velocity", {"x": 3.0, "y": 4.0}),
        ):
            reply = await pilot.client.request("write", f"/tenant/t/{name}", body=value)
            assert reply["status"] == "completed", reply

            async def limited() -> bool:
                return math.isclose(math.hypot(*pilot.vehicle.pilot.velocity), 2.0, rel_tol=0.01)

            await eventually(limited, f"{name} is limited")
        slow = await pilot.client.request("write", path, body=0.05)
        assert slow["error"]["code"] == "out_of_range"


async def slows(pilot: Pilot, to: float) -> None:
    async def slow() -> bool:
        return speed(pilot.vehicle) <= to * 1.1 + 0.1

    await eventually(slow, f"it slows down to {to:g} m/s", 30.0)


async def limits(pilot: Pilot, value: float) -> None:
    path = "/tenant/t/param/speed_limit"
    reply = await pilot.client.request("write", path, body=value)
    assert reply["status"] == "completed", reply


@pytest.mark.parametrize("name", ["param/speed_limit", "param/WPNAV_SPEED"])
async def test_a_lower_limit_slows_the_velocity_in_force_and_a_higher_one_lets_it_go(
    name: str,
) -> None:
    async with aloft() as pilot:
        factor = 100.0 if name == "param/WPNAV_SPEED" else 1.0
        client, flown = pilot.client, pilot.vehicle.pilot
        value = {"linear": {"x": 3.0, "y": 4.0}}
        path = "/tenant/t/actuator/cmd_vel"
        await client.request("write", path, body=value, valid_for=600.0)
        for limit, expected in ((8.0, 5.0), (2.0, 2.0), (3.0, 3.0)):
            await client.request("write", f"/tenant/t/{name}", body=limit * factor)

            async def limited(expected: float = expected) -> bool:
                return math.isclose(math.hypot(*flown.velocity), expected, rel_tol=0.01)

            await eventually(limited, f"{expected} m/s is sent")


@pytest.mark.parametrize("own", [None, 6.0])
async def test_a_lower_limit_slows_the_flight_under_way(own: float | None) -> None:
    async with aloft() as pilot:
        goal = far() if own is None else far(speed=own)
        await pilot.client.send(type="execute", path="/tenant/t/action/move_to", body=goal)

        async def moves() -> bool:
            return speed(pilot.vehicle) > 4.0

        await eventually(moves, "it moves")
        await limits(pilot, 1.5)
        await slows(pilot, 1.5)
        await limits(pilot, 5.0)
        await eventually(moves, "it is allowed to")
        await pilot.client.request("cancel", "/tenant/t/action/move_to")


@pytest.mark.parametrize("kind", ["rover", "boat"])
async def test_a_lower_limit_slows_the_drive_under_way(kind: str) -> None:
    async with flying({"vehicle": kind, "noise": 0.0}) as pilot:
        vehicle = pilot.vehicle
        assert vehicle.arm()
        robot = pilot.served.life.backend.robots[""]

        async def ready() -> bool:
            seen = robot.vehicle
            return seen.armed and seen.home is not None and seen.fix is not None

        await eventually(ready, "the gateway sees it armed, and where it is")
        await robot.parameters.complete.wait()
        path = "/tenant/t/action/move_to"
        goal = {"position": {"x": 0.0, "y": 900.0}}
        await pilot.client.send(type="execute", path=path, body=goal)

        async def moves() -> bool:
            return speed(vehicle) > 1.5

        await eventually(moves, "it moves")
        await limits(pilot, 0.7)
        await slows(pilot, 0.7)


@pytest.mark.parametrize(
    ("heading", "yaw"), [(0.0, math.pi / 2), (math.pi / 2, 0.0), (math.pi, -math.pi / 2)]
)
def test_headings_count_clockwise_from_north_and_yaws_the_other_way_from_east(
    heading: float, yaw: float
) -> None:
    assert enu.yaw(heading) == pytest.approx(yaw)
    assert math.cos(enu.heading(yaw) - heading) == pytest.approx(1.0)


def test_an_attitude_turns_the_body_as_it_is_turned() -> None:
    """Nose up by 0.2 rad while heading north: the nose points north and up."""
    q = enu.attitude(0.0, 0.2, 0.0)
    nose = (1 - 2 * (q.y**2 + q.z**2), 2 * (q.x * q.y + q.w * q.z), 2 * (q.x * q.z - q.w * q.y))
    assert nose == pytest.approx((0.0, math.cos(0.2), math.sin(0.2)), abs=1e-9)
    q = enu.attitude(0.3, 0.0, 0.0)
    left = (2 * (q.x * q.y - q.w * q.z), 1 - 2 * (q.x**2 + q.z**2), 2 * (q.y * q.z + q.w * q.x))
    assert left == pytest.approx((-math.cos(0.3), 0.0, math.sin(0.3)), abs=1e-9)
