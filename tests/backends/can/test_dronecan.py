"""DroneCAN speed controllers are motors, of nodes of the library `dronecan`."""

from __future__ import annotations

import itertools
from contextlib import ExitStack

import msgspec
import pytest

from backends.can.dronecan_rig import (
    ARMING,
    FAST,
    RPM,
    Ear,
    esc,
    field,
    from_gateway,
    turns,
)
from backends.can.rig import Motor, Node, motor
from rcp_can.dronecan.node_status import OPERATIONAL
from rcp_can.sim.dronecan import DronecanTwin
from rcp_kernel.errors import (
    AdapterUnavailable,
    DeviceRejected,
    DeviceTimeout,
    ModeForbids,
)

MAINTENANCE = 2

# Motors


async def test_a_controller_is_enabled_turns_and_tells_what_it_measures() -> None:
    async with motor("dronecan", velocity=100.0, commissioning=True) as rig:
        with pytest.raises(ModeForbids):
            await rig.write("actuator/m/velocity", FAST)
        await rig.enable()
        await rig.write("actuator/m/velocity", FAST)
        await rig.until(turns(rig.twin, FAST))
        await rig.until(lambda: abs(rig.axis.velocity - FAST) < 1)
        assert rig.axis.status.voltage == 24.0
        assert rig.axis.status.drive_temperature == pytest.approx(25, abs=2)
        await rig.ran("service/m/disable")
        await rig.until(lambda: rig.axis.resting)
        assert rig.host.last("sensor/m/state").state == "disabled"
        assert await rig.backend.read("param/m/model") == "org.example.twin"
        assert await rig.backend.read("param/m/firmware") == "1.4 (00c0ffee)"


async def test_a_one_way_controller_is_offered_no_way_back() -> None:
    async with motor("dronecan", velocity=50.0, direction=-1) as rig:
        schema = msgspec.json.schema(rig.host.resources["actuator/m/velocity"].value)
        assert (schema["minimum"], schema["maximum"]) == (-50.0, 0.0)
        await rig.enable()
        await rig.write("actuator/m/velocity", -20.0)
        await rig.until(turns(rig.twin, 20.0))


async def test_controllers_of_a_bus_get_one_message_and_stop_each_by_itself() -> None:
    front, rear = DronecanTwin(20, index=0), DronecanTwin(21, index=2)
    tables = {"motors": {"front": esc(20, 0), "rear": esc(21, 2)}}
    async with field(front, rear, **tables) as rig:
        for name in ("front", "rear"):
            await rig.ran(f"service/{name}/enable")
            await rig.write(f"actuator/{name}/velocity", FAST)
        await rig.until(lambda: turns(front, FAST)() and turns(rear, FAST)())
        with Ear(rig.channel) as ear:
            both = await ear.hears(from_gateway(RPM))
            assert list(both.payload.rpm) == [382, 0, 382]  # nothing for the one that is not ours
            await rig.ran("service/front/disable")
            await rig.until(lambda: rig.backend.axes["front"].resting)
            after = await ear.hears(from_gateway(RPM))
            assert list(after.payload.rpm) == [0, 0, 382]
        assert turns(rear, FAST)()
        await rig.backend.halt()
        assert (front.plant.velocity, rear.plant.velocity) == (0.0, 0.0)


async def test_no_set_point_of_a_neighbour_follows_the_stop_of_both() -> None:
    front, rear = DronecanTwin(20, index=0), DronecanTwin(21, index=1)
    tables = {"motors": {"front": esc(20, 0), "rear": esc(21, 1)}}
    async with field(front, rear, **tables) as rig:
        for name in ("front", "rear"):
            await rig.ran(f"service/{name}/enable")
            await rig.write(f"actuator/{name}/velocity", FAST)
        await rig.until(lambda: turns(front, FAST)() and turns(rear, FAST)())
        with ExitStack() as stack:
            with Motor.jammed(rig):  # type: ignore[arg-type]
                ear = stack.enter_context(Ear(rig.channel))
                for axis in rig.backend.axes.values():
                    axis.stop()  # the first has what is in force for the second
            heard = [await ear.hears(from_gateway(RPM)) for _ in range(6)]
        speeds = [list(got.payload.rpm) for got in heard]
        assert speeds[1:] == [[0, 0]] * 5  # after the one that was on its way
        await rig.backend.halt()
        assert (front.plant.velocity, rear.plant.velocity) == (0.0, 0.0)


async def test_a_throttle_for_the_tenth_controller_takes_several_frames() -> None:
    options = {"control": "raw", "full_speed": 400.0}
    twin = DronecanTwin(20, index=9, **options)
    async with field(twin, motors={"m": esc(20, 9, options=options)}) as rig:
        await rig.ran("service/m/enable")
        await rig.write("actuator/m/velocity", FAST)
        await rig.until(turns(twin, FAST))
        await rig.backend.halt()  # several urgent frames stay in their order
        assert twin.plant.velocity == 0.0


async def test_a_stop_disarms_and_a_new_command_arms_again() -> None:
    async with motor("dronecan", velocity=100.0) as rig:
        with Ear(rig.channel) as ear:
            await rig.enable()
            await ear.hears(lambda got: got.type_id == ARMING and got.payload.status == 255)
            await rig.write("actuator/m/velocity", FAST)
            await rig.until(turns(rig.twin, FAST))
            await rig.backend.halt()
            await ear.hears(lambda got: got.type_id == ARMING and got.payload.status == 0)
            assert rig.twin.plant.velocity == 0.0
            await rig.enable()
            await rig.write("actuator/m/velocity", FAST)
            await rig.until(turns(rig.twin, FAST))


async def test_a_stop_of_a_controller_that_tells_nothing_is_not_confirmed() -> None:
    async with motor("dronecan", velocity=100.0) as rig:
        await rig.enable()
        await rig.write("actuator/m/velocity", FAST)
        await rig.until(turns(rig.twin, FAST))
        await rig.ordered(lambda: setattr(rig.twin, "blind", True))
        with pytest.raises(DeviceTimeout):
            await rig.backend.halt()
        await rig.until(lambda: rig.twin.plant.velocity == 0.0)  # it was stopped all the same
        await rig.ordered(lambda: setattr(rig.twin, "silent", True))
        await rig.until(lambda: not rig.axis.online)
        with pytest.raises(AdapterUnavailable):
            await rig.backend.halt()


async def test_a_controller_stops_by_itself_when_no_commands_arrive() -> None:
    async with motor("dronecan", velocity=100.0) as rig:
        (watchdog,) = rig.backend.watchdogs()
        assert (watchdog.within, watchdog.verified) == (0.5, False)
        await rig.enable()
        await rig.write("actuator/m/velocity", FAST)
        await rig.until(turns(rig.twin, FAST))
        await rig.ordered(lambda: setattr(rig.twin, "deaf", True))
        await rig.until(lambda: rig.twin.plant.velocity == 0.0)


async def test_a_controller_that_restarts_does_not_turn_again_by_itself() -> None:
    twin = DronecanTwin(20, index=0)
    twin.age(100)
    async with field(twin, motors={"m": esc(20, 0)}) as rig:
        axis = rig.backend.axes["m"]
        await rig.ran("service/m/enable")
        await rig.write("actuator/m/velocity", FAST)
        await rig.until(turns(twin, FAST))
        await rig.until(lambda: axis.drive.beats)  # its first report
        rig.bench.order(twin.boot)
        await rig.until(lambda: not axis.status.enabled and twin.plant.velocity == 0.0)
        await rig.until(lambda: axis.status.resets == 1 and axis.resting)
        faults = {event.fault for event in rig.host.events("event/m/fault")}
        assert faults & {"reset", "feedback_lost"}  # whichever is noticed first
        twin.commands.clear()
        await rig.until(lambda: len(twin.commands) > 3 or axis.mode is None)
        assert [value for _, value in twin.commands if value] == []
        with pytest.raises(ModeForbids):
            await rig.write("actuator/m/velocity", FAST)


async def test_a_controller_that_was_in_maintenance_does_not_turn_again_without_an_enable() -> None:
    twin = DronecanTwin(20, index=0)
    async with field(twin, motors={"m": esc(20, 0)}) as rig:
        axis = rig.backend.axes["m"]
        await rig.ran("service/m/enable")
        await rig.write("actuator/m/velocity", FAST)
        await rig.until(turns(twin, FAST))
        twin.node_mode = MAINTENANCE
        await rig.until(lambda: axis.status.enabled is False and twin.plant.velocity == 0.0)
        twin.node_mode = OPERATIONAL
        reports = axis.status.reports
        await rig.until(lambda: axis.status.reports > reports + 60)  # its state among them
        assert axis.status.enabled is False
        with pytest.raises(ModeForbids):
            await rig.write("actuator/m/velocity", FAST)


async def test_a_stop_comes_with_a_number_that_no_receiver_takes_for_a_late_part() -> None:
    async with field(DronecanTwin(20, index=0), motors={"m": esc(20, 0)}) as rig:
        await rig.ran("service/m/enable")
        await rig.write("actuator/m/velocity", FAST)
        with Ear(rig.channel) as ear:
            before = (await ear.hears(from_gateway(RPM))).transfer_id
            rig.backend.axes["m"].drive.stop()
            stop = await ear.hears(lambda got: from_gateway(RPM)(got) and not any(got.payload.rpm))
            assert (stop.transfer_id - before) % 32 >= 2


async def test_a_bus_that_loses_frames_is_driven_and_stopped() -> None:
    async with motor("dronecan", velocity=100.0) as rig:
        numbers = itertools.count()
        rig.bench.loses = lambda: next(numbers) % 7 == 0  # transfers of three frames suffer most
        await rig.enable()
        await rig.write("actuator/m/velocity", FAST)
        await rig.until(turns(rig.twin, FAST))
        await rig.backend.halt()
        assert rig.twin.plant.velocity == 0.0
        assert rig.backend.buses["can0"].malformed > 0


async def test_an_error_of_its_node_is_a_fault_that_only_a_restart_clears() -> None:
    async with motor("dronecan") as rig:
        await rig.ordered(rig.twin.break_down)
        await rig.until(lambda: "node_error" in rig.faults())
        with pytest.raises(DeviceRejected, match="no message that clears"):
            await rig.ran("service/m/clear_faults")
        await rig.ordered(rig.twin.boot)
        await rig.until(lambda: "node_error" in rig.faults(active=False))


async def test_frames_of_the_guard_stop_a_controller() -> None:
    async with motor("dronecan", velocity=100.0) as rig:
        frames = rig.axis.drive.stop_frames()
        numbers = {frame.data[-1] & 31 for frame in frames}
        assert len(numbers) == 4  # a receiver drops a transfer with the number of the one before
        await rig.enable()
        await rig.write("actuator/m/velocity", FAST)
        await rig.until(turns(rig.twin, FAST))
        rig.axis.mode = None  # the gateway is gone
        with Node(rig.channel) as guard:
            for frame in frames:
                guard.send(frame.identifier, frame.data)
            await rig.until(lambda: rig.twin.commands[-1] == ("velocity", 0.0))
