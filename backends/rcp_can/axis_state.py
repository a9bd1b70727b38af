"""The state of one motor: drive, limits, last command, last reports."""

from __future__ import annotations

import asyncio
import time
from typing import NamedTuple

from rcp_can import motor_messages as m
from rcp_can.bus import Bus
from rcp_can.config_motor import MotorConfig
from rcp_can.drive import Drive
from rcp_can.faultbook import FaultBook
from rcp_can.gravity import Gravity
from rcp_can.ramp import Ramp
from rcp_can.send_delay import SendDelay
from rcp_kernel.spi import Host

__all__ = ["AxisState", "Loss"]

_RESTING = 0.02  # rad/s at the drive's shaft that counts as rest, whatever the configured tolerance
_MISSED = 5  # consecutive reports: two of three may be lost on the bus
_SHORTEST = 0.25  # s: the gateway's own loop may be late by a fraction of this


class Loss(NamedTuple):
    """The reason why a drive counts as lost."""

    fault: str
    text: str


class AxisState:
    """A motor's state, used by checks, views and set-points."""

    def __init__(self, name: str, config: MotorConfig, drive: Drive, bus: Bus, host: Host) -> None:
        self.name, self.config, self.drive, self.bus = name, config, drive, bus
        self.status = drive.status
        reach, gear = drive.reach(), config.gear
        self.ratio = gear * config.direction
        self.velocity_limit = min(config.velocity, reach.velocity / gear)
        self.torque_limit = min(config.torque, reach.torque * gear)
        low, high = config.position or (-reach.position / gear, reach.position / gear)
        span = reach.position / gear
        self.low, self.high = max(low, -span), min(high, span)
        self.gravity = Gravity(config.gravity) if config.gravity else None
        self.ramp = Ramp(self.velocity_limit, config.acceleration)
        self.send_delay = SendDelay()
        self.mode: m.Mode | None = None
        self.goal = 0.0
        self.online = self.stopping = self.enabling = False
        """Whether messages are received; whether a quick stop is unconfirmed; whether the motor
        is being
        enabled."""
        self.blind: Loss | None = None
        """The required signal that is too old although the drive still sends; None if all are
        fresh."""
        self.signals = _signals(config, drive)
        """The signals that control requires."""
        self.last_message_at = self.configured_at = 0.0
        """Monotonic time of the last message, s."""
        self.stop_began: float | None = None
        self.faults = FaultBook(name, host)
        self.configured = False
        """Whether the drive has been configured since its last boot or reconnection."""
        self.configuring: asyncio.Task[None] | None = None

    @property
    def position(self) -> float | None:
        """Position of the joint, rad."""
        raw = self.status.position
        return None if raw is None else raw / self.ratio + self.config.offset

    @property
    def velocity(self) -> float | None:
        """Velocity of the joint, rad/s."""
        raw = self.status.velocity
        return None if raw is None else raw / self.ratio

    @property
    def velocities(self) -> tuple[float, float]:
        """The lowest and the highest velocity that can be commanded, rad/s."""
        if self.drive.reverses:
            return -self.velocity_limit, self.velocity_limit
        return (0.0, self.velocity_limit) if self.ratio > 0 else (-self.velocity_limit, 0.0)

    @property
    def state(self) -> m.State:
        """The state as the wire reports it."""
        if not self.online:
            return "offline"
        if self.blind is not None:
            return "no_feedback"
        broken = self.faults.get("configuration") is not None
        if broken or (self.status.faults and not self.status.enabled):
            return "fault"
        if self.stopping and self.status.energised is not False:
            return "stopping"
        if self.status.enabled:
            return "enabled"
        return "quick_stop" if self.status.energised else "disabled"

    @property
    def met(self) -> bool:
        """Whether the drive has ever sent a message."""
        return self.last_message_at > 0.0

    def is_fresh(self, signal: str) -> bool:
        """Tell whether a signal is recent enough to use."""
        at = self.status.at.get(signal)
        return at is not None and time.monotonic() - at <= self.limit_of(signal)

    def limit_of(self, signal: str) -> float:
        """Return the age in s beyond which a signal is stale."""
        limit = self.config.feedback_timeout
        if limit is None:
            limit = max(_MISSED * (self.drive.period(signal) or 1 / self.config.rate), _SHORTEST)
        return max(limit, self.drive.pause(signal))

    @property
    def slow(self) -> bool:
        """Whether the last report shows standstill, and no procedure of the drive may end it."""
        velocity = self.status.velocity
        return (
            velocity is not None
            and not self.drive.busy
            and abs(velocity) <= max(_RESTING, self.config.standstill * self.config.gear)
        )

    @property
    def resting(self) -> bool:
        """Whether fresh feedback shows standstill."""
        return self.online and self.slow and self.is_fresh("velocity")

    @property
    def driven(self) -> bool:
        """Whether a set-point other than rest is in force."""
        return self.mode is not None and (self.mode == "position" or self.goal != 0.0)

    @property
    def stopped(self) -> bool:
        """Whether a quick stop is in force and no command has followed it."""
        return self.stop_began is not None

    @property
    def secure(self) -> bool:
        """Whether the motor is at rest without torque, and nothing pending could change that."""
        return (
            self.resting
            and self.is_fresh("enabled")
            and self.status.energised is False
            and not (self.enabling or self.stopping or self.mode is not None)
        )


def _signals(config: MotorConfig, drive: Drive) -> tuple[str, ...]:
    """Return the signals that control requires; position only if it is used."""
    placed = "position" in drive.modes or config.position is not None
    return ("position", "velocity", "enabled") if placed else ("velocity", "enabled")
