"""The MAVLink backend keeps what the house asks of a backend, with the twin behind it."""

from __future__ import annotations

import asyncio
import base64
import math
from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from typing import Any

import msgspec

import rcp_mavlink
from backends.mavlink.flying import (
    agrees,
    airborne,
    armed,
    on_the_ground,
    skip,
    speed,
    twin,
)
from backends.mavlink.relay import COMMAND_ACK, HEARTBEAT, Relay, commander, relay
from hurry import Hurried
from rcp_gateway.testing import BackendSuite, Goal, StopRig, StopSuite, eventually
from rcp_kernel.errors import RcpError
from rcp_mavlink.files import FileWrite, Remove
from rcp_mavlink.follow_target import Target
from rcp_mavlink.messages import Calibrate
from rcp_mavlink_sim import Twin, Vehicle
from rcp_mavlink_sim.modes import Mode
from rcp_mavlink_sim.plans import Item

PARAMS = ("WPNAV_SPEED", "RTL_ALT", "GUID_TIMEOUT")
LAT, LON = -35.3632621, 149.1652374
ALIGNED = math.radians(6)  # within which it counts as turned
HEADING, KEPT = 90.0, 0.05  # deg that it looks to at first, rad by which it may stray from it
GUIDED = 4
HERE = Item(16, 3, (0.0, 0.0, 0.0, 0.0), LAT, LON, 20.0, (round(LAT * 1e7), round(LON * 1e7)))
FLOWN = msgspec.structs.replace(HERE, params=(2.0, 0.0, 0.0, 0.0))
PAYLOADS = {
    "DISARM_DELAY": 0.0, "SERVO9_FUNCTION": 0.0, "RELAY1_FUNCTION": 1.0, "GRIP_ENABLE": 1.0,
    "WINCH_TYPE": 2.0, "CHUTE_ENABLED": 1.0, "FOLL_ENABLE": 1.0,
}  # fmt: skip
ON_THE_GROUND = (
    "action/motor_test", "service/calibrate/continue",
    "action/arm", "action/calibrate", "service/reboot", "service/reset_system", "service/enable",
    "action/param/load", "action/param/reset",
)  # fmt: skip
WAYPOINTS = f"QGC WPL 110\n0 1 0 16 0 0 0 0 {LAT} {LON} 584 1\n1 0 3 16 0 0 0 0 {LAT} {LON} 20 1\n"
SCRIPT, MOVED, MADE = "/APM/scripts/a.lua", "/APM/scripts/b.lua", "/APM/made"
LONG = msgspec.structs.replace(HERE, params=(900.0, 0.0, 0.0, 0.0))


class MavlinkRig(Hurried, StopRig):
    kind = next(iter(rcp_mavlink.rcp_backends()))
    complete_within = 20.0
    cancel_within = 5.0
    device: Twin
    relay: Relay
    calibrating: asyncio.Future[Any]

    @asynccontextmanager
    async def twin(self) -> AsyncGenerator[Twin]:
        async with (
            twin(latency=0.1, heading=HEADING, parameters=PAYLOADS) as running,
            relay(running.ports[0]) as self.relay,
        ):
            airborne(running.vehicle)
            self.link = f"udpout:127.0.0.1:{self.relay.port}"
            yield running

    def table(self) -> Mapping[str, Any]:
        return {"links": [self.link], "params": list(PARAMS), "silence": 1.5, "timeout": 0.5}

    @asynccontextmanager
    async def served_by_device(self) -> AsyncGenerator[Any]:
        async with super().served_by_device() as robot:
            await agrees(robot.backend, self.vehicle)
            await robot.backend.robots[""].parameters.complete.wait()
            yield robot

    @property
    def vehicle(self) -> Vehicle:
        return self.device.vehicle

    async def truth(self, name: str) -> Any:
        pilot = self.vehicle.pilot
        if name.startswith("actuator/"):
            # No setpoint is acknowledged, but what is answered was sent after it.
            await self.running.backend.read("param/GUID_TIMEOUT")
        if name == "param/speed_limit":
            return self.vehicle.params["WPNAV_SPEED"] / 100
        if name.startswith("param/"):
            value = self.vehicle.params[name.removeprefix("param/")]
            return int(value) if name == "param/RTL_ALT" else value
        if name == "actuator/gnss_corrections":
            return {"data": self.vehicle.corrections.received[-1]}
        if name == "actuator/follow_target":
            found = self.vehicle.leader.estimate(self.vehicle.wall)
            return {} if found is None else {"latitude": found[0].lat, "longitude": found[0].lon}
        if name == "actuator/velocity":
            yaw, (vn, ve) = self.vehicle.body.yaw, pilot.velocity
            x, right = (
                vn * math.cos(yaw) + ve * math.sin(yaw),
                ve * math.cos(yaw) - vn * math.sin(yaw),
            )
            return _rounded(x=x, y=-right, z=-pilot.sinking, yaw_rate=-pilot.yaw_rate)
        if name == "actuator/position":
            if pilot.place is None or pilot.depth is None:
                return {}
            n, e = pilot.place
            place = {"x": round(e, 1) + 0.0, "y": round(n, 1) + 0.0, "z": round(-pilot.depth, 1)}
            return {"position": place}
        if name == "actuator/cmd_vel":
            # The last turn ends while the velocity is repeated, which shows in its second decimal.
            turned = await self.truth("actuator/velocity")
            own = {axis: round(part, 1) + 0.0 for axis, part in turned.items() if axis in "xyz"}
            own["yaw_rate"] = round(turned["yaw_rate"], 2) + 0.0
            return {
                "linear": {axis: own[axis] for axis in "xyz"},
                "angular": {"x": 0.0, "y": 0.0, "z": own["yaw_rate"]},
            }
        if pilot.lean is None:
            return {}
        (roll, pitch), limits = pilot.lean, pilot.limits
        thrust = 0.5 - pilot.sinking / 2 / (limits.down if pilot.sinking > 0 else limits.up)
        kept = abs(pilot.yaw - math.radians(HEADING)) < KEPT
        return _rounded(roll=roll, pitch=pitch, thrust=thrust) | {
            "yaw": None if kept else pilot.yaw
        }

    def values(self, name: str) -> Sequence[Any]:
        return {
            "actuator/follow_target": (
                {"latitude": LAT, "longitude": LON},
                {"latitude": LAT + 1e-4, "longitude": LON},
            ),
            "actuator/gnss_corrections": ({"data": "0wAGPs0AAAAA"}, {"data": "0wAGPs0BAAAA"}),
            "param/WPNAV_SPEED": (500.0, 800.0),
            "param/RTL_ALT": (2000, 3000),
            "param/GUID_TIMEOUT": (2.0, 3.0),
            "param/speed_limit": (5.0, 8.0),
            "actuator/cmd_vel": (
                {"linear": {"x": 2.0}},
                {"linear": {"z": 1.0}, "angular": {"z": 0.25}},
            ),
            "actuator/position": (
                {"position": {"x": 2.0, "y": 4.0, "z": 20.0}},
                {"position": {"x": 3.0, "y": -4.0, "z": 21.0}},
            ),
            "actuator/velocity": ({"x": 2.0}, {"x": 0.0, "z": 1.0}),
            "actuator/attitude": ({"pitch": -0.125, "thrust": 0.5}, {"roll": 0.125, "thrust": 0.5}),
        }[name]

    def goals(self) -> Mapping[str, Goal]:
        mission = {"items": [{"command": "NAV_WAYPOINT", "latitude": LAT, "longitude": LON}]}
        unknown = {"items": [{"command": "NAV_WAIPOINT"}]}
        return {
            # The vehicle keeps few logs, and each flight of the other goals adds one.
            "service/log/read": Goal(good={"id": 1}, bad={"id": 999}),
            "action/move_to": Goal(
                good={"north": 10.0, "altitude": 20.0},
                bad={"latitude": 1.0},
                long={"north": 900.0, "altitude": 30.0},
            ),
            "action/takeoff": Goal(good={"altitude": 10.0}, long={"altitude": 100.0}),
            "action/land": Goal(good=None),
            "action/rtl": Goal(good=None),
            "action/return_home": Goal(good=None),
            "action/arm": Goal(good=None),
            "action/disarm": Goal(good=None),
            "action/set_mode": Goal(good={"mode": "LOITER"}, bad={"mode": "FLY"}),
            "action/mission/upload": Goal(good=mission, bad=unknown),
            "action/mission/run": Goal(good=None),
            "action/mission/pause": Goal(good=None),
            "action/mission/resume": Goal(good=None),
            "action/gimbal": Goal(good={"pitch": -0.5}),
            "service/gimbal/release": Goal(good=None, bad={"gimbal": 3}),
            "action/camera/photo": Goal(good=None),
            "action/calibrate": Goal(good=None),
            "service/calibrate/continue": Goal(good=None),
            "action/turn": Goal(good={"by": 0.5}, bad={}, long={"by": 3.0, "rate": 0.1}),
            "action/orbit": Goal(
                good={"radius": 2.0, "speed": 2.0, "turns": 0.5},
                bad={"radius": 2.0, "latitude": 1.0},
                long={"radius": 10.0, "turns": 100},
            ),
            "action/follow": Goal(good={"seconds": 1.0}, bad={"vehicle": "nobody"}, long={}),
            "service/mission/set_current": Goal(good={"item": 2}, bad={"item": 9}),
            "action/motor_test": Goal(
                good={"motor": 1}, bad={"motor": 9}, long={"motor": 1, "seconds": 3.0}
            ),
            "action/winch": Goal(
                good={"length": 1.0},
                bad={"length": 90.0, "speed": 5.0},
                long={"length": 40.0, "speed": 0.1},
            ),
            "action/param/load": Goal(good={"text": "RTL_ALT,2000\n"}, bad={"text": "NO_SUCH,1\n"}),
            "action/param/reset": Goal(good=None),
            "action/plan/load": Goal(good={"text": WAYPOINTS}, bad={"text": "{}"}),
            **_files(),
            "service/reboot": Goal(good=None),
            "service/reset_system": Goal(good=None),
            "service/enable": Goal(good=None),
            "service/disable": Goal(good=None),
        }

    async def prepare(self, name: str) -> None:
        vehicle = self.vehicle
        motion = self.backend.robots[""].motion
        await eventually(_nothing(motion.parting), "what was cancelled has ended")
        if name.startswith("service/ftp/"):
            await self._tidy()
        mission = vehicle.flight.mission
        if name in ON_THE_GROUND:
            on_the_ground(vehicle)
        elif name in ("action/disarm", "action/takeoff", "service/disable"):
            armed(vehicle)
        else:
            airborne(vehicle)
        vehicle.payloads.line = 0.0
        if name.startswith("action/mission/") or name == "service/mission/set_current":
            items = [HERE, *[FLOWN if name == "action/mission/run" else LONG] * 3]
            mission.plan.replace(items)
            mission.changed()
            mission.complete = False
        if name in ("action/mission/pause", "action/mission/resume"):
            vehicle.flight.set_mode(Mode.AUTO)
            mission.start()
            if name.endswith("resume"):
                mission.pause(paused=True)
            else:
                skip(vehicle, lambda: mission.current > 0)
        await agrees(self.backend, vehicle)
        if name == "action/follow":
            await self.backend.write("actuator/follow_target", Target(LAT, LON))
        if name == "service/calibrate/continue":
            await self._wait_for_a_position()

    async def _wait_for_a_position(self) -> None:
        asked = asyncio.Event()

        def progress(feedback: Any = None, *, fraction: float | None = None) -> None:
            if feedback is not None:
                asked.set()

        robot, goal = self.backend.robots[""], Calibrate("accelerometer_full")
        self.calibrating = asyncio.ensure_future(robot.execute("action/calibrate", goal, progress))
        async with asyncio.timeout(60):
            await asked.wait()

    async def _tidy(self) -> None:
        """Have the file there that is removed and renamed, and not the one that is made."""
        robot = self.backend.robots[""]
        for path, directory in ((MOVED, False), (MADE, True)):
            with suppress(RcpError):
                await robot.execute("service/ftp/remove", Remove(path, directory), _silent)
        await robot.execute("service/ftp/write", FileWrite(SCRIPT, b"return 1"), _silent)

    async def confirms(self, name: str, result: Any) -> bool:
        vehicle = self.vehicle
        flight = vehicle.flight
        match name:
            case "action/arm" | "service/enable":
                return vehicle.armed
            case (
                "action/disarm"
                | "action/land"
                | "action/rtl"
                | "action/return_home"
                | "service/disable"
                | "service/reset_system"
            ):
                return not vehicle.armed
            case "action/takeoff":
                return abs(-vehicle.body.d - result["altitude"]) < 1
            case "action/move_to":
                return math.dist((vehicle.body.n, vehicle.body.e), (10, 0)) < 1.5
            case "action/set_mode":
                return flight.mode.name == result["mode"]
            case "action/mission/upload":
                return len(flight.mission.plan.items) == result["count"] + 1
            case "action/mission/run":
                return flight.mission.complete
            case "action/mission/pause":
                return flight.mission.paused
            case "action/mission/resume":
                return not flight.mission.paused
            case "service/calibrate/continue":
                self.calibrating.cancel()
                return vehicle.calibrations.position == 2
            case "action/turn":
                return await self._has_turned(result["heading"])
            case "action/orbit":
                return flight.mode is Mode.GUIDED
            case "action/follow":
                return flight.mode is Mode.BRAKE
            case "service/mission/set_current":
                return flight.mission.current == result["item"]
            case "action/motor_test":
                return not vehicle.motor_test.motor
            case "action/winch":
                return vehicle.payloads.line == result["length"]
            case "action/gimbal":
                return abs(math.radians(vehicle.mount.pitch) - result["pitch"]) < 0.02
            case "action/camera/photo":
                shown = base64.b64decode(result["image"]["data"])
                stored = vehicle.files.read(f"DCIM/{result['number']:05d}.png")
                return vehicle.mount.photos == result["number"] and shown == stored
            case _:
                return True

    async def _has_turned(self, reported: float) -> bool:
        """Wait until it looks where it was told to: it turns on a little after it has said that it does."""
        vehicle = self.vehicle

        async def there() -> bool:
            return abs(math.remainder(vehicle.body.yaw - vehicle.pilot.yaw, math.tau)) < KEPT

        await eventually(there, "it looks where it was told to")
        return abs(math.remainder(reported - vehicle.pilot.yaw, math.tau)) < ALIGNED + KEPT

    async def at_rest(self) -> bool:
        vehicle = self.vehicle
        if vehicle.motor_test.motor or vehicle.payloads.line_speed:
            return False
        return vehicle.body.landed or speed(vehicle) < 0.5

    async def break_link(self) -> None:
        self.device.muted = True

    async def mend_link(self) -> None:
        self.device.muted = False

    async def freeze_device(self) -> None:
        self.device.muted = True
        self.vehicle.advance = _stand_still  # type: ignore[method-assign]

    async def thaw_device(self) -> None:
        del self.vehicle.advance
        self.device.muted = False

    async def freeze_feedback(self) -> None:
        self.relay.down = lambda number: number in (HEARTBEAT, COMMAND_ACK)

    async def thaw_feedback(self) -> None:
        self.relay.down = lambda _: True

    @asynccontextmanager
    async def foreign_commander(self) -> AsyncGenerator[None]:
        async with commander(self.device.ports[0]) as other:

            async def command() -> None:
                while True:  # who takes it away again and again, and leads it all the time
                    other.mode(GUIDED)
                    for _ in range(30):
                        other.go(2000.0, 20.0)
                        await asyncio.sleep(0.1)

            task = asyncio.create_task(command())
            try:
                yield
            finally:
                task.cancel()
                await asyncio.gather(task, return_exceptions=True)


class TestMavlink(MavlinkRig, BackendSuite):
    """What any backend owes."""


class TestMavlinkStops(MavlinkRig, StopSuite):
    """What any stop owes."""


def _stand_still(_: float, __: float) -> None:
    """Let no time pass."""


def _silent(_: Any = None, *, fraction: float | None = None) -> None:
    """Take no note of progress."""


def _files() -> dict[str, Goal]:
    gone = {"path": "/APM/gone.txt"}
    return {
        "service/ftp/list": Goal(good={"path": "/APM"}, bad=gone),
        "service/ftp/read": Goal(good={"path": SCRIPT}, bad=gone),
        "service/ftp/write": Goal(good={"path": SCRIPT, "data": "cmV0dXJuIDE="}),
        "service/ftp/crc": Goal(good={"path": SCRIPT}, bad=gone),
        "service/ftp/remove": Goal(good={"path": SCRIPT}, bad=gone),
        "service/ftp/mkdir": Goal(good={"path": MADE}),
        "service/ftp/rename": Goal(good={"path": SCRIPT, "to": MOVED}),
    }


def _nothing(tasks: set[Any]) -> Any:
    async def holds() -> bool:
        return not tasks

    return holds


def _rounded(**values: float) -> dict[str, float]:
    return {name: round(value, 4) + 0.0 for name, value in values.items()}
