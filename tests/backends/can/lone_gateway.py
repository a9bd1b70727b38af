"""A CAN backend in a process of its own that turns its motors until something stops it.

`python -m backends.can.lone_gateway GROUP PROFILE:NODE …`; writes `turning` when all of them turn.
"""

from __future__ import annotations

import asyncio
import sys

from backends.can.rig import opened

VELOCITY = 2.0


async def main(channel: str, motors: list[str]) -> None:
    tables = {
        name: {
            "bus": "can0",
            "profile": profile,
            "node": int(node),
            "feedback_timeout": 2.0,
            "timeout": 2.0,
            "valid_for": 600.0,
        }
        for name, (profile, _, node) in ((f"m{i}", m.partition(":")) for i, m in enumerate(motors))
    }
    fd = any(table["profile"] == "moteus" for table in tables.values())
    bus = {"interface": "udp_multicast", "channel": channel, "fd": fd}
    async with opened({"buses": {"can0": bus}, "motors": tables, "grace": 10.0}) as rig:
        for name, axis in rig.backend.axes.items():
            await rig.host.until(lambda a=axis: a.configured)
            await rig.ran(f"service/{name}/enable")
            await rig.write(f"actuator/{name}/velocity", VELOCITY)
        for axis in rig.backend.axes.values():
            await rig.host.until(lambda a=axis: (a.velocity or 0.0) > 0.8 * VELOCITY)
        sys.stdout.write("turning\n")
        sys.stdout.flush()
        await asyncio.Event().wait()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], sys.argv[2:]))
