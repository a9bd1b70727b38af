"""DroneCAN in a backend that has it: its nodes, and the gateway's own node on each bus."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from rcp_can.axis import Axis
from rcp_can.bus import Bus
from rcp_can.config import CanConfig
from rcp_can.health import Health
from rcp_kernel.spi import Host

if TYPE_CHECKING:
    from rcp_can.dronecan.node import DronecanPart

__all__ = ["dronecan_parts", "dronecan_services"]


def dronecan_parts(
    config: CanConfig,
    buses: Mapping[str, Bus],
    axes: Iterable[Axis],
    host: Host,
    health: Health,
) -> list[DronecanPart]:
    """Return the parts of the configured nodes.

    :raises ConfigError: the library is not installed.
    """
    if not config.dronecan:
        return []
    from rcp_can.dronecan.node import DronecanPart

    escs = [axis for axis in axes if axis.config.profile == "dronecan"]
    return [
        DronecanPart(
            name,
            node,
            buses[node.bus],
            host,
            health,
            [esc for esc in escs if (esc.config.bus, esc.config.node) == (node.bus, node.node)],
        )
        for name, node in config.dronecan.items()
    ]


def dronecan_services(
    config: CanConfig, buses: Mapping[str, Bus]
) -> list[Callable[[], Coroutine[Any, Any, None]]]:
    """Return what runs on each bus with DroneCAN nodes."""
    names = config.dronecan_buses
    if not names:
        return []
    from rcp_can.dronecan.commands import EscCommands
    from rcp_can.dronecan.port import Port

    kinds = Port, EscCommands
    return [buses[name].shared(kind, kind).run for name in names for kind in kinds]
