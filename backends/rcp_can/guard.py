"""Whether a motor can be told something: it is heard, configured and enabled, and its bus takes frames."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, NamedTuple

from rcp_kernel.errors import AdapterUnavailable, ModeForbids, QueueFull

if TYPE_CHECKING:
    from rcp_can.axis import Axis

__all__ = [
    "STALLED",
    "Loss",
    "check",
    "check_bus",
    "check_link",
    "heartless",
    "loss",
    "ready",
]

STALLED = 0.25  # s that a frame waits to be sent, after which set-points would leave in a heap
_CONFIGURING = 1.0  # s that a call waits for a drive to be configured


class Loss(NamedTuple):
    """Why a drive counts as lost."""

    fault: str
    text: str


def loss(axis: Axis, now: float) -> Loss | None:
    """Tell whether a drive that was heard is lost."""
    timeout = axis.config.timeout
    if now - axis.heard > timeout:
        return Loss("feedback_lost", f"nothing was heard of it for {timeout:g} s")
    if heartless(axis, now):
        return Loss("heartbeat_lost", "its heartbeats have stopped, whatever else it sends")
    return None


def heartless(axis: Axis, now: float) -> bool:
    """Tell whether heartbeats are missing."""
    beats = axis.drive.beats
    return beats is not None and now - axis.status.beat > max(beats, axis.config.timeout)


def check(axis: Axis) -> None:
    """See that it can be commanded.

    :raises AdapterUnavailable: its bus is down, or it is not heard of.
    :raises ModeForbids: it is not enabled.
    """
    check_link(axis)
    check_bus(axis)
    if not axis.status.enabled or not axis.configured:
        faults = ", ".join(fault.name for fault in axis.status.faults)
        raise ModeForbids(
            f"motor '{axis.name}' is {axis.state}" + (f" ({faults})" if faults else ""),
            remedy=f"Execute service/{axis.name}/"
            + ("clear_faults, then enable." if faults else "enable first."),
        )


def check_link(axis: Axis) -> None:
    """See that it can be reached.

    :raises AdapterUnavailable: its bus is down, or it is not heard of.
    """
    if not axis.bus.up:
        raise AdapterUnavailable(f"CAN bus '{axis.bus.name}' is {axis.bus.state}")
    if not axis.online:
        raise AdapterUnavailable(
            f"motor '{axis.name}' (node {axis.drive.node}) is silent",
            remedy="Check its supply, its cable and its node id.",
        )


def check_bus(axis: Axis) -> None:
    """See that what it is told reaches it now, and no other drive.

    :raises QueueFull: the frames of before have not left yet.
    :raises ModeForbids: two drives have its id.
    """
    if axis.bus.lag > STALLED:
        raise QueueFull(
            f"CAN bus '{axis.bus.name}' takes no frames: one has waited for {axis.bus.lag:.1f} s",
            remedy=f"See sensor/can/{axis.bus.name}/state and …/statistics.",
        )
    if axis.faults.own("duplicate_node") is not None:
        raise ModeForbids(
            f"motor '{axis.name}': two drives answer to node {axis.drive.node}",
            remedy=f"Give one of them another id, then execute service/{axis.name}/clear_faults.",
        )


async def ready(axis: Axis) -> None:
    """Wait until the drive is configured.

    :raises AdapterUnavailable: it cannot be reached, or not be configured.
    """
    check_link(axis)
    if not axis.configured and axis.configuring is not None:
        await asyncio.wait((axis.configuring,), timeout=_CONFIGURING)
    if not axis.configured:
        fault = axis.faults.own("configuration")
        raise AdapterUnavailable(
            f"motor '{axis.name}': " + (fault.text if fault else "it is being configured")
        )
