"""Commands to speed controllers: one message has those of all controllers of a bus."""

from __future__ import annotations

import asyncio
import contextvars
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import Literal, NamedTuple

import structlog

from rcp_can.bus import Bus
from rcp_can.dronecan.library import make
from rcp_can.dronecan.port import Port
from rcp_kernel.errors import RcpError

__all__ = ["EscCommands"]

log = structlog.get_logger("rcp.can")
_LIFETIME = 0.05  # s: a set-point older than this is not worth sending
_ZEROS = 1.0  # s: of a message that stops all
_COMMAND, _STOP = 8, 0  # priorities
_ARMING = 0.5  # s between two announcements
_ARMED, _DISARMED = 255, 0


class _SetPoint(NamedTuple):
    value: int
    until: float


class EscCommands:
    """The set-points of all controllers of one bus; a place without one is sent as zero."""

    def __init__(self, bus: Bus) -> None:
        self._port = bus.shared(Port, Port)
        self._control: Literal["rpm", "raw"] = "rpm"
        self.places: list[int] = []
        """The indices in use."""
        self._set: dict[int, _SetPoint] = {}
        self._on: set[int] = set()
        self._armed: set[int] = set()
        self._announces = False
        self._flush: asyncio.Handle | None = None
        self._plain = contextvars.Context()

    def join(self, index: int, control: Literal["rpm", "raw"], *, arming: bool) -> None:
        """Add a controller; all of a bus have the same `control`."""
        self.places.append(index)
        self._control = control
        self._announces |= arming

    def command(self, index: int, value: int, lasts: float) -> None:
        """Set a set-point for `lasts` seconds, and send all in this turn of the event loop."""
        self._set[index] = _SetPoint(value, time.monotonic() + lasts)
        if value and index in self._on:
            self._arm(index, on=True)
        if self._flush is None:
            # Its sender has been checked; the others' must not be subject to its request.
            loop = asyncio.get_running_loop()
            self._flush = loop.call_soon(self._send_all, context=self._plain)

    def stop(self, index: int) -> None:
        """Send zero ahead of everything, and drop what waits to be sent.

        Once all are stopped, the system is not armed either: a controller that heeds that turns
        for no other node. It is armed again by the next set-point other than zero.

        :raises AdapterUnavailable: the bus is down, or off.
        """
        self._set.pop(index, None)
        self._arm(index, on=False)
        self._send(urgent=True)

    def switch(self, index: int, *, on: bool) -> None:
        """Count a controller among those that are in use; the system is armed if any is."""
        (self._on.add if on else self._on.discard)(index)
        if not on:
            self._set.pop(index, None)
        self._arm(index, on=on)

    def zeros(self) -> object:
        """Return the message that stops all controllers in use."""
        return self._message([0] * (max(self.places) + 1))

    async def run(self) -> None:
        """Announce whether the system is armed until cancelled."""
        while True:
            self.announce()
            await asyncio.sleep(_ARMING)

    def announce(self) -> None:
        """Tell whether the system is armed: some controllers turn nothing otherwise."""
        if self._announces:
            status = make(
                "equipment.safety.ArmingStatus", status=_ARMED if self._armed else _DISARMED
            )
            with suppress(RcpError):  # it is repeated
                self._port.broadcast(status, priority=_COMMAND)

    def _arm(self, index: int, *, on: bool) -> None:
        before = bool(self._armed)
        (self._armed.add if on else self._armed.discard)(index)
        if before != bool(self._armed):
            self.announce()

    def _send_all(self) -> None:
        self._flush = None
        try:
            self._send(urgent=False)
        except RcpError as error:  # the bus state reports it; the next cycle tries again
            log.debug("not_sent", bus=self._port.bus.name, error=error.message)

    def _send(self, *, urgent: bool) -> None:
        now = time.monotonic()

        def value(index: int) -> int:
            point = self._set.get(index)
            return point.value if point is not None and now <= point.until else 0

        values = [value(index) for index in range(max(self.places) + 1)]
        # A stop has what is in force for the others, which must not follow their own stop: each
        # stop drops the one before, because both have a lifetime.
        self._port.broadcast(
            self._message(values),
            priority=_STOP if urgent else _COMMAND,
            lifetime=_LIFETIME if any(values) or not urgent else _ZEROS,
            urgent=urgent,
            sender=self,
        )

    def _message(self, values: Sequence[int]) -> object:
        if self._control == "rpm":
            return make("equipment.esc.RPMCommand", rpm=values)
        return make("equipment.esc.RawCommand", cmd=values)
