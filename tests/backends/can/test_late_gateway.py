"""A gateway that was late does not blame the bus or the drive, nor go on with what it cannot see."""

from __future__ import annotations

import asyncio
import threading
import time
from typing import Any

import pytest

from backends.can.rig import Motor, motor
from rcp_can.preconditions import STALLED
from rcp_can.send_delay import SendDelay
from rcp_kernel.errors import AdapterUnavailable

PERIOD = 0.02
LATE = 0.1


def test_a_bus_that_takes_no_frames_is_noticed_by_the_clock() -> None:
    delay = SendDelay()
    for tick in range(1, 20):
        delay.advance(PERIOD, tick * PERIOD)
        assert delay.seconds == pytest.approx(tick * PERIOD)
    delay.advance(PERIOD, 0.0)
    assert delay.seconds == 0.0


@pytest.mark.parametrize("stood", [0.3, 3.0])
def test_the_time_in_which_the_gateway_stood_still_is_no_delay_of_the_bus(stood: float) -> None:
    delay = SendDelay()
    delay.advance(LATE, PERIOD + stood)  # its frames waited as long as it did
    assert delay.seconds < STALLED
    for tick in range(1, 7):  # and its sending thread may run a little later than its loop
        delay.advance(PERIOD, PERIOD + stood + tick * PERIOD)
        assert delay.seconds < STALLED
    delay.advance(PERIOD, PERIOD)
    assert delay.seconds <= PERIOD


def test_a_gateway_that_is_always_late_notices_it_too() -> None:
    delay = SendDelay()
    for tick in range(1, 4):
        delay.advance(LATE, tick * 0.4)
    assert delay.seconds > STALLED


async def test_a_frame_that_waited_while_the_gateway_stood_still_ends_no_motion() -> None:
    async with motor("odrive", valid_for=60.0) as rig:
        await rig.enable()
        await rig.write("actuator/m/velocity", 2.0)
        await rig.until(lambda: rig.twin.plant.velocity > 1.5)
        wire = rig.backend.buses["can0"].wire
        with rig.jammed():
            await rig.until(lambda: wire.lag > 0.0)
            ticks = rig.axis._tick  # noqa: SLF001  # nothing else tells that it has run
            time.sleep(STALLED + 0.05)  # noqa: ASYNC251  # the gateway is what stands still
            await rig.until(lambda: rig.axis._tick > ticks)  # noqa: SLF001
        taken = len(rig.twin.commands)
        await rig.until(lambda: len(rig.twin.commands) > taken + 5 or taken == 100)
        assert rig.faults() == []
        assert rig.axis.mode == "velocity"
        await rig.backend.halt()


async def test_set_points_that_the_gateway_does_not_send_stop_the_motor_and_name_the_gateway(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async with motor("odrive", valid_for=60.0, timeout=5.0, feedback_timeout=5.0) as rig:
        await rig.enable()
        await rig.write("actuator/m/velocity", 2.0)
        await rig.until(lambda: rig.twin.plant.velocity > 1.5)
        wire: Any = rig.backend.buses["can0"].wire
        with monkeypatch.context() as held:
            woken = wire._wake  # noqa: SLF001  # its sending thread sleeps on
            held.setattr(wire, "_wake", threading.Event())
            await rig.host.until(lambda: "gateway_stalled" in rig.faults())
            with pytest.raises(AdapterUnavailable, match="the gateway is too slow"):
                await rig.write("actuator/m/velocity", 1.0)
        woken.set()
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        assert "not_sent" not in rig.faults()
        (fault,) = (e for e in rig.host.events("event/m/fault") if e.fault == "gateway_stalled")
        assert "the gateway was too slow" in fault.text


async def test_a_motor_with_a_slow_rate_notices_that_its_drive_is_silent() -> None:
    async with motor("odrive", rate=2.5, valid_for=60.0, watchdog=False) as rig:
        await turning(rig)
        rig.twin.silent = True
        await rig.host.published_as("sensor/m/state", state="offline")
        rig.twin.silent = False
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)


@pytest.mark.parametrize("blocked", [0.15, 0.3])
async def test_a_gateway_that_is_always_late_notices_that_a_drive_is_silent(blocked: float) -> None:
    async with motor("odrive", valid_for=60.0) as rig:
        await turning(rig)
        rig.twin.silent = True
        for _ in range(40):
            time.sleep(blocked)  # noqa: ASYNC251  # as a plugin does that blocks all the time
            await asyncio.sleep(0)
            if not rig.axis.online:
                break
        assert not rig.axis.online
        rig.twin.silent = False
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)


async def turning(rig: Motor) -> None:
    await rig.enable()
    await rig.write("actuator/m/velocity", 2.0)
    await rig.until(lambda: rig.twin.plant.velocity > 1.0)
