"""Whether a motor can be commanded: connected, configured, enabled, and its bus accepts frames."""

from __future__ import annotations

import asyncio

from rcp_can.axis_state import AxisState, Loss
from rcp_kernel.errors import AdapterUnavailable, DeviceTimeout, ModeForbids, QueueFull

__all__ = [
    "STALLED",
    "check",
    "check_bus",
    "check_feedback",
    "check_link",
    "heartless",
    "loss",
    "ready",
    "stale",
]

STALLED = 0.25  # s a frame may wait to be sent, beyond which set-points would leave in a burst
_CONFIGURING = 1.0  # s a call waits for a drive to be configured


def loss(axis: AxisState, now: float) -> Loss | None:
    """Return why a known drive is lost; None if it is not."""
    timeout = axis.config.timeout
    if now - axis.last_message_at > timeout:
        return Loss("feedback_lost", f"no message received for {timeout:g} s")
    if heartless(axis, now):
        return Loss("heartbeat_lost", "heartbeat lost, although other messages still arrive")
    return None


def stale(axis: AxisState, now: float) -> Loss | None:
    """Return which required signal a connected drive no longer sends; None if all arrive."""
    if not axis.configured:
        return None
    at, since = axis.status.at, axis.configured_at
    for signal in axis.signals:
        limit = axis.limit_of(signal)
        if now - max(at.get(signal, float("-inf")), since) > limit:
            word = "state" if signal == "enabled" else signal
            text = f"no {word} received for {limit:g} s"
            if now - axis.last_message_at <= limit:
                text += ", although other messages still arrive"
            return Loss("feedback_lost", text)
    return None


def check_feedback(axis: AxisState) -> None:
    """Check that position, velocity and state are fresh.

    :raises DeviceTimeout: one of them is not.
    """
    if axis.blind is not None:
        raise DeviceTimeout(
            f"motor '{axis.name}': feedback lost: {axis.blind.text}",
            remedy=f"Check sensor/{axis.name}/motion, and that the drive still sends the configured messages.",
        )


def heartless(axis: AxisState, now: float) -> bool:
    """Return whether heartbeats are missing."""
    beats = axis.drive.beats
    return beats is not None and now - axis.status.beat > max(beats, axis.config.timeout)


def check(axis: AxisState) -> None:
    """Check that the motor accepts commands.

    :raises AdapterUnavailable: its bus is down, or it does not respond.
    :raises DeviceTimeout: its feedback is too old.
    :raises ModeForbids: it is not enabled.
    """
    check_link(axis)
    check_bus(axis)
    check_feedback(axis)
    if not axis.status.enabled or not axis.configured:
        faults = ", ".join(fault.name for fault in axis.status.faults)
        raise ModeForbids(
            f"motor '{axis.name}' is {axis.state}" + (f" ({faults})" if faults else ""),
            remedy=f"Execute service/{axis.name}/"
            + ("clear_faults, then enable." if faults else "enable first."),
        )


def check_link(axis: AxisState) -> None:
    """Check that the drive can be reached.

    :raises AdapterUnavailable: its bus is down, or it does not respond.
    """
    if not axis.bus.up:
        raise AdapterUnavailable(f"CAN bus '{axis.bus.name}' is {axis.bus.state}")
    if not axis.online:
        raise AdapterUnavailable(
            f"motor '{axis.name}' (node {axis.drive.node}) does not respond",
            remedy="Check its power supply, cable and node id.",
        )


def check_bus(axis: AxisState) -> None:
    """Check that frames reach this drive now, and no other.

    :raises QueueFull: the bus has not accepted earlier frames yet.
    :raises AdapterUnavailable: the gateway has not sent them yet.
    :raises ModeForbids: two drives have its id.
    """
    if axis.send_delay.seconds > STALLED:
        waiting = f"a frame has been waiting for {axis.bus.lag:.1f} s"
        if not axis.bus.refusing:
            raise AdapterUnavailable(
                f"the gateway is too slow: {waiting}",
                remedy="Send the command again; if this persists, reduce the load of its host.",
            )
        raise QueueFull(
            f"CAN bus '{axis.bus.name}' accepts no frames: {waiting}",
            remedy=f"See sensor/can/{axis.bus.name}/state and …/statistics.",
        )
    if axis.faults.get("duplicate_node") is not None:
        raise ModeForbids(
            f"motor '{axis.name}': two drives respond to node {axis.drive.node}",
            remedy=f"Change the id of one of them, then execute service/{axis.name}/clear_faults.",
        )


async def ready(axis: AxisState) -> None:
    """Wait until the drive is configured.

    :raises AdapterUnavailable: it cannot be reached, or could not be configured.
    """
    check_link(axis)
    if not axis.configured and axis.configuring is not None:
        await asyncio.wait((axis.configuring,), timeout=_CONFIGURING)
    if not axis.configured:
        fault = axis.faults.get("configuration")
        raise AdapterUnavailable(
            f"motor '{axis.name}': " + (fault.text if fault else "it is being configured")
        )
