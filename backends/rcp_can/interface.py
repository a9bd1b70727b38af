"""Open a python-can interface in a worker thread, and explain failures."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

from rcp_can.config import BusConfig
from rcp_kernel.errors import ConfigError, NotReady

if TYPE_CHECKING:
    import can

__all__ = ["arguments", "open_interface"]


async def open_interface(name: str, config: BusConfig) -> can.BusABC:
    """Open the interface of a bus.

    :raises ConfigError: the interface is unknown, or rejects these arguments.
    :raises NotReady: it is currently not available.
    """
    return await asyncio.get_running_loop().run_in_executor(None, _open, name, config)


def _open(name: str, config: BusConfig) -> can.BusABC:
    import can

    known = sorted(can.VALID_INTERFACES)
    if config.interface not in known:
        raise ConfigError(
            f"buses.{name}.interface: python-can has no {config.interface!r}; "
            f"it has {', '.join(known)}"
        )
    try:
        return can.Bus(config.channel, config.interface, ignore_config=True, **arguments(config))
    except can.CanInterfaceNotImplementedError as error:
        raise ConfigError(f"buses.{name}: {config.interface} is not available: {error}") from error
    except (TypeError, ValueError) as error:
        raise ConfigError(
            f"buses.{name}: {config.interface} rejected the settings: {error}"
        ) from error
    except Exception as error:
        raise NotReady(
            f"CAN bus '{name}' ({config.interface} {config.channel}): {error}"
        ) from error


def arguments(config: BusConfig) -> dict[str, Any]:
    """Return the arguments of python-can's `Bus` besides interface and channel."""
    found: dict[str, Any] = dict(config.options)
    if config.bitrate is not None and config.interface not in ("virtual", "udp_multicast"):
        found.setdefault("bitrate", config.bitrate)
    if config.data_bitrate is not None and config.fd:
        found.setdefault("data_bitrate", config.data_bitrate)
    if config.interface == "virtual":
        import can

        protocol = can.CanProtocol.CAN_FD if config.fd else can.CanProtocol.CAN_20
        found.setdefault("protocol", protocol)
    elif config.fd or config.interface == "udp_multicast":
        found.setdefault("fd", config.fd)
    return found
