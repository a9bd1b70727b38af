"""The frames that the guard process sends on each bus when the gateway has failed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from rcp_can.config import BusConfig, CanConfig
from rcp_can.drive import StopFrame
from rcp_can.interface import arguments
from rcp_kernel.spi import StopPlan

if TYPE_CHECKING:
    from rcp_can.axis import Axis
    from rcp_can.device import DevicePart

__all__ = ["stop_plans"]

_SHARED = frozenset(("socketcan", "socketcand", "udp_multicast"))
"""Interfaces that a second process can open while the gateway uses them."""


def stop_plans(
    config: CanConfig, axes: Iterable[Axis], devices: Iterable[DevicePart]
) -> dict[str, StopPlan]:
    """Return a plan per bus that another process can open and on which something can be stopped.

    It includes every drive with a stop that cannot switch it on, also a drive with its own
    watchdog:
    the frames do not disturb a drive at rest, and another tool may have changed the watchdog since.
    A drive that only its watchdog can stop safely (moteus) is left out.
    """
    frames: dict[str, list[StopFrame]] = {}
    for axis in axes:
        frames.setdefault(axis.bus.name, []).extend(axis.drive.stop_frames())
    for device in devices:
        safe = [StopFrame(i, data, extended, fd) for i, data, extended, fd in device.safe_frames()]
        frames.setdefault(device.bus, []).extend(safe)
    return {
        name: StopPlan("can", {"bus": _bus(bus), "frames": [_plain(f) for f in frames[name]]})
        for name, bus in config.buses.items()
        if frames.get(name) and bus.interface in _SHARED
    }


def _bus(bus: BusConfig) -> dict[str, Any]:
    return {"interface": bus.interface, "channel": bus.channel, **arguments(bus)}


def _plain(frame: StopFrame) -> dict[str, Any]:
    return {
        "id": frame.identifier,
        "data": frame.data.hex(),
        "extended": frame.extended,
        "fd": frame.fd,
        "brs": frame.switched,
    }
