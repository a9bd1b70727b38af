"""What waits to be sent while the bus takes no frames: nothing of it follows a stop."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import can
import pytest

from backends.can.rig import Motor, Node, motor
from rcp_kernel.errors import RcpError

DBC = """VERSION ""
BU_: GW
BO_ 513 Lift: 2 GW
 SG_ speed : 0|16@1- (1,0) [-1000|1000] "" GW
BO_ 514 Lamp: 1 GW
 SG_ on : 0|8@1+ (1,0) [0|1] "" GW
"""


@asynccontextmanager
async def stopped_in_a_jam(
    rig: Motor, begin: Callable[[], Any]
) -> AsyncGenerator[list[can.Message]]:
    """Begin something while the bus takes no frames, stop, and let it take them; yield them."""
    bus = rig.backend.buses["can0"]
    wire = bus.wire
    with Node(rig.channel) as node:
        with rig.jammed():
            bus.send(0x7FF)  # the one that the interface has, and nothing takes back
            await rig.until(lambda: wire.lag > 0.02)
            running = asyncio.ensure_future(begin())
            await rig.until(lambda: wire.waiting > 4)
            stopping = asyncio.ensure_future(rig.backend.halt())
            running.cancel()  # as the kernel does
            await asyncio.sleep(0.05)
        await rig.until(lambda: wire.waiting == 0)
        with suppress(RcpError):
            await stopping
        await asyncio.gather(running, return_exceptions=True)
        sent = list[can.Message]()
        while (message := node.bus.recv(0.0)) is not None:
            sent.append(message)
    yield sent


async def test_a_move_that_waits_does_not_follow_a_stop() -> None:
    async with motor("odrive", timeout=3.0, feedback_timeout=3.0) as rig:
        await rig.enable()
        begin = lambda: rig.execute("action/m/move_to", {"position": 9.0})  # noqa: E731
        async with stopped_in_a_jam(rig, begin) as sent:
            commands = [m.arbitration_id & 0x1F for m in sent if not m.is_remote_frame]
            assert 0x0C not in commands, "the target of the move"
            assert abs(rig.twin.plant.position) < 0.1


@pytest.mark.parametrize("profile", ["odrive", "mit", "cybergear"])
async def test_an_enable_that_waits_does_not_follow_a_stop(profile: str) -> None:
    async with motor(profile, timeout=3.0, feedback_timeout=3.0) as rig:
        begin = lambda: rig.execute("service/m/enable")  # noqa: E731
        async with stopped_in_a_jam(rig, begin) as sent:
            await asyncio.sleep(0.05)
            assert not rig.twin.enabled, [m.data.hex() for m in sent]


async def test_what_a_device_was_to_do_is_not_done_long_after(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "lift.dbc"
    path.write_text(DBC)
    device = {"bus": "can0", "dbc": str(path), "write": ["Lamp"]}
    monkeypatch.setattr("rcp_can.device.KEPT", 0.02)
    async with motor("odrive", config={"devices": {"lift": device}}) as rig:

        async def begin() -> None:
            for on in (0, 1, 0, 1, 0, 1):
                await rig.write("actuator/lift/Lamp", {"on": on})
            await asyncio.Event().wait()  # until it is cancelled

        async with stopped_in_a_jam(rig, begin) as sent:
            assert 514 not in [m.arbitration_id for m in sent]


async def test_what_a_device_was_to_do_does_not_follow_its_safe_value(tmp_path: Path) -> None:
    path = tmp_path / "lift.dbc"
    path.write_text(DBC)
    device = {
        "bus": "can0",
        "dbc": str(path),
        "write": ["Lift", "Lamp"],
        "safe": {"Lift": {"speed": 0}},
    }
    async with motor("odrive", config={"devices": {"lift": device}}) as rig:

        async def begin() -> None:
            for speed in (100, 200, 300, 400):
                await rig.write("actuator/lift/Lift", {"speed": speed})
            await rig.write("actuator/lift/Lamp", {"on": 1})
            await asyncio.Event().wait()  # until it is cancelled

        async with stopped_in_a_jam(rig, begin) as sent:
            lift = [bytes(m.data).hex() for m in sent if m.arbitration_id == 513]
            assert lift == ["0000"]
            assert [m.arbitration_id for m in sent].count(514) == 1, "nothing makes it wrong"
