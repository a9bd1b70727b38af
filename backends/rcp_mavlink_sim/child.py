"""`python -m rcp_mavlink_sim.child`: a vehicle that belongs to whoever started it, and ends with it.

Standard input carries one line of JSON, a `Start`, and stays open. Its end, which a `kill -9` of the
other side brings too, ends the vehicle.
"""

from __future__ import annotations

import asyncio
import sys

import msgspec

from rcp_mavlink_sim import Options, Vehicle, fly
from rcp_mavlink_sim.parameters_table import table

__all__ = ["Start", "main"]

_LONGEST = 1 << 20  # bytes of the line


class Start(msgspec.Struct, frozen=True):
    """What to fly, and where it is talked to."""

    options: Options
    links: tuple[str, ...]


async def _run() -> None:
    loop = asyncio.get_running_loop()
    owner = asyncio.StreamReader(limit=_LONGEST)
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(owner), sys.stdin)
    start = msgspec.json.decode(await owner.readline(), type=Start)
    unknown = sorted(start.options.parameters.keys() - table(start.options.vehicle).keys())
    if unknown:
        sys.exit(f"it has no parameter {', '.join(unknown)}")
    async with fly(Vehicle(start.options), *start.links):
        while await owner.read(_LONGEST):
            pass


def main() -> None:
    """Fly until standard input ends."""
    asyncio.run(_run())


if __name__ == "__main__":
    main()
