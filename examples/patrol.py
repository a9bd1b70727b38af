"""Drive or fly any robot with the profile `mobile` around a square about where it is, and back.

python examples/patrol.py /tenant/alpha --side 2 --rounds 1

The first argument is the robot's path in `rcpctl robots`, or words that find it (`drone`). An aircraft takes off first and
returns home at the end. Ctrl-C cancels the goal under way, which brings the robot to rest; `--stop` does so from elsewhere.
"""

from __future__ import annotations

import argparse
import asyncio
import math
import signal
import sys
from typing import Any

import rcp_client
from rcp_kernel.errors import Cancelled, RcpError


class Patrol:
    """One robot, by the names that its profiles give to every robot."""

    def __init__(self, client: rcp_client.Client, facts: dict[str, Any]) -> None:
        self._client = client
        self._profiles = {name.partition("/")[0] for name in facts["profiles"]}
        _, tenant, self._tenant, *robot = facts["path"].split("/")
        self._root, self._robot = f"/{tenant}/{self._tenant}", "".join(f"{part}/" for part in robot)
        self._reported = 0.0

    def path(self, name: str) -> str:
        """Return the path of `sensor/pose` and the like on this robot."""
        branch, _, rest = name.partition("/")
        return f"{self._root}/{branch}/{self._robot}{rest}"

    async def stop(self) -> None:
        """Bring it to rest, whoever commands it."""
        held = await self._client.execute(self.path("service/hold"))
        print("at rest" if held["at_rest"] else f"not at rest: {held['detail']}")

    async def run(self, side: float, rounds: int, height: float) -> None:
        """Prepare it, send it around the square, and bring it back."""
        if await self._client.discover(self.path("service/enable")):
            print("switching the motors on")
            await self._client.execute(self.path("service/enable"))
        if "aerial" in self._profiles:
            print(f"taking off to {height:g} m")
            await self._client.execute(self.path("action/takeoff"), {"altitude": height})
        pose = await self._client.read(self.path("sensor/pose"), fresh=True)
        x, y = pose["position"]["x"], pose["position"]["y"]
        corners = [(x + side, y), (x + side, y + side), (x, y + side), (x, y)]
        for number, (x, y) in enumerate(corners * rounds, 1):
            print(f"{number}/{4 * rounds}: to x {x:.2f} m, y {y:.2f} m in {pose['frame_id']}")
            await self.move_to(
                x, y, height if "aerial" in self._profiles else 0.0, pose["frame_id"]
            )
        if "aerial" in self._profiles:
            print("returning home")
            await self._client.execute(self.path("action/return_home"))

    async def move_to(self, x: float, y: float, z: float, frame: str) -> None:
        """Go to a corner; return when the robot has measured that it is there."""
        goal = {"position": {"x": x, "y": y, "z": z}, "frame": frame}
        path = self.path("action/move_to")
        self._reported = math.inf
        done = await self._client.execute(path, goal, on_feedback=self._report)
        error = done.get("error")
        print("  there" if error is None else f"  there, within {error:.2f} m", flush=True)

    def _report(self, feedback: rcp_client.Feedback) -> None:
        """Print how far it still is, each time a tenth of the way is done."""
        left = (feedback.body or {}).get("distance_remaining")
        if left is None or left > 0.9 * self._reported:
            return
        self._reported, eta = left, feedback.body.get("eta")
        print(f"  {left:.2f} m left" + ("" if eta is None else f", {eta:.1f} s"), flush=True)


async def find(client: rcp_client.Client, named: str | None) -> dict[str, Any]:
    """Return the robot with a path, or the only one that words find, if it has the profile."""
    words = None if named is None or named.startswith("/") else named
    found = [one for one in await client.robots(words) if _is_mobile(one)]
    if words is None and named is not None:
        found = [one for one in found if one["path"] == named.rstrip("/")]
    if len(found) != 1:
        paths = [one["path"] for one in found or await client.robots() if _is_mobile(one)]
        raise SystemExit(f"Name one of these mobile robots: {', '.join(sorted(paths)) or 'none'}")
    return found[0]


def _is_mobile(facts: dict[str, Any]) -> bool:
    return any(name.startswith("mobile/") for name in facts.get("profiles", ()))


def on_notice(notice: rcp_client.Notice) -> None:
    """Print what the gateway or the connection says beside replies, such as a lost link."""
    print(f"  ({notice.code}: {notice.message})", file=sys.stderr, flush=True)


async def main(args: argparse.Namespace) -> None:
    """Connect, find the robot, and patrol."""
    async with rcp_client.connect(args.url, token=args.token, on_notice=on_notice) as client:
        robot = Patrol(client, await find(client, args.robot))
        if args.stop:
            await robot.stop()
            return
        patrol = asyncio.ensure_future(robot.run(args.side, args.rounds, args.height))
        asyncio.get_running_loop().add_signal_handler(signal.SIGINT, patrol.cancel)
        try:
            await patrol
        except asyncio.CancelledError:
            # The goal may have begun; a hold completes when the robot is measured to be at rest.
            await robot.stop()
            raise


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("robot", nargs="?", help="path of a robot, or words that find it")
    parser.add_argument("--url", help="the gateway (default: RCP_URL, or this machine)")
    parser.add_argument(
        "--token", help="a key that may command (default: RCP_TOKEN, or the demo's)"
    )
    parser.add_argument("--side", type=float, default=2.0, help="of the square, m (2)")
    parser.add_argument("--rounds", type=int, default=1, help="how often (1)")
    parser.add_argument("--height", type=float, default=5.0, help="of an aircraft, m (5)")
    parser.add_argument("--stop", action="store_true", help="bring the robot to rest, and exit")
    return parser.parse_args()


if __name__ == "__main__":
    try:
        asyncio.run(main(arguments()))
    except (asyncio.CancelledError, KeyboardInterrupt):
        sys.exit(130)
    except Cancelled as error:
        sys.exit(f"Cancelled by someone else: {error.message}")
    except RcpError as error:
        # `rejected`: nothing has moved. `failed`: the robot may have moved; see what it says.
        sys.exit(f"{error.status}, {error.code}: {error.message.rstrip('.')}. {error.remedy}")
