"""What `vcan_by_hand.sh` runs inside its Linux: motors, frames, error frames and recordings on SocketCAN."""

from __future__ import annotations

import asyncio
import sys
import traceback
from collections.abc import Awaitable, Callable

import anyio
import can

from backends.can.rig import MOTORS, Rig, opened
from rcp_can import axis
from rcp_can.sim import Bench, make_twin

PATIENCE = {"timeout": 10.0, "feedback_timeout": 10.0, "watchdog": 10.0, "valid_for": 30.0}
"""Of a motor and its gateway: this Linux runs only when the machine has time for it, and stands still meanwhile."""
BUS = {"interface": "socketcan", "channel": "vcan0", "restart": 0.1, "statistics": 0.2}


async def motors(profile: str) -> None:
    """Enable, move, halt."""
    fd = profile == "moteus"
    table = {"bus": "can0", "profile": profile, "velocity": 4.0, **PATIENCE, **MOTORS[profile]}
    line = can.Bus("vcan0", "socketcan", fd=fd, ignore_config=True)
    twin = make_twin(profile, table["node"], **table.get("options", {}))
    config = {"buses": {"can0": {**BUS, "fd": fd}}, "motors": {"m": table}, "grace": 20.0}
    with Bench(line, [twin]):
        async with opened(config) as rig:
            assert rig.host.reports == [], rig.host.reports
            await rig.ran("service/m/enable", seconds=30)
            if profile != "vesc":
                moved = await rig.ran("action/m/move_to", {"position": 0.5}, seconds=30)
                assert abs(moved["position"] - 0.5) < 0.05
            await rig.write("actuator/m/velocity", 1.0)
            with anyio.fail_after(60):
                while twin.plant.velocity < 0.9:  # noqa: ASYNC110  # a twin lives in a thread that tells nobody
                    await asyncio.sleep(0.01)
            with anyio.fail_after(60):
                await rig.backend.halt()
            assert abs(twin.plant.velocity) < 0.1, twin.plant.velocity


async def frames() -> None:
    """Every frame arrives once, and its own are not heard back."""
    async with opened({"buses": {"can0": {**BUS, "raw_send": True}}}) as rig:
        with can.Bus("vcan0", "socketcan", ignore_config=True) as other:
            async with rig.backend.watch("event/can/can0/frame", None):
                for number in range(200):
                    other.send(can.Message(arbitration_id=number, is_extended_id=False))
                await _shown(rig, 199)
                seen = [frame.id for frame in rig.host.events("event/can/can0/frame")]
                assert seen == list(range(200)), seen
            await rig.write("actuator/can/can0/frame", {"id": 0x123, "data": "AQI="})
            heard = await asyncio.to_thread(other.recv, 5)
            assert heard is not None
            assert (heard.arbitration_id, bytes(heard.data)) == (0x123, b"\1\2")
        await rig.host.published_as("sensor/can/can0/statistics", malformed=0, rx=200, tx=1)


async def _shown(rig: Rig, last: int) -> None:
    await rig.host.published_as("event/can/can0/frame", seconds=20, id=last)


async def bus_off() -> None:
    """An error frame of the kernel takes the bus off, and it comes back."""
    async with opened({"buses": {"can0": BUS}}) as rig:
        with can.Bus("vcan0", "socketcan", ignore_config=True) as other:
            off = can.Message(arbitration_id=0x40, is_error_frame=True, is_extended_id=False, dlc=8)
            off.data = bytearray(8)
            other.send(off)
            await rig.host.until(lambda: len(rig.host.events("event/can/can0/state")) >= 3, 20)
        events = [event.now for event in rig.host.events("event/can/can0/state")]
        assert events == ["error_active", "bus_off", "error_active"], events


async def main() -> int:
    """Run all; tell of each."""
    axis._FROZEN = 60.0  # noqa: SLF001  # no option lets a gateway that stood still go on
    checks: dict[str, Callable[[], Awaitable[None]]] = {"frames": frames, "bus-off": bus_off}
    checks |= {f"motor {name}": lambda name=name: motors(name) for name in MOTORS}
    failed = 0
    for name, check in checks.items():
        try:
            await check()
        except Exception as error:  # the next is tried whatever becomes of this
            failed += 1
            sys.stdout.write(f"FAILED {name}: {type(error).__name__}: {error}\n")
            traceback.print_exc(file=sys.stdout)
        else:
            sys.stdout.write(f"ok     {name}\n")
        sys.stdout.flush()
    return failed


if __name__ == "__main__":
    sys.exit(asyncio.run(main()))
