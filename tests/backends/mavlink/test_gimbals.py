"""Several gimbals: each is listed, turned and released for itself, whoever manages it."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import pytest

from backends.mavlink.flying import airborne
from backends.mavlink.puppet import Puppet, station
from backends.mavlink.test_gateway import LAT, LON, flying
from rcp_gateway.testing import eventually

OWN, COMPANION = 154, 191
TWO = {"parameters": {"DISARM_DELAY": 0.0, "MNT2_TYPE": 1.0, "MNT2_PITCH_MIN": -45.0}}


async def test_both_gimbals_of_an_autopilot_are_listed_turned_and_released() -> None:
    async with flying(TWO) as pilot:
        airborne(pilot.vehicle)
        await pilot.ready()
        first, second = (await pilot.do("service/gimbal/list"))["body"]
        assert (first["gimbal"], first["manager"], second["gimbal"]) == (1, 1, 2)
        assert (first["vendor"], first["controller"], first["in_control"]) == ("rcp", None, False)
        assert second["pitch_min"] == pytest.approx(-math.pi / 4)
        reply = await pilot.do("action/gimbal", {"pitch": -0.5, "gimbal": 2})
        assert (reply["body"]["gimbal"], reply["body"]["manager"]) == (2, 1)
        one, two = pilot.vehicle.mounts
        assert math.radians(two.pitch) == pytest.approx(-0.5, abs=0.02)
        assert one.pitch == 0.0
        beyond = await pilot.do("action/gimbal", {"pitch": -1.2, "gimbal": 2})
        assert beyond["error"]["code"] == "out_of_range"
        assert (await pilot.do("action/gimbal", {"pitch": -1.2}))["body"]["gimbal"] == 1
        assert (await pilot.do("service/gimbal/list"))["body"][1]["in_control"]
        assert (await pilot.do("service/gimbal/release", {"gimbal": 2}))["status"] == "completed"
        assert (one.control, two.control) == ((255, 190), (0, 0))
        missing = await pilot.do("action/gimbal", {"gimbal": 3})
        assert missing["error"]["details"]["pointer"] == "/gimbal"


async def test_a_gimbal_that_does_not_look_at_the_place_is_told() -> None:
    place = {"latitude": LAT + 2e-4, "longitude": LON}
    async with flying(TWO) as pilot:
        airborne(pilot.vehicle)
        await pilot.ready()
        seen = await pilot.do("service/camera/look_at", {**place, "gimbal": 1})
        assert seen["status"] == "completed", seen
        # ArduPilot turns its first gimbal, whichever the command names.
        other = await pilot.do("service/camera/look_at", {**place, "gimbal": 2})
        assert other["error"]["code"] == "device_timeout"
        assert "gimbal 2 does not look there" in other["message"]
        assert pilot.vehicle.mount.region is None


class Managers(Puppet):
    """A gimbal that is a component of its own, and two of a companion computer."""

    def __init__(self) -> None:
        super().__init__()
        self.angles = {
            (OWN, OWN): (0.0, 0.0),
            (COMPANION, 1): (0.0, 0.0),
            (COMPANION, 2): (0.0, 0.0),
        }
        self.control: dict[tuple[int, int], tuple[int, int]] = {}
        self.lost = 0  # of the answers about gimbals, from the next on
        self.stuck: tuple[int, int] | None = None
        self.places: list[tuple[int, float]] = []
        self.also.append(self._report)

    def say_as(self, component: int, name: str, *fields: Any) -> None:
        self.out.srcComponent = component
        self.send(name, *fields)
        self.out.srcComponent = 1

    def take(self, message: Any) -> None:
        target = getattr(message, "target_component", 1)
        if message.get_type().startswith("COMMAND_") and target in (OWN, COMPANION):
            self.got.append(message)
            result = self.manage(target, message)
            self.say_as(target, "COMMAND_ACK", message.command, result, 0, 0, 255, 190)
            return
        super().take(message)

    def manage(self, manager: int, message: Any) -> int:
        if message.command == 512:
            return self._tell(manager, int(message.param1))
        if message.command == 195:
            self.places.append((manager, message.param1))
            return 0
        if message.command not in (1000, 1001):
            return 3
        key = (manager, int(message.param7))
        if key not in self.angles:
            return 4
        if message.command == 1001:
            gives_up = message.param1 == -3
            self.control[key] = (0, 0) if gives_up else (int(message.param1), int(message.param2))
        elif key != self.stuck:
            self.angles[key] = (math.radians(message.param1), math.radians(message.param2))
        return 0

    def _tell(self, manager: int, number: int) -> int:
        if number not in (280, 281):
            return 3
        for one, device in self.angles:
            if one != manager:
                continue
            if self.lost:
                self.lost -= 1
            elif number == 280:
                self.say_as(
                    one, "GIMBAL_MANAGER_INFORMATION", 0, 0, device, 0, 0, -1.5, 0.5, -3.1, 3.1
                )
            else:
                control = self.control.get((one, device), (0, 0))
                self.say_as(one, "GIMBAL_MANAGER_STATUS", 0, 0, device, *control, 0, 0)
        return 0

    def _report(self) -> None:
        self.say_as(OWN, "HEARTBEAT", 26, 8, 0, 0, 4, 3)
        self.say_as(COMPANION, "HEARTBEAT", 18, 8, 0, 0, 4, 3)
        for (component, device), (pitch, yaw) in self.angles.items():
            cp, sp, cy, sy = (f(a / 2) for a in (pitch, yaw) for f in (math.cos, math.sin))
            q = [cp * cy, -sp * sy, sp * cy, cp * sy]
            told = 0 if component == device else device
            self.say_as(
                component, "GIMBAL_DEVICE_ATTITUDE_STATUS", 0, 0, self.clock, 32, q, 0, 0, 0, 0, 0, 0, told
            )  # fmt: skip


async def heard(found: Any) -> None:
    async def both() -> bool:
        return {OWN, COMPANION} <= found.robot.vehicle.components.keys()

    await eventually(both, "both managers are heard")


async def test_gimbals_of_several_managers_are_told_apart_although_answers_are_lost() -> None:
    puppet = Managers()
    async with station(puppet) as found:
        await heard(found)
        puppet.lost = 2  # that of the gimbal, and the first of the companion
        listed = (await found.do("service/gimbal/list"))["body"]
        keys = [(one["manager"], one["gimbal"]) for one in listed]
        assert keys == [(OWN, OWN), (COMPANION, 1), (COMPANION, 2)]
        for manager, gimbal in keys:
            reply = await found.do("action/gimbal", {"pitch": -gimbal / 300, "gimbal": gimbal})
            assert reply["status"] == "completed", reply
            assert reply["body"]["manager"] == manager
        assert puppet.angles[COMPANION, 2][0] == pytest.approx(-2 / 300, abs=1e-4)
        puppet.stuck = (COMPANION, 2)
        puppet.angles[COMPANION, 1] = puppet.angles[OWN, OWN] = (-1.0, 0.0)
        stuck = await found.do("action/gimbal", {"pitch": -1.0, "gimbal": 2})
        assert stuck["error"]["code"] == "device_timeout", "others that look there do not count"


async def test_two_managers_with_the_same_number_have_to_be_named() -> None:
    puppet = Managers()
    puppet.angles = {(OWN, 1): (0.0, 0.0), (COMPANION, 1): (0.0, 0.0)}
    async with station(puppet) as found:
        await heard(found)
        reply = await found.do("action/gimbal", {"gimbal": 1})
        assert reply["error"]["details"]["pointer"] == "/manager"
        named = await found.do("action/gimbal", {"pitch": 0.25, "gimbal": 1, "manager": COMPANION})
        assert named["status"] == "completed", named
        assert puppet.angles[OWN, 1] == (0.0, 0.0)
        puppet.angles[COMPANION, 1] = (0.0, 0.0)
        where = {"latitude": 47.0001, "longitude": 8.0, "gimbal": 1, "manager": COMPANION}
        looking = asyncio.ensure_future(found.do("service/camera/look_at", where))
        await eventually(lambda: _is(bool(puppet.places)), "the manager is told")
        assert puppet.places == [(COMPANION, 1.0)]
        assert (await looking)["status"] == "completed"


async def test_the_autopilots_own_gimbal_is_meant_although_its_answer_is_lost() -> None:
    puppet = Managers()
    puppet.angles = {(1, 1): (0.0, 0.0), (COMPANION, 1): (0.0, 0.0)}
    puppet.lost = 1

    def request(message: Any) -> int:
        told = puppet.manage(1, message) if message.param1 in (280, 281) else 3
        return puppet.request(int(message.param1)) if told == 3 else told

    puppet.results |= {512: request, **dict.fromkeys((1000, 1001), lambda c: puppet.manage(1, c))}
    async with station(puppet) as found:
        await heard(found)
        reply = await found.do("action/gimbal", {"pitch": -0.25})
        assert reply["status"] == "completed", reply
        assert reply["body"]["manager"] == 1
        assert puppet.angles[COMPANION, 1] == (0.0, 0.0)


async def test_a_lost_link_ends_a_turn_with_its_error() -> None:
    puppet = Managers()
    puppet.stuck = (COMPANION, 2)
    async with station(puppet) as found:
        await heard(found)
        turning = asyncio.ensure_future(found.do("action/gimbal", {"pitch": -1.0, "gimbal": 2}))
        await eventually(lambda: _is(bool(puppet.commands(1000))), "it was told to turn")
        puppet.quiet = True
        assert (await turning)["error"]["code"] == "adapter_unavailable"
        puppet.quiet, puppet.stuck = False, None
        await eventually(lambda: _is(not found.robot.vehicle.lost), "it is heard again")
        again = await found.do("action/gimbal", {"pitch": -1.0, "gimbal": 2})
        assert again["status"] == "completed", again


async def test_without_a_manager_there_is_nothing_to_list_name_or_release() -> None:
    async with station(Puppet()) as found:
        assert (await found.do("service/gimbal/list"))["body"] == []
        assert (await found.do("action/gimbal", {"gimbal": 1}))["error"]["code"] == "out_of_range"
        released = await found.do("service/gimbal/release")
        assert released["error"]["code"] == "precondition_failed"


async def _is(truth: bool) -> bool:  # noqa: FBT001 - for `eventually`, which awaits
    return truth
