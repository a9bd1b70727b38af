"""The demo's robots as they are, seen past the dashboard."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import httpx

__all__ = ["BOUND", "STILL", "speed", "until", "value"]

BOUND = 60.0  # s that anything may take
STILL = 0.002  # m/s


async def value(robot: httpx.AsyncClient, path: str) -> Any:
    """Read a value that is there."""
    answer = await robot.get(f"/rcp/v1/context{path}")
    assert answer.status_code == 200, answer.text
    return answer.json()["body"]


async def until(
    robot: httpx.AsyncClient, path: str, holds: Callable[[Any], bool], bound: float = BOUND
) -> Any:
    """Read until a value is there and as wanted, within the bound."""
    async with asyncio.timeout(bound):
        while True:
            answer = await robot.get(f"/rcp/v1/context{path}")
            if answer.is_success and holds(found := answer.json()["body"]):
                return found
            await asyncio.sleep(0.05)


def speed(odometry: Any) -> float:
    """Return how fast a rover drives and turns, added up."""
    twist = odometry["twist"]
    return abs(twist["linear"]["x"]) + abs(twist["angular"]["z"])
