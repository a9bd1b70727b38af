"""`python -m rcp_mavlink_sim.child`: a vehicle that exits with its parent process.

Standard input carries one line of JSON, a `Start`, and stays open. When it closes, which happens
even if the parent is killed, the vehicle exits.
"""

from __future__ import annotations

import asyncio
import sys

import msgspec

from rcp_mavlink_sim import Options, fly, vehicle_of
from rcp_mavlink_sim.parameters_table import settable

__all__ = ["Start", "main"]

_LONGEST = 1 << 20  # bytes, limit of the line


class Start(msgspec.Struct, frozen=True):
    """The vehicle's options and links."""

    options: Options
    links: tuple[str, ...]


async def _run() -> None:
    loop = asyncio.get_running_loop()
    owner = asyncio.StreamReader(limit=_LONGEST)
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(owner), sys.stdin)
    start = msgspec.json.decode(await owner.readline(), type=Start)
    unknown = sorted(start.options.parameters.keys() - settable(start.options.vehicle))
    if unknown:
        sys.exit(f"it has no parameter {', '.join(unknown)}")
    async with fly(vehicle_of(start.options), *start.links):
        while await owner.read(_LONGEST):
            pass


def main() -> None:
    """Run until standard input closes."""
    asyncio.run(_run())


if __name__ == "__main__":
    main()
