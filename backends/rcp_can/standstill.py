"""Standstill of motors, from their own fresh measurements."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

from rcp_can.preconditions import check_feedback, check_link
from rcp_kernel.errors import DeviceTimeout
from rcp_kernel.spi import MotionState

if TYPE_CHECKING:
    from rcp_can.axis import Axis

__all__ = ["motion_of", "motion_of_all", "rested"]

_REST = 4.0  # s a joint may need to come to rest
_POLL_PERIOD = 0.01  # s


def motion_of(axis: Axis) -> MotionState:
    """Report whether one motor is at rest."""
    energised = axis.status.energised if axis.online else None
    if not axis.met:
        return MotionState(None, f"motor '{axis.name}' has sent no message since the start", None)
    if not axis.bus.up:
        return MotionState(None, f"CAN bus '{axis.bus.name}' is {axis.bus.state}", None)
    if not axis.online:
        age = time.monotonic() - axis.last_message_at
        return MotionState(None, f"motor '{axis.name}': no message received for {age:.1f} s", None)
    velocity = axis.velocity
    if velocity is None or not axis.is_fresh("velocity"):
        age = time.monotonic() - axis.status.at.get("velocity", axis.last_message_at)
        return MotionState(
            None, f"motor '{axis.name}': no velocity received for {age:.1f} s", energised
        )
    if axis.drive.busy:
        text = f"motor '{axis.name}' runs a procedure of its drive"
        return MotionState(False, text, energised)
    if not axis.slow:
        text = f"motor '{axis.name}' moves at {abs(velocity):.2g} rad/s"
        return MotionState(False, text, energised)
    return MotionState(True, "", energised)


def motion_of_all(axes: Iterable[Axis]) -> MotionState | None:
    """Combine the states: moving before unknown before rest; None if there is no motor."""
    states = [motion_of(axis) for axis in axes if axis.met or not axis.config.optional]
    if not states:
        return None
    at_rest: bool | None = True
    if any(state.at_rest is False for state in states):
        at_rest = False
    elif any(state.at_rest is None for state in states):
        at_rest = None
    energised: bool | None = False
    if any(state.energised for state in states):
        energised = True
    elif any(state.energised is None for state in states):
        energised = None
    return MotionState(at_rest, "; ".join(s.detail for s in states if s.detail), energised)


async def rested(axis: Axis, unless: Callable[[], bool] = lambda: False) -> None:
    """Wait until several consecutive fresh reports show standstill, unless it is not to rest any longer.

    A procedure of the drive has to end first, which may silence the drive for a while.

    :raises DeviceTimeout: they do not, or feedback is lost.
    :raises AdapterUnavailable: the drive is lost meanwhile.
    """
    if axis.drive.busy:
        await axis.drive.settled()
    begun = time.monotonic()
    while time.monotonic() < begun + _REST:
        if unless() or axis.rests_since(begun):
            return
        check_link(axis)
        check_feedback(axis)
        await asyncio.sleep(_POLL_PERIOD)
    raise DeviceTimeout(
        f"motor '{axis.name}' did not come to rest within {_REST:g} s",
        details={"motor": axis.name, "detail": motion_of(axis).detail},
    )
