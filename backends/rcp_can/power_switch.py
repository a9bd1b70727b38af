"""Switch a motor on, and check that it stays on."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress

import anyio

from rcp_can.axis import Axis
from rcp_can.preconditions import check_bus, check_feedback, check_link
from rcp_kernel.errors import DeviceRejected, DeviceTimeout, ModeForbids, RcpError
from rcp_kernel.spi import check_fence, unfenced

__all__ = ["enable"]

_STAYS = 0.1  # s for which a drive must stay enabled, and
_WORDS = 3  # number of state reports that must confirm it
_POLL_PERIOD = 0.02  # s
_OBSERVED = 1.0  # s within which those reports must arrive
_WITHDRAW = 0.5  # s that switching off again may take


async def enable(axis: Axis) -> None:
    """Enable a motor at rest; return when it has stayed enabled.

    :raises DeviceRejected: it switches itself off again, with its reason.
    :raises AdapterUnavailable: contact is lost meanwhile.
    :raises RcpError: as for `check_bus` and `check_feedback`, or from the drive.
    """
    check_fence()
    check_bus(axis)
    check_feedback(axis)
    axis.forget(None)
    axis.end_stop()
    was_on, axis.enabling = axis.status.energised, True
    try:
        await axis.drive.enable()
        axis.wanted_on = axis.in_use = True
        if axis.drive.holds:
            axis.rest()
        await _stays_on(axis)
    except BaseException:
        if not was_on:
            await _withdraw(axis)
        raise
    finally:
        axis.enabling = False
        axis.show()


async def _stays_on(axis: Axis) -> None:
    status = axis.status
    words, began = status.counts["enabled"], time.monotonic()
    while True:
        await asyncio.sleep(_POLL_PERIOD)
        check_link(axis)
        check_feedback(axis)
        if axis.gone is not None and not isinstance(axis.gone, ModeForbids):
            raise axis.gone  # contact was lost, which says nothing about its power stage
        if not status.enabled or not axis.wanted_on:
            why = "; ".join(fault.text for fault in status.faults)
            raise DeviceRejected(
                f"motor '{axis.name}' was enabled and switched itself off again"
                + (f": {why}" if why else "")
            )
        since = time.monotonic() - began
        if since >= _STAYS and status.counts["enabled"] - words >= _WORDS:
            return
        if since > _OBSERVED:
            raise DeviceTimeout(f"motor '{axis.name}' did not confirm that it stays enabled")


async def _withdraw(axis: Axis) -> None:
    """Switch the motor off after a failed enable: frames already sent may still take effect."""
    axis.wanted_on = False
    axis.forget(None)
    if axis.stopping or (axis.status.faults and axis.status.energised is False):
        return  # a stop already handles it, or its fault has switched it off
    with unfenced(), suppress(RcpError), anyio.move_on_after(_WITHDRAW, shield=True):
        await axis.drive.disable()
