"""Speed controllers on DroneCAN: commands for all of a bus in one message, reports of each."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rcp_can.bus import Bus, Route
from rcp_can.config_dronecan import EscOptions
from rcp_can.drive import Drive, Profile, Protection, Reach, StopFrame
from rcp_can.dronecan.commands import EscCommands
from rcp_can.dronecan.identity import identity_of
from rcp_can.dronecan.library import type_id
from rcp_can.dronecan.node_status import MODES, OFFLINE, OPERATIONAL, Uptime, health_fault
from rcp_can.dronecan.port import NODE_STATUS, Port
from rcp_can.dronecan.transfers import TRANSFER_IDS, Assembler, encode, message_route
from rcp_can.motor_messages import Mode
from rcp_kernel.errors import DeviceRejected, DeviceTimeout, ModeForbids
from rcp_kernel.spi import check_fence

if TYPE_CHECKING:
    import can

__all__ = ["PROFILE", "EscDrive"]

_STATUS = type_id("equipment.esc.Status")
_RPM = 2 * math.pi / 60  # rad/s
_FASTEST = 131_071  # rpm of a command
_FULL = 8191  # throttle of a command
_PERIODS = 2.5  # of the motor's rate, for which a set-point is repeated with those of others
_ZERO_CELSIUS = 273.15  # K
_WORDS = 3  # reports that must follow a zero until the motor counts as switched off
_WAITS = 1.0  # s for those, at least
_AGAIN = 0.05  # s between two zeros meanwhile
_GUARD = range(0, TRANSFER_IDS, 8)  # a receiver drops a transfer with the number of the one before


class EscDrive(Drive):
    """One controller. It has no enable state of its own: enabled means that set-points are sent.

    It stops the motor by itself some time after the last one.
    """

    holds = True
    places = False
    modes = frozenset[Mode](("velocity",))

    def __init__(self, node: int, options: EscOptions, bus: Bus) -> None:
        super().__init__(node, options, bus)
        self._port = bus.shared(Port, Port)
        self._commands = bus.shared(EscCommands, EscCommands)
        self._commands.join(options.index, options.control, arming=options.arming)
        self._assembler = Assembler((_STATUS, NODE_STATUS))
        self.reverses = options.reverse
        self._on = False
        self._uptime = Uptime()
        self._mode = OPERATIONAL
        self.protection = Protection(
            "the controller's own command time-out: it stops the motor, which coasts; cannot be "
            "read over DroneCAN",
            options.command_timeout,
        )

    @property
    def beats(self) -> float | None:
        """Return the time after which DroneCAN counts a node as offline, once it has a state."""
        return None if self._uptime.last is None else OFFLINE

    def period(self, signal: str) -> float:
        """Return the period of its reports."""
        return self.options.status_period

    def routes(self) -> tuple[Route, ...]:
        """Return its reports of speed, and its node's state."""
        return message_route(_STATUS, self.node), message_route(NODE_STATUS, self.node)

    def reach(self) -> Reach:
        """Return the fastest speed that a command can have."""
        return Reach(velocity=self.options.full_speed or _FASTEST * _RPM)

    def take(self, message: can.Message) -> bool:
        """Take one frame, and decode the transfer that it completes."""
        received = self._assembler.take(message)
        if received is None:
            return False
        if received.type_id == NODE_STATUS:
            self._take_state(received.payload, self.bus.received_at(message))
            return True
        if received.payload.esc_index != self.options.index:
            return False  # another of several controllers that are one node
        self._take_report(received.payload)
        return True

    def _take_state(self, state: Any, at: float) -> None:
        status = self.status
        status.beat = time.monotonic()
        if self._uptime.has_restarted(state.uptime_sec, at):
            status.resets += 1
            self._switch(on=False)
        self._mode = state.mode
        if self._mode != OPERATIONAL and self._on:  # it does not turn again without a new enable
            self._switch(on=False)
        fault = health_fault(state.health, state.vendor_specific_status_code)
        status.faults = () if fault is None else (fault,)
        status.reports += 1

    def _take_report(self, report: Any) -> None:
        status = self.status
        status.velocity = report.rpm * _RPM
        status.current, status.voltage = _known(report.current), _known(report.voltage)
        kelvin = _known(report.temperature)
        status.drive_temperature = kelvin - _ZERO_CELSIUS if kelvin else None
        status.enabled = self._on and self._mode == OPERATIONAL
        status.holding = self._on or report.rpm != 0  # another node may command it
        status.moved += 1
        status.reports += 1

    async def configure(self) -> None:
        """Ask what it is; a controller that does not tell can be driven all the same."""
        try:
            self.identity = await identity_of(self._port, self.node)
        except DeviceTimeout:
            self.identity = None

    async def enable(self) -> None:
        """Accept set-points, with zero commanded."""
        if self._mode != OPERATIONAL:
            raise ModeForbids(
                f"DroneCAN node {self.node} is not operational: {MODES[self._mode]}",
                remedy="Wait until it is operational, or restart it.",
            )
        self._switch(on=True)
        await self.until(lambda: bool(self.status.enabled), "heard")

    async def disable(self) -> None:
        """Send zeros, and no more set-points after them."""
        self._switch(on=False)
        # Fast controllers have reports under way that are older than the zero.
        enough, since = self.status.counts["enabled"] + _WORDS, time.monotonic() + _AGAIN
        await self.until(
            lambda: (
                self.status.counts["enabled"] >= enough
                and self.status.enabled is False
                and time.monotonic() >= since
            ),
            "heard",
            seconds=max(_WAITS, 2 * _WORDS * self.options.status_period),
            again=self.stop,
            every=_AGAIN,
            faults=False,
        )

    async def clear_faults(self) -> None:
        """Refuse: DroneCAN has no message for it.

        :raises DeviceRejected: always.
        """
        raise DeviceRejected(
            f"DroneCAN has no message that clears a fault of node {self.node}",
            remedy="Restart the node, by its service restart if it is in the table `dronecan`.",
        )

    def command(self, mode: Mode, value: float, velocity: float) -> None:
        """Send a speed, or the throttle that is in proportion to it."""
        check_fence()
        if not self.reverses:
            value = max(0.0, value)
        full = self.options.full_speed
        number = round(value / _RPM) if full is None else round(value / full * _FULL)
        self._commands.command(self.options.index, number, _PERIODS / self.rate)

    def stop(self) -> None:
        """Command zero: the motor coasts, or brakes as set in the controller."""
        self._commands.stop(self.options.index)

    def stop_frames(self) -> Sequence[StopFrame]:
        """Command zero to all controllers of the bus; one drive has the frames of all."""
        if self.options.index != min(self._commands.places):
            return ()
        zeros = self._commands.zeros()
        return [
            StopFrame(identifier, data, extended=True)
            for number in _GUARD
            for identifier, data in encode(
                zeros, source=self._port.node, transfer_id=number, priority=0
            )
        ]

    def _switch(self, *, on: bool) -> None:
        self._on = on
        self._commands.switch(self.options.index, on=on)


def _known(value: float) -> float | None:
    """Return a measurement, or None for one that the controller does not have."""
    return value if math.isfinite(value) else None


PROFILE = Profile(
    "dronecan",
    "Speed controllers on DroneCAN.",
    EscOptions,
    EscDrive,
    "rcp_can.sim.dronecan:DronecanTwin",
    range(1, 128),
)
