"""A stop holds: at rest by measurement, on every link that comes and goes."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import pytest

from backends.mavlink.flying import agrees, airborne, speed, twin
from backends.mavlink.puppet import station
from backends.mavlink.relay import COMMAND_ACK, HEARTBEAT, SET_MODE, commander, relay
from backends.mavlink.stopping import AT_REST, BRAKE, KIND, Stubborn, flying, until
from rcp_gateway.testing import eventually
from rcp_gateway.testing._serve import OPERATOR, serve_backend
from rcp_kernel.errors import AdapterUnavailable
from rcp_mavlink_sim.modes import Mode

GLOBAL_POSITION_INT = 33


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
