"""What all other parts use: settings, time, turns of the loop, and the counts of requests."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

from rcp_kernel.clock import Clock
from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.metrics import RequestCounts
from rcp_kernel.contract.shutdown import Shutdown
from rcp_kernel.features.commands import CommandEvents
from rcp_requests.inflight import InFlight
from rcp_scheduling.timers import Deadlines
from rcp_scheduling.turns import Turns

__all__ = ["Base", "compose_base"]


@dataclass(frozen=True, slots=True)
class Base:
    """Parts that know no resource and no client."""

    settings: Settings
    shutdown: Shutdown
    loop: asyncio.AbstractEventLoop
    clock: Clock
    turns: Turns
    counts: RequestCounts
    deadlines: Deadlines
    inflight: InFlight
    events: CommandEvents


def compose_base(config: GatewayConfig, loop: asyncio.AbstractEventLoop, clock: Clock) -> Base:
    """Create them."""
    settings, counts, turns = Settings(config), RequestCounts(), Turns(loop)
    deadlines = Deadlines(loop)
    return Base(
        settings=settings,
        shutdown=Shutdown(),
        loop=loop,
        clock=clock,
        turns=turns,
        counts=counts,
        deadlines=deadlines,
        inflight=InFlight(settings, counts, turns, deadlines, loop),
        events=CommandEvents(),
    )
