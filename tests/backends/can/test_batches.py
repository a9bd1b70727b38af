"""Frames that come in one batch after the gateway was held up: what is over by its end has happened."""

from __future__ import annotations

import asyncio
import time
from types import SimpleNamespace
from typing import Any

import can
import pytest

from backends.can.rig import Motor, motor
from rcp_can.profiles.odrive import OdriveDrive, OdriveOptions
from rcp_can.profiles.odrive_messages import MESSAGES


def frame(name: str, **values: float) -> can.Message:
    """Return a message of the ODrive with id 1."""
    command, layout = MESSAGES[name]
    return can.Message(
        arbitration_id=1 << 5 | command, data=layout.encode(**values), is_extended_id=False
    )


async def hush(rig: Motor) -> Any:
    """Let the drive send no more of these messages; return what takes a batch in its place."""

    def quiet() -> None:
        rig.twin.blind = rig.twin.heartless = True

    await rig.ordered(quiet)
    wire = rig.backend.buses["can0"].wire
    read = wire.rx
    await rig.until(lambda: wire.rx > read + 2)  # what it had sent before is read
    await asyncio.sleep(0)
    return wire._received  # noqa: SLF001 - what its reader hands batches to


async def test_a_drive_that_was_off_for_a_moment_is_not_driven_on() -> None:
    async with motor("odrive", timeout=9.0, feedback_timeout=9.0) as rig:
        await rig.enable()
        await rig.write("actuator/m/velocity", 1.0)
        take = await hush(rig)
        take([frame("heartbeat", state=state) for state in (8, 1, 8)])
        assert rig.axis.mode is None
        assert [e.fault for e in rig.host.events("event/m/fault")] == ["switched_off"]


async def test_a_motor_that_moved_within_a_batch_does_not_count_as_at_rest() -> None:
    async with motor("odrive", timeout=9.0, feedback_timeout=9.0) as rig:
        await rig.enable()
        take = await hush(rig)
        began = time.monotonic()
        for velocities in ((0.0,), (0.0,), (3.0, 0.0)):
            take([frame("encoder", velocity=each) for each in velocities])
        assert not rig.axis.rests_since(began)
        for _ in range(2):
            take([frame("encoder")])
        assert rig.axis.rests_since(began)


async def test_a_drive_that_reboots_while_it_is_configured_is_configured_again() -> None:
    async with motor("odrive") as rig:
        drive, axis = rig.axis.drive, rig.axis
        real, runs = drive.configure, list[int]()

        async def configure() -> None:
            runs.append(drive.status.resets)
            await real()
            if len(runs) == 1:
                await rig.ordered(rig.twin.boot)
                await rig.until(lambda: drive.status.resets > runs[0])

        drive.configure = configure
        await rig.ordered(rig.twin.boot)
        await rig.until(lambda: len(runs) > 1 and axis.configured)
        assert runs[1] > runs[0]


async def test_time_in_which_the_gateway_is_held_up_is_not_that_of_the_drive(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    loop, ahead = asyncio.get_running_loop(), [0.0]
    real = loop.time
    monkeypatch.setattr(loop, "time", lambda: real() + ahead[0])
    bus: Any = SimpleNamespace(send=lambda *_, **__: None, lag=0.0)
    drive, requests, answers = OdriveDrive(1, OdriveOptions(), bus), [0], list[bool]()

    def request() -> None:
        requests[0] += 1
        if requests[0] == 1:
            loop.call_soon(ahead.__setitem__, 0, 5.0)  # as if nothing had run for so long
        else:
            answers.append(True)

    await drive.until(lambda: bool(answers), "answering", again=request)
    assert requests == [2]
