"""A twin on the test's own event loop, put where a test begins without waiting for it."""

from __future__ import annotations

import math
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from typing import Any

from rcp_gateway.testing import eventually
from rcp_mavlink_sim import Options, Twin, Vehicle, fly
from rcp_mavlink_sim.modes import Mode

FAST = 10.0
_STEP = 0.02


def skip(vehicle: Vehicle, holds: Callable[[], bool], seconds: float = 200.0) -> None:
    """Let simulated time pass at once, until something holds."""
    end = vehicle.time + seconds
    while not holds():
        assert vehicle.time < end, "it never came to hold"
        vehicle.advance(vehicle.wall, _STEP / vehicle.options.speed)


def on_the_ground(vehicle: Vehicle, mode: Mode = Mode.GUIDED) -> None:
    """Put it on the ground, disarmed."""
    if not vehicle.body.landed:
        vehicle.flight.set_mode(Mode.LAND)
        skip(vehicle, lambda: not vehicle.armed)
    vehicle.flight.disarm()
    vehicle.flight.set_mode(mode)


def armed(vehicle: Vehicle, mode: Mode = Mode.GUIDED) -> None:
    """Put it on the ground, armed."""
    on_the_ground(vehicle, mode)
    assert vehicle.arm()


def airborne(vehicle: Vehicle, height: float = 20.0) -> None:
    """Put it into the air in GUIDED, at rest."""
    if vehicle.body.landed or not vehicle.armed:
        armed(vehicle)
        assert vehicle.flight.take_off(height)
        skip(vehicle, lambda: not vehicle.flight.taking_off)
    vehicle.flight.set_mode(Mode.GUIDED)
    vehicle.pilot.hold()
    skip(vehicle, lambda: speed(vehicle) < 0.1)


def speed(vehicle: Vehicle) -> float:
    """Return how fast it moves, m/s."""
    body = vehicle.body
    return math.sqrt(body.vn**2 + body.ve**2 + body.vd**2)


@asynccontextmanager
async def twin(*links: str, **options: Any) -> AsyncGenerator[Twin]:
    """Run a twin that is warm, at ten times the speed."""
    given = {"speed": FAST, "warmup": 0.0, "parameters": {"DISARM_DELAY": 0.0}, **options}
    vehicle = Vehicle(Options(**given))
    vehicle.advance(0.0, 1.0)
    vehicle.flight.set_mode(Mode.GUIDED)
    async with fly(vehicle, *(links or ("udpin:127.0.0.1:0",))) as running:
        yield running


async def agrees(backend: Any, vehicle: Vehicle) -> None:
    """Wait until the gateway's picture of the vehicle is the vehicle."""

    async def same() -> bool:
        if not backend.robots:
            return False
        seen = next(iter(backend.robots.values())).vehicle
        return (
            (seen.armed, seen.landed, seen.mode)
            == (
                vehicle.armed,
                vehicle.body.landed,
                vehicle.flight.mode.name,
            )
            and seen.home is not None
            and seen.fix is not None
            and abs(seen.fix.height + vehicle.body.d) < 0.5
        )

    await eventually(same, "the gateway sees what the vehicle does")
