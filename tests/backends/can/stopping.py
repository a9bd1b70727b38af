"""What tests of stops see of a motor: that it turns, and that it stays at rest."""

from __future__ import annotations

import asyncio

from backends.can.rig import Motor

__all__ = ["stays_at_rest", "turns"]


async def stays_at_rest(rig: Motor, seconds: float = 0.5) -> None:
    """See that the plant does not turn for a while."""
    began = rig.twin.plant.position
    end = asyncio.get_running_loop().time() + seconds
    while asyncio.get_running_loop().time() < end:
        assert abs(rig.twin.plant.velocity) < 0.1
        await asyncio.sleep(0.005)
    assert abs(rig.twin.plant.position - began) < 0.05


async def turns(rig: Motor, velocity: float = 2.0) -> None:
    await rig.enable()
    await rig.write("actuator/m/velocity", velocity)
    await rig.until(lambda: rig.twin.plant.velocity > 0.7 * velocity)
