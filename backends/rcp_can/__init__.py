"""CAN buses: motor drives of several makes, devices by DBC or EDS, and the frames themselves.

Importing this costs nothing; python-can is imported when a backend is opened.
"""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager
from importlib.util import find_spec

from rcp_can.config import CanConfig
from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.spi import Backend, BackendKind, Host

__all__ = ["CanConfig", "open_can", "rcp_backends"]


@asynccontextmanager
async def open_can(config: CanConfig, host: Host) -> AsyncGenerator[Backend]:
    """Open the buses and detect the devices on them.

    :raises ConfigError: the configuration is invalid.
    :raises NotReady: a bus does not open.
    """
    from rcp_can.backend import open_buses

    async with open_buses(config, host) as backend:
        yield backend


def _lacks(config: CanConfig) -> str | None:
    if not config.dronecan_buses or find_spec("dronecan") is not None:
        return None
    nodes = (f"`dronecan.{name}`" for name in config.dronecan)
    motors = (f"`motors.{n}`" for n, m in config.motors.items() if m.profile == "dronecan")
    return (
        f"{next(nodes, None) or next(motors)} needs a library: No module named 'dronecan'; "
        "try: pip install 'rcp-gateway[dronecan]'"
    )


@hookimpl
def rcp_backends() -> Iterable[BackendKind]:
    """Register the CAN backend."""
    text = "Motor drives and devices on CAN buses."
    needs = ("can", "canopen", "cantools")
    return [BackendKind("can", CanConfig, open_can, text, needs, lacks=_lacks)]
