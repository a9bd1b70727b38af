"""A stop holds: at rest by measurement, on every link that comes and goes, against whoever moves it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest
from pymavlink import mavutil

import rcp_mavlink
from backends.mavlink.flying import agrees, airborne, on_the_ground, speed, twin
from backends.mavlink.puppet import Puppet, station
from backends.mavlink.relay import COMMAND_ACK, HEARTBEAT, SET_MODE, Relay, commander, relay
from backends.mavlink.twins import twin_process
from rcp_gateway.testing import eventually
from rcp_gateway.testing._serve import ADMIN, OPERATOR, serve_backend
from rcp_kernel.errors import AdapterUnavailable
from rcp_mavlink.signing import key_of
from rcp_mavlink_sim import Twin, Vehicle
from rcp_mavlink_sim.modes import Mode

KIND = next(iter(rcp_mavlink.rcp_backends()))
BRAKE, LAND, GUIDED = 17, 9, 4
GLOBAL_POSITION_INT = 33
STAYS = 2.0  # s that it is watched to stay at rest
AT_REST = 0.5  # m/s
SOON = 2  # heartbeats: one may be on its way


class Stopped:
    """A twin behind a relay behind a gateway, and an operator."""

    def __init__(self, served: Any, running: Twin, link: Relay) -> None:
        self.served, self.twin, self.relay = served, running, link
        self.vehicle: Vehicle = running.vehicle
        self.client = served.client(OPERATOR)

    @property
    def robot(self) -> Any:
        return self.served.life.backend.robots[""]

    async def moving(self, height: float = 40.0) -> str:
        """Put it in the air and have an action move it; return the id of the action."""
        airborne(self.vehicle, height)
        await agrees(self.served.life.backend, self.vehicle)
        path = "/tenant/t/action/move_to"
        body = {"north": 3000.0, "altitude": height}
        id_ = await self.client.send(type="execute", path=path, body=body)
        await until(lambda: speed(self.vehicle) > 4, "it moves")
        return id_

    async def estop(self, deadline: float = 5.0) -> Any:
        return await self.client.request(
            "execute", "/system/estop", deadline=deadline, within=deadline + 20
        )

    async def reset(self) -> None:
        admin = self.served.client(ADMIN)
        reply = await admin.request("execute", "/system/estop", body={"reset": True})
        assert reply["status"] == "completed", reply

    async def state(self) -> dict[str, Any]:
        reply = await self.client.request("read", "/system/estop")
        (found,) = reply["body"]["robots"].values()
        return found

    async def confirmed(self, within: float = 20.0) -> None:
        async def holds() -> bool:
            return (await self.state())["state"] == "confirmed"

        await eventually(holds, "the stop is confirmed", within)

    async def stays(self, seconds: float = STAYS) -> None:
        """Watch that it does not move."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            assert speed(self.vehicle) < AT_REST
            await asyncio.sleep(0.02)


@asynccontextmanager
async def flying(options: dict[str, Any] | None = None, **config: Any) -> AsyncGenerator[Stopped]:
    async with (
        twin(**({"speed": 2.0} | (options or {}))) as running,
        relay(running.ports[0]) as link,
    ):
        table = {"links": [f"udpout:127.0.0.1:{link.port}"], "params": [], "silence": 1.5, **config}
        async with serve_backend(KIND, table) as served:
            await until(lambda: bool(served.lives), "it is heard")
            yield Stopped(served, running, link)


async def until(holds: Callable[[], object], what: str, within: float = 20.0) -> None:
    async def check() -> bool:
        return bool(holds())

    await eventually(check, what, within)


# The link


async def test_a_vehicle_that_is_lost_is_not_confirmed_and_gets_the_stop_first_when_it_returns() -> (
    None
):
    async with flying() as found:
        id_ = await found.moving()
        found.relay.cut = True
        final = await found.client.final(id_)
        assert final["error"]["code"] == "adapter_unavailable"
        assert final["error"]["details"]["on_loss"] == "hold"
        reply = await found.estop(deadline=1.0)
        assert reply["status"] == "failed", reply
        assert reply["error"]["code"] == "device_timeout"
        with pytest.raises(AdapterUnavailable, match="vehicle 1"):
            await found.served.life.backend.halt()
        assert found.served.life.backend.motion(None).at_rest is None
        assert speed(found.vehicle) > 4, "it flies on meanwhile"
        del found.relay.sent[:]
        found.relay.cut = False
        await until(lambda: found.relay.sent, "something is sent")
        first = found.relay.sent[0]
        assert (first.get_type(), first.command, first.param2) == ("COMMAND_LONG", SET_MODE, BRAKE)
        await found.confirmed()
        assert speed(found.vehicle) < AT_REST
        assert found.vehicle.flight.mode is Mode.BRAKE
        await found.stays()


async def test_a_link_that_is_cut_at_the_stop_and_returns_later_ends_at_rest() -> None:
    async with flying() as found:
        await found.moving()
        found.relay.cut = True  # before the gateway knows of it
        reply = await found.estop(deadline=1.0)
        assert reply["status"] == "failed", reply
        assert (await found.state())["state"] != "confirmed"
        found.relay.cut = False
        await found.confirmed()
        await found.stays()


async def test_a_link_that_is_cut_after_the_stop_is_not_confirmed_until_it_returns() -> None:
    async with flying() as found:
        await found.moving()
        assert (await found.estop())["status"] == "completed"
        found.relay.cut = True

        async def doubted() -> bool:
            return (await found.state())["state"] != "confirmed"

        await eventually(doubted, "it is not confirmed any more")
        found.vehicle.flight.set_mode(Mode.GUIDED)  # a failsafe, or somebody else, meanwhile
        found.vehicle.flight.aim((3000.0, 0.0), -40.0)
        await until(lambda: speed(found.vehicle) > 2, "it moves")
        found.relay.cut = False
        await found.confirmed()
        await found.stays()


async def test_the_stop_goes_out_also_where_only_the_way_back_is_lost() -> None:
    async with flying() as found:
        await found.moving()
        found.relay.down = lambda _: False
        await until(lambda: found.robot.vehicle.lost, "it is lost")
        reply = await found.estop(deadline=0.5)
        assert reply["status"] == "failed"
        await until(lambda: speed(found.vehicle) < AT_REST, "it got the stop all the same")
        found.relay.down = lambda _: True
        await found.confirmed()


async def test_a_vehicle_that_is_found_under_a_latch_gets_the_stop_before_anything_else() -> None:
    async with (
        twin(speed=2.0) as first,
        twin(speed=2.0, system=2) as second,
        relay(second.ports[0]) as link,
    ):
        airborne(second.vehicle, 40.0)
        second.vehicle.flight.aim((3000.0, 0.0), -40.0)
        link.cut = True
        links = [f"udpout:127.0.0.1:{port}" for port in (first.ports[0][1], link.port)]
        async with serve_backend(KIND, {"links": links, "discover": True, "params": []}) as served:
            await until(lambda: bool(served.lives), "the first is heard")
            client = served.client(OPERATOR)
            assert (await client.request("execute", "/system/estop"))["status"] == "completed"
            link.cut = False
            await until(lambda: link.sent, "something is sent to the second")
            assert link.sent[0].command == SET_MODE
            assert link.sent[0].param2 == BRAKE
            await until(lambda: speed(second.vehicle) < AT_REST, "it is at rest")


async def test_two_of_three_stop_messages_lost_delay_it_and_no_more() -> None:
    async with flying() as found:
        await found.moving()
        count = 0

        def third(message: Any) -> bool:
            nonlocal count
            if getattr(message, "command", None) != SET_MODE:
                return True
            count += 1
            return count % 3 == 0

        found.relay.up = third
        began = time.monotonic()
        reply = await found.estop()
        assert reply["status"] == "completed", reply
        assert time.monotonic() - began < 15
        assert found.vehicle.flight.mode is Mode.BRAKE
        await found.stays(1.0)


async def test_acknowledgements_that_are_lost_matter_not() -> None:
    async with flying() as found:
        await found.moving()
        found.relay.down = lambda number: number != COMMAND_ACK
        assert (await found.estop())["status"] == "completed"
        await found.stays(1.0)


# The vehicle


async def test_a_frozen_vehicle_is_not_confirmed_and_stops_when_it_thaws() -> None:
    async with flying() as found:
        await found.moving()
        advance = found.vehicle.advance
        found.vehicle.advance = lambda *_: None  # type: ignore[method-assign]
        found.twin.muted = True
        reply = await found.estop(deadline=1.0)
        assert reply["status"] == "failed"
        assert reply["error"]["code"] == "device_timeout"
        found.vehicle.advance, found.twin.muted = advance, False  # type: ignore[method-assign]
        assert speed(found.vehicle) > 4
        await found.confirmed()
        await found.stays()


async def test_a_stop_is_not_confirmed_without_positions_and_is_with_the_next_one() -> None:
    async with flying() as found:
        await found.moving()
        found.relay.down = lambda number: number in (HEARTBEAT, COMMAND_ACK)
        reply = await found.estop(deadline=3.0)
        assert reply["status"] == "failed", reply
        await until(lambda: found.vehicle.flight.mode is Mode.BRAKE, "it was told to brake")
        assert "position" in (await found.state())["detail"]
        found.relay.down = lambda _: True
        await found.confirmed()


async def test_positions_that_are_repeated_prove_nothing() -> None:
    """They say that it rests, with the time stamp of when it did."""
    async with flying() as found, commander(found.twin.ports[0]) as other:
        airborne(found.vehicle, 40.0)
        await agrees(found.served.life.backend, found.vehicle)
        found.twin.faults.telemetry = "stale"
        other.fly(3000.0, 40.0)
        await until(lambda: speed(found.vehicle) > 4, "it moves")
        reply = await found.estop(deadline=3.0)
        assert reply["status"] == "failed", reply
        assert "position" in (await found.state())["detail"]
        assert found.vehicle.flight.mode is Mode.BRAKE
        found.twin.faults.telemetry = "live"
        await found.confirmed()


async def test_zeros_that_are_sent_without_a_position_prove_nothing() -> None:
    """A real one says that it stands, whatever it does; its estimator says that it does not know."""
    async with flying() as found:
        await found.moving()
        found.vehicle.params.set("FS_EKF_ACTION", 0.0)  # no failsafe of its own
        found.vehicle.params.set("SIM_GPS1_ENABLE", 0.0)
        gateway = found.robot.vehicle
        await until(lambda: gateway.fix.speed < 0.1, "it says that it stands")
        end = time.monotonic() + 3.0
        while time.monotonic() < end:
            assert speed(found.vehicle) > 2, "it flies on"
            assert gateway.fix.speed < AT_REST
            assert found.robot.measurement.still_for < 1.0
            assert found.served.life.backend.motion(None).at_rest is not True
            await asyncio.sleep(0.02)
        assert found.robot.measurement.speed is None


async def test_somebody_else_who_moves_it_under_the_latch_is_overruled_each_time() -> None:
    async with flying() as found, commander(found.twin.ports[0]) as other:
        await found.moving()
        assert (await found.estop())["status"] == "completed"
        for _ in range(3):
            told, shown = len(found.relay.commands(SET_MODE)), 0

            def count(number: int, told: int = told) -> bool:
                """Count what shows the gateway the other's mode before it has told it again."""
                nonlocal shown
                overruled = len(found.relay.commands(SET_MODE)) > told
                shown += number == HEARTBEAT and guided() and not overruled
                return True

            def guided() -> bool:
                return found.vehicle.flight.mode is Mode.GUIDED

            found.relay.down = count
            other.fly(3000.0, 40.0)  # it may be taken back before anybody looks
            await until(lambda n=told: len(found.relay.commands(SET_MODE)) > n, "it is told again")
            await until(lambda: found.vehicle.flight.mode is Mode.BRAKE, "it is taken back")
            await until(lambda: speed(found.vehicle) < AT_REST, "it is at rest again")
            # How far it came until the first of its heartbeats says so is the machine's affair.
            assert shown <= SOON, f"{shown} heartbeats showed GUIDED before it was told again"
        await found.confirmed()
        await found.stays()


async def test_somebody_else_who_arms_it_on_the_ground_under_the_latch_gets_it_disarmed() -> None:
    async with flying({"parameters": {"DISARM_DELAY": 0.0}}) as found, commander(found.twin.ports[0]) as other:  # fmt: skip
        on_the_ground(found.vehicle)
        await agrees(found.served.life.backend, found.vehicle)
        assert (await found.estop())["status"] == "completed"
        del found.relay.sent[:]
        other.arm()
        await until(lambda: found.vehicle.armed, "it is armed")
        await until(lambda: not found.vehicle.armed, "it is disarmed again", 4.0)
        assert not found.relay.commands(SET_MODE), "a mode would outlast the stop"


async def test_a_vehicle_at_rest_is_not_flooded() -> None:
    async with flying() as found:
        await found.moving()
        assert (await found.estop())["status"] == "completed"
        del found.relay.sent[:]
        await asyncio.sleep(3.0)  # a window in which hardly anything may be sent
        assert len(found.relay.sent) <= 8


# What a stop is


async def test_a_stop_that_lands_lands_also_with_an_action_under_way() -> None:
    async with flying(estop="land") as found:
        id_ = await found.moving(12.0)
        stop = asyncio.ensure_future(found.estop(deadline=30.0))
        final = await found.client.final(id_)
        assert final["status"] in ("cancelled", "failed")
        await until(lambda: found.vehicle.flight.mode is Mode.LAND, "it lands")
        while not found.vehicle.body.landed:
            assert found.vehicle.flight.mode is Mode.LAND
            assert not stop.done(), "it is not at rest before it stands"
            await asyncio.sleep(0.02)
        reply = await stop
        assert reply["status"] == "completed", reply
        assert not found.vehicle.armed


async def test_the_hold_of_a_cancelled_action_never_follows_the_stop() -> None:
    async with flying(estop="land") as found:
        await found.moving(30.0)
        del found.relay.sent[:]
        await found.estop(deadline=1.0)
        modes = {m.param2 for m in found.relay.commands(SET_MODE)}
        assert modes == {LAND}


async def test_without_a_position_it_levels_and_then_lands() -> None:
    async with flying({"speed": 1.0}) as found:
        airborne(found.vehicle, 6.0)
        await agrees(found.served.life.backend, found.vehicle)
        found.vehicle.params.set("FS_EKF_ACTION", 0.0)  # no failsafe of its own
        found.vehicle.params.set("SIM_GPS1_ENABLE", 0.0)
        stop = asyncio.ensure_future(found.estop(deadline=40.0))
        await until(lambda: found.vehicle.flight.mode is Mode.ALT_HOLD, "it levels")
        refused = [m.param2 for m in found.relay.commands(SET_MODE)]
        assert refused[0] == BRAKE
        await until(lambda: found.vehicle.flight.mode is Mode.LAND, "it lands", 8.0)
        reply = await stop
        assert reply["status"] == "completed", reply
        assert found.vehicle.body.landed
        assert not found.vehicle.armed


async def test_a_forced_disarm_is_confirmed_by_the_heartbeat() -> None:
    async with flying(estop="disarm") as found:
        await found.moving(12.0)
        assert (await found.estop())["status"] == "completed"
        assert not found.vehicle.armed


async def test_a_reset_ends_a_landing_that_is_under_way() -> None:
    async with flying(estop="land") as found:
        await found.moving(60.0)
        await found.estop(deadline=0.5)
        await found.reset()
        reply = await found.client.request(
            "execute", "/tenant/t/action/set_mode", body={"mode": "GUIDED"}
        )
        assert reply["status"] == "completed", reply
        del found.relay.sent[:]
        await asyncio.sleep(1.0)  # a window in which nothing may be sent
        assert not found.relay.commands(SET_MODE)
        assert found.vehicle.flight.mode is Mode.GUIDED


async def test_a_failsafe_that_lands_it_under_the_latch_is_left_to() -> None:
    async with flying() as found:
        await found.moving(12.0)
        assert (await found.estop())["status"] == "completed"
        found.vehicle.failsafes.act("Battery", return_home=False)
        while not found.vehicle.body.landed:
            assert found.vehicle.flight.mode is Mode.LAND
            await asyncio.sleep(0.02)
        await until(lambda: not found.vehicle.armed, "it is disarmed on the ground")
        await found.confirmed()
        assert (await found.state())["alarm"]


class Stubborn(Puppet):
    """An ArduCopter in the air that refuses what a test says."""

    def __init__(self, *refused: int) -> None:
        super().__init__()
        self.mode, self.armed, self.landed = GUIDED, True, 2
        self.move(100.0, 0.0, 20.0)
        self.velocity = (3.0, 0.0, 0.0)
        self.refused = refused
        self.results = {SET_MODE: self._mode, 400: self._arm, 185: self._terminate}

    def _mode(self, command: Any) -> int:
        if int(command.param2) in self.refused:
            self.say("Mode change failed")
            return 4
        self.mode = int(command.param2)
        return 0

    def _arm(self, command: Any) -> int:
        return 4

    def _terminate(self, _: Any) -> int:
        self.armed = False
        return 0


async def test_what_is_refused_is_followed_by_the_next_step_in_the_configured_order() -> None:
    puppet = Stubborn(BRAKE, 5, 16, 2)
    async with station(puppet, estop_fallback=["land", "level"]) as found:
        await until(lambda: found.robot.vehicle.landed is False, "it is in the air")
        path = "/system/estop"
        reply = await found.client.request("execute", path, deadline=2.0)
        assert reply["status"] == "failed", reply
        assert puppet.mode == LAND
        told = list(dict.fromkeys(m.param2 for m in puppet.commands(SET_MODE)))
        assert told == [BRAKE, 5, 16, LAND], "ALT_HOLD comes after LAND here"
        state = await found.client.request("read", path)
        (robot,) = state["body"]["robots"].values()
        assert "BRAKE: refused (Mode change failed)" in robot["detail"]
        puppet.landed, puppet.velocity = 1, (0.0, 0.0, 0.0)

        async def confirmed() -> bool:
            state = await found.client.request("read", path)
            (robot,) = state["body"]["robots"].values()
            return robot["state"] == "confirmed"

        await eventually(confirmed, "it stands")


@pytest.mark.parametrize("terminate", [False, True])
async def test_the_flight_is_terminated_only_where_that_is_configured(terminate: bool) -> None:  # noqa: FBT001 - a parameter of the test
    puppet = Stubborn(BRAKE, 5, 16, 2, LAND)
    async with station(puppet, estop_terminate=terminate) as found:
        await until(lambda: found.robot.vehicle.landed is False, "it is in the air")
        reply = await found.client.request("execute", "/system/estop", deadline=4.0)
        assert bool(puppet.commands(185)) is terminate
        assert puppet.armed is not terminate
        assert reply["status"] == ("completed" if terminate else "failed"), reply


async def test_one_that_is_in_its_mode_and_still_moves_goes_on_to_land() -> None:
    puppet = Stubborn()
    async with station(puppet, estop_timeout=1.0) as found:
        await until(lambda: found.robot.vehicle.landed is False, "it is in the air")
        await found.client.request("execute", "/system/estop", deadline=3.0)
        await until(lambda: puppet.mode == LAND, "it lands")
        assert 2 not in [m.param2 for m in puppet.commands(SET_MODE)], "level would only drift"


# A hold without a latch


async def test_a_hold_brings_it_to_rest_and_latches_nothing() -> None:
    async with flying(estop="land") as found:
        id_ = await found.moving()
        reply = await found.client.request("execute", "/tenant/t/service/hold", within=20.0)
        assert reply["status"] == "completed", reply
        assert speed(found.vehicle) < AT_REST
        assert found.vehicle.flight.mode is Mode.BRAKE
        assert (await found.client.final(id_))["status"] == "cancelled"
        await found.moving()


# After a loss


@pytest.mark.parametrize(
    ("policy", "mode"),
    [("hold", Mode.BRAKE), ("continue", Mode.GUIDED), ("land", Mode.LAND), ("return", Mode.RTL)],
)
async def test_what_becomes_of_it_after_a_loss_is_its_policy(policy: str, mode: Mode) -> None:
    async with flying(on_loss=policy) as found:
        id_ = await found.moving()
        found.relay.cut = True
        final = await found.client.final(id_)
        assert final["error"]["details"]["on_loss"] == policy
        await until(lambda: found.robot.vehicle.lost, "it is lost")
        found.relay.cut = False
        await until(lambda: not found.robot.vehicle.lost, "it is heard again")
        if policy == "continue":
            await asyncio.sleep(1.0)
        await until(lambda: found.vehicle.flight.mode is mode, "it does what the policy says")


# Feedback


async def test_positions_that_stop_coming_end_a_flight_and_refuse_the_next() -> None:
    async with flying() as found:
        id_ = await found.moving()
        found.relay.down = lambda number: number != 33
        final = await found.client.final(id_)
        assert final["error"]["code"] == "device_timeout", final
        assert "no position" in final["message"]
        await until(lambda: speed(found.vehicle) < AT_REST, "it was told to hold")
        assert found.vehicle.flight.mode is Mode.BRAKE
        body = {"north": 0.0}
        again = await found.client.request("execute", "/tenant/t/action/move_to", body=body)
        assert again["error"]["code"] == "precondition_failed", again
        found.relay.down = lambda _: True
        await until(lambda: not found.robot.measurement.stale(), "positions come again")
        await found.moving()


async def test_a_velocity_is_not_sent_on_without_positions() -> None:
    async with flying() as found:
        airborne(found.vehicle, 40.0)
        await agrees(found.served.life.backend, found.vehicle)
        path = "/tenant/t/actuator/velocity"
        replies = []

        async def lead() -> None:
            while True:
                replies.append(await found.client.request("write", path, body={"x": 5.0}))
                await asyncio.sleep(0.2)

        leading = asyncio.ensure_future(lead())
        try:
            await until(lambda: speed(found.vehicle) > 3, "it is led")
            found.relay.down = lambda number: number != 33
            await until(lambda: speed(found.vehicle) < AT_REST, "it is stopped", 6.0)
            await until(lambda: replies[-1]["status"] != "completed", "the next one is refused")
            assert replies[-1]["error"]["code"] in ("precondition_failed", "mode_forbids")
        finally:
            leading.cancel()


async def test_a_vehicle_that_is_lost_does_not_keep_the_others_from_being_halted() -> None:
    async with (
        twin(speed=2.0) as first,
        twin(speed=2.0, system=2) as second,
        relay(second.ports[0]) as link,
    ):
        for running in (first, second):
            airborne(running.vehicle, 40.0)
            running.vehicle.flight.aim((3000.0, 0.0), -40.0)
        links = [f"udpout:127.0.0.1:{port}" for port in (first.ports[0][1], link.port)]
        table = {"links": links, "discover": True, "params": [], "silence": 1.5}
        async with serve_backend(KIND, table) as served:
            await until(lambda: served.lives and len(served.life.backend.robots) == 2, "both")
            backend: Any = served.life.backend
            link.cut = True
            await until(lambda: backend.robots["vehicle2"].vehicle.lost, "one is lost")
            with pytest.raises(AdapterUnavailable, match="vehicle 2") as told:
                await backend.halt()
            assert "vehicle 1" not in str(told.value)
            assert speed(first.vehicle) < AT_REST
            assert backend.motion("vehicle1").at_rest is True
            assert backend.motion("vehicle2").at_rest is None
            assert backend.motion(None).at_rest is None
            with pytest.raises(AdapterUnavailable):
                await backend.halt_robot("vehicle2")
            with pytest.raises(AdapterUnavailable):
                await backend.halt_robot("vehicle3")


async def test_a_cancel_that_does_not_reach_it_is_not_told_as_cancelled() -> None:
    async with flying() as found:
        id_ = await found.moving()
        found.relay.cut = True
        await found.client.request("cancel", "/tenant/t/action/move_to")
        final = await found.client.final(id_)
        assert final["status"] == "failed", final
        assert final["error"]["code"] in ("adapter_unavailable", "device_timeout")
        assert final["error"]["details"]["on_loss"] == "hold"
        await until(lambda: found.robot.vehicle.lost, "it is lost")
        found.relay.cut = False
        await until(lambda: speed(found.vehicle) < AT_REST, "it holds when it is heard again")


async def test_one_that_appears_after_the_start_gets_what_its_lost_command_left_behind() -> None:
    async with (
        twin(speed=2.0) as first,
        twin(speed=2.0, system=2) as second,
        relay(second.ports[0]) as link,
    ):
        airborne(second.vehicle, 40.0)
        second.vehicle.flight.aim((3000.0, 0.0), -40.0)
        link.cut = True
        links = [f"udpout:127.0.0.1:{port}" for port in (first.ports[0][1], link.port)]
        table = {"links": links, "discover": True, "params": [], "on_loss": "return"}
        async with serve_backend(KIND, table) as served:
            await until(lambda: bool(served.lives), "the first is heard")
            # As it is noted for a command that an earlier gateway has left behind.
            served.supervisor.unit("vehicle2").lost = "/tenant/t/action/vehicle2/move_to"
            link.cut = False
            await until(lambda: second.vehicle.flight.mode is Mode.RTL, "it returns")


async def test_a_return_that_is_refused_is_a_hold() -> None:
    async with flying(on_loss="return") as found:
        id_ = await found.moving()
        found.relay.cut = True
        await found.client.final(id_)
        await until(lambda: found.robot.vehicle.lost, "it is lost")
        found.vehicle.params.set("FS_EKF_ACTION", 0.0)
        found.vehicle.params.set("SIM_GPS1_ENABLE", 0.0)
        found.relay.cut = False
        await until(lambda: found.vehicle.flight.mode is Mode.ALT_HOLD, "it levels")


# The guard process


async def test_what_the_guard_sends_stops_it_without_the_gateway() -> None:
    async with flying() as found, commander(found.twin.ports[0]) as guard:
        await found.moving()
        plans = found.served.life.host.plans
        await until(lambda: plans, "a plan is given once it is armed")
        (plan,) = plans.values()
        assert plan.sender == "udp"
        assert plan.data["to"] == ["127.0.0.1", found.relay.port]
        found.relay.cut = True
        frames = [bytes.fromhex(frame) for frame in plan.data["frames"]]
        began = time.monotonic()
        while speed(found.vehicle) > AT_REST and time.monotonic() - began < 10:
            for frame in frames:
                guard.write(frame)
            await asyncio.sleep(plan.period)
        assert found.vehicle.flight.mode is Mode.BRAKE
        assert len({frame[7:10] for frame in frames}) == 2, "a command, and SET_MODE"


async def test_the_guard_has_no_plan_for_what_stands_disarmed_and_keeps_a_landing_up() -> None:
    async with flying(estop="land") as found:
        on_the_ground(found.vehicle)
        await agrees(found.served.life.backend, found.vehicle)
        plans = found.served.life.host.plans
        await until(lambda: not plans, "there is nothing to guard")
        await found.moving(30.0)
        await until(lambda: plans, "there is")
        holding = next(iter(plans.values())).data["frames"]
        await found.estop(deadline=0.5)
        await until(
            lambda: plans and next(iter(plans.values())).data["frames"] != holding,
            "the landing is what it keeps up",
        )


async def test_a_signed_link_has_no_plan_and_says_so() -> None:
    key = "a passphrase"
    async with twin(key=key_of(key)) as running:
        airborne(running.vehicle)
        link = f"udpout:127.0.0.1:{running.ports[0][1]}"
        async with serve_backend(KIND, {"links": [link], "key": key, "params": []}) as served:
            await until(lambda: bool(served.lives), "it is heard")
            await agrees(served.life.backend, running.vehicle)
            assert not served.life.host.plans
            (guard,) = [w for w in served.life.backend.watchdogs() if "guard" in w.mechanism]
            assert guard.within is None
            assert "signed" in guard.mechanism


# The vehicle's own watchdogs


async def watchdogs(found: Stopped) -> list[Any]:
    await until(found.robot.parameters.complete.is_set, "the parameters are listed")
    await until(found.robot.watchdogs.verified.is_set, "they are looked at")
    return [w for w in found.served.life.backend.watchdogs() if "guard" not in w.mechanism]


async def test_a_failsafe_that_is_off_is_told_and_left_alone() -> None:
    async with flying() as found:
        station, guided = await watchdogs(found)
        assert (station.within, station.verified) == (None, True)
        assert "FS_GCS_ENABLE=0" in station.mechanism
        assert (guided.within, guided.verified) == (3.0, True)
        assert found.vehicle.params["FS_GCS_ENABLE"] == 0


async def test_a_failsafe_is_set_where_that_is_asked_for_and_read_back() -> None:
    async with flying(watchdog="set") as found:
        station, _ = await watchdogs(found)
        assert found.vehicle.params["FS_GCS_ENABLE"] == 5
        assert (station.within, station.verified) == (6.0, True)


async def test_a_failsafe_that_somebody_chose_is_not_changed() -> None:
    async with flying({"parameters": {"FS_GCS_ENABLE": 1.0}}, watchdog="set") as found:
        station, _ = await watchdogs(found)
        assert found.vehicle.params["FS_GCS_ENABLE"] == 1
        assert station.within == 6.0


async def test_a_failsafe_that_heeds_another_station_is_none() -> None:
    parameters = {"FS_GCS_ENABLE": 5.0, "MAV_GCS_SYSID": 250.0}
    async with flying({"parameters": parameters}) as found:
        station, _ = await watchdogs(found)
        assert station.within is None
        assert "MAV_GCS_SYSID=250" in station.mechanism


@pytest.mark.parametrize(("kind", "mode"), [("tcp", LAND), ("udp", BRAKE)])
def test_a_gateway_whose_loop_stands_still_is_replaced_by_the_failsafe_or_the_guard(
    kind: str, mode: int
) -> None:
    """Over TCP there is no guard: no heartbeats come, and the failsafe lands it."""
    options = ("--warmup", "0", "--param", "FS_GCS_ENABLE=5", "--param", "FS_GCS_TIMEOUT=2")
    with twin_process("udpin:127.0.0.1:0", "tcpin:127.0.0.1:0", options=options) as process:
        links = {
            "udp": f"udpout:127.0.0.1:{process.ports['udpin']}",
            "tcp": f"tcp:127.0.0.1:{process.ports['tcpin']}",
        }
        own = links.pop(kind)
        (others,) = links.values()
        asyncio.run(_frozen_loop(own, others, mode))


async def _frozen_loop(link: str, others: str, mode: int) -> None:
    options = {"links": [link], "params": []}
    async with serve_backend(KIND, options, guard_after=0.6) as served:
        await until(lambda: bool(served.lives), "it is heard", 20.0)
        client = served.client(OPERATOR)

        async def ready() -> bool:
            reply = await client.request(
                "execute", "/tenant/t/action/set_mode", body={"mode": "GUIDED"}
            )
            arm = await client.request("execute", "/tenant/t/action/arm")
            return reply["status"] == arm["status"] == "completed"

        await eventually(ready, "it is armed", 20.0)
        rise = {"altitude": 8.0}
        reply = await client.request("execute", "/tenant/t/action/takeoff", body=rise, within=30.0)
        assert reply["status"] == "completed", reply
        other: Any = mavutil.mavlink_connection(others, source_system=254)
        other.mav.heartbeat_send(6, 8, 0, 0, 4)  # over UDP it has to call
        modes: list[int] = []

        def look() -> None:
            """See the mode while the loop of the gateway stands still: this runs in its thread."""
            end = time.monotonic() + 6
            while time.monotonic() < end and modes[-1:] != [mode]:
                beat = other.recv_match(type="HEARTBEAT", blocking=True, timeout=1)
                if beat is not None:
                    modes.append(beat.custom_mode)

        look()  # blocks the loop on purpose
        other.close()
        assert modes[0] == GUIDED
        assert modes[-1] == mode, modes


# Telemetry that comes late


class Delayed(Stubborn):
    """It hovers in the mode of the stop, is moved in it, and brakes a while after each stop."""

    def __init__(self) -> None:
        super().__init__()
        self.mode, self.delay = BRAKE, 0.0
        self.velocity = (0.0, 0.0, 0.0)
        self.stopped_at: float | None = None
        self._kept: list[tuple[float, bytes]] = []

    def write(self, frame: bytes) -> None:
        if int.from_bytes(frame[7:10], "little") != GLOBAL_POSITION_INT:
            super().write(frame)
            return
        now = time.monotonic()
        self._kept.append((now + self.delay, bytes(frame)))
        while self._kept and self._kept[0][0] <= now:
            super().write(self._kept.pop(0)[1])

    def tick(self) -> None:
        if any(self.velocity) and self.commands(SET_MODE):
            now = time.monotonic()
            self.stopped_at = self.stopped_at or now + 0.5
            if now >= self.stopped_at:
                self.velocity = (0.0, 0.0, 0.0)
        super().tick()


async def test_rest_from_before_a_stop_does_not_confirm_it_however_late_it_is_told() -> None:
    puppet = Delayed()
    async with station(puppet, silence=10.0, feedback_timeout=5.0) as found:
        measurement = found.robot.measurement
        await until(lambda: measurement.still_for > 1.5, "it has been still for long")
        puppet.delay = 0.8
        await until(lambda: measurement.position_age > 0.5, "nothing comes")
        await until(lambda: measurement.position_age < 0.3, "telemetry comes late")
        began = time.monotonic()
        puppet.velocity = (3.0, 0.0, 0.0)
        await found.served.life.backend.halt()
        took = time.monotonic() - began
        assert not any(puppet.velocity), f"the stop was confirmed after {took:.2f} s"
