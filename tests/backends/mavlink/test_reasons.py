"""Why something is refused: reasons that hold now, also where the vehicle says none."""

from __future__ import annotations

from typing import Any

import rcp_mavlink.telemetry_events
from backends.mavlink.flying import airborne, armed, on_the_ground
from backends.mavlink.puppet import Puppet, Station, station
from backends.mavlink.test_gateway import Pilot, flying
from rcp_gateway.testing import eventually

UNFIT = 0


class Unfit(Puppet):
    """Not ready to be armed; it says why when the test says so."""

    def __init__(self) -> None:
        super().__init__()
        self.health = UNFIT
        self.why: list[str] = []
        self.results[401] = self._check
        self.results[400] = lambda _: 4

    def _check(self, _: Any) -> int:
        for reason in self.why:
            self.say(f"PreArm: {reason}", 2)
        return 0


async def reasons(found: Station) -> list[str]:
    return (await found.read("sensor/prearm"))["reasons"]


async def comes_to(found: Station, wanted: list[str]) -> None:
    async def holds() -> bool:
        return await reasons(found) == wanted

    await eventually(holds, f"{wanted} is read")


async def test_a_reason_that_is_not_repeated_holds_no_longer() -> None:
    puppet = Unfit()
    async with station(puppet) as found:
        puppet.say("PreArm: Compass not healthy", 2)
        puppet.say("PreArm: Battery 1 below minimum arming voltage", 2)
        await comes_to(found, ["Compass not healthy", "Battery 1 below minimum arming voltage"])
        puppet.say("PreArm: Battery 1 below minimum arming voltage", 2)
        await comes_to(found, ["Battery 1 below minimum arming voltage"])
        assert not (await found.read("sensor/prearm"))["ready"]


async def test_reasons_of_before_it_was_ready_are_gone(monkeypatch: Any) -> None:
    monkeypatch.setattr(rcp_mavlink.telemetry_events, "_SETTLED", 0.2)
    puppet = Unfit()
    async with station(puppet) as found:
        puppet.say("PreArm: Compass not healthy", 2)
        await comes_to(found, ["Compass not healthy"])
        puppet.health = 1 << 28
        await eventually(lambda: _ready(found), "it is ready")
        await comes_to(found, [])
        await eventually(
            lambda: _is(not found.robot.telemetry_events._complaints),  # noqa: SLF001 - nothing shows what is forgotten
            "they are forgotten",
            5.0,
        )
        puppet.health = UNFIT

        async def unfit() -> bool:
            return not await _ready(found)

        await eventually(unfit, "it is not ready again")
        assert await reasons(found) == []


async def test_a_reason_that_the_vehicle_fell_silent_about_expires(monkeypatch: Any) -> None:
    monkeypatch.setattr(rcp_mavlink.telemetry_events, "_COMPLAINTS", 0.5)
    puppet = Unfit()
    async with station(puppet) as found:
        puppet.say("PreArm: Compass not healthy", 2)
        await comes_to(found, ["Compass not healthy"])
        await comes_to(found, [])


async def test_where_none_is_known_the_vehicle_is_asked_for_them() -> None:
    puppet = Unfit()
    puppet.why = ["Gyros inconsistent", "Need Position Estimate"]
    async with station(puppet) as found:
        await comes_to(found, puppet.why)
        assert len(puppet.commands(401)) == 1


async def _ready(found: Station) -> bool:
    return (await found.read("sensor/prearm"))["ready"]


# Refused without a word


async def test_a_disarm_that_is_refused_in_the_air_says_so() -> None:
    async with flying() as pilot:
        airborne(pilot.vehicle)
        await pilot.ready()
        reply = await pilot.do("action/disarm")
        assert reply["error"]["code"] == "device_rejected"
        assert reply["message"] == "disarm: failed: the vehicle is in the air"
        assert "action/land" in reply["error"]["remedy"]
        assert "force" in reply["error"]["remedy"]
        assert pilot.vehicle.armed


async def test_a_reboot_that_is_refused_while_armed_says_so() -> None:
    async with flying() as pilot:
        armed(pilot.vehicle)
        await pilot.ready()
        reply = await pilot.do("service/reboot")
        assert reply["message"] == "reboot: failed: the vehicle is armed"
        on_the_ground(pilot.vehicle)


async def test_an_integer_written_to_its_unset_default_is_written() -> None:
    async with flying() as pilot:
        await parameters(pilot)
        for value in (1500, 1500, 1800, 1500):
            reply = await pilot.client.request("write", "/tenant/t/param/RTL_ALT", body=value)
            assert reply["status"] == "completed", reply["error"]
            assert reply["body"] == value
            assert isinstance(reply["body"], int)
            assert pilot.vehicle.params["RTL_ALT"] == value
        assert (await pilot.read("param/RTL_ALT")) == 1500
        sent: list[Any] = []
        (peer,) = pilot.twin.peers
        take = peer.handlers["PARAM_SET"]
        peer.handlers["PARAM_SET"] = lambda m: (sent.append(m.param_type), take(m))
        reply = await pilot.client.request("write", "/tenant/t/param/FS_OPTIONS", body=16)
        assert reply["body"] == 16
        reply = await pilot.client.request("write", "/tenant/t/param/FS_OPTIONS", body=8)
        assert reply["body"] == 8
        assert set(sent) == {6}, "it is told with the type that the list said"


async def parameters(pilot: Pilot) -> None:
    robot = pilot.served.life.backend.robots[""]
    await robot.parameters.complete.wait()
    await eventually(
        lambda: _is("param/RTL_ALT" in pilot.served.supervisor.entries), "they are there"
    )


async def _is(truth: bool) -> bool:  # noqa: FBT001 - for `eventually`, which awaits
    return truth
