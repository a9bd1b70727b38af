"""Step the demo's rover with physics as a controller or a policy would: an action, some steps, an observation.

Run it as `python examples/step_rover.py --steps 500`; it needs `pip install 'rcp-gateway[mujoco]'` for the demo.

The simulation is paused, so that the time between two decisions does not matter to the robot.
"""

from __future__ import annotations

import argparse
import asyncio
import math
import time
from typing import Any

import rcp_client

RADIUS = 1.0  # m, of the circle that it drives
SPEED = 0.5  # m/s
WHEEL, TRACK = 0.08, 0.36  # m
SUBSTEPS = 10  # of 2 ms each: a decision every 20 ms


def decide(sensors: dict[str, Any]) -> dict[str, float]:
    """Return the speeds of the wheels, rad/s: keep to a circle about (0, RADIUS)."""
    pose = sensors["sensor/pose"]
    x, y = pose["position"]["x"], pose["position"]["y"] - RADIUS
    heading = 2 * math.atan2(pose["orientation"]["z"], pose["orientation"]["w"])
    outwards = math.hypot(x, y) - RADIUS
    wanted = math.atan2(y, x) + math.pi / 2 + math.atan(2 * outwards)
    turn = SPEED / RADIUS + 3 * math.remainder(wanted - heading, math.tau)
    left, right = (SPEED + side * turn * TRACK / 2 for side in (-1, 1))
    return {"left_wheel": left / WHEEL, "right_wheel": right / WHEEL}


async def main() -> None:
    """Pause, step, and let time go on again."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default=None)
    parser.add_argument("--tenant", default="epsilon")
    parser.add_argument("--steps", type=int, default=500)
    args = parser.parse_args()
    async with rcp_client.connect(args.url, tenant=args.tenant) as robot:
        await robot.write("/param/paused", True)
        try:
            await robot.execute("/service/reset", {"seed": 1})
            seen = await robot.execute("/service/step", {"steps": 1})
            began = time.perf_counter()
            for number in range(args.steps):
                action = decide(seen["sensors"])
                step = {"steps": SUBSTEPS, "controls": action}
                seen = await robot.execute("/service/step", step)
                if number % 50 == 49:
                    at = seen["sensors"]["sensor/pose"]["position"]
                    print(f"{seen['time']:.2f} s  x {at['x']:.2f} m  y {at['y']:.2f} m")
            rate = args.steps / (time.perf_counter() - began)
            print(f"{args.steps} steps, {rate:.0f} a second, {seen['time']:.2f} s simulated")
        finally:
            await robot.execute("/service/reset")
            await robot.write("/param/paused", False)


if __name__ == "__main__":
    asyncio.run(main())
