"""A simulated rover with sensors, tasks, a battery and injectable faults."""

from __future__ import annotations

from collections.abc import Iterable

from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.spi import BackendKind
from rcp_sim.backend import SimBackend, open_sim
from rcp_sim.config import SimConfig

__all__ = ["SimBackend", "SimConfig", "open_sim", "rcp_backends"]


@hookimpl
def rcp_backends() -> Iterable[BackendKind]:
    """Offer the simulated rover."""
    return [BackendKind("sim", SimConfig, open_sim, "A simulated rover in a warehouse.")]
