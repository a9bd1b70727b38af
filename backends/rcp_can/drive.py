"""The interface of a drive profile: one drive on the bus, in its own units at its own shaft.

A profile only translates. Limits, ramps, dead-man, gear and direction, fault events, time-outs and
commands are the same for all drives and live in `Axis` and `MotorPart`.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from rcp_can.bus import Bus, Route
from rcp_can.motor_messages import Mode
from rcp_can.procedure import Procedure
from rcp_can.status import Fault, Status
from rcp_kernel.errors import DeviceRejected, DeviceTimeout
from rcp_kernel.spi import check_fence

if TYPE_CHECKING:
    import can

    from rcp_can.sdo import Sdo

__all__ = [
    "KEPT",
    "Drive",
    "Fault",
    "Identity",
    "Profile",
    "Protection",
    "Reach",
    "Status",
    "StopFrame",
]

_ANSWER = 1.0  # s within which a drive must reach a requested state
_AGAIN = 0.1  # s between two requests
_LATE = 0.1  # s by which the event loop may wake late without having been held up
_AT_ZERO = 0.01  # rad at the shaft
_UNDER_WAY = 1  # reports that may have left the drive before a request reached it
KEPT = 1.0  # s a command may wait to be sent: by then, whoever asked for it has been told otherwise


class Reach(NamedTuple):
    """The largest values that the profile can express, at the drive's shaft."""

    position: float = 1e6
    velocity: float = 1e5
    torque: float = 1e5


class Protection(NamedTuple):
    """The mechanism that stops a drive when the gateway stops sending."""

    mechanism: str
    within: float | None = None
    """Seconds of silence until it acts; None: nothing does."""
    verified: bool = False
    """Whether the setting was read back from the drive."""


class Identity(NamedTuple):
    """What a drive is, as it reports itself; None: it does not say."""

    vendor: str | None = None
    model: str | None = None
    firmware: str | None = None
    serial: str | None = None


class StopFrame(NamedTuple):
    """A frame that stops a drive, whichever node sends it."""

    identifier: int
    data: bytes
    extended: bool = False
    fd: bool = False
    switched: bool = False


class Drive(ABC):
    """One drive; each profile has a subclass."""

    modes: frozenset[Mode] = frozenset(("position", "velocity", "torque"))
    moves = False
    """Whether it generates its own position trajectory and reports the target reached."""
    homes = False
    zeroes = False
    """Whether the current position can be set as zero."""
    holds = False
    """Whether set-points must be sent from the moment it is enabled."""

    places = True
    """Whether it reports the position of its shaft."""
    reverses = True
    """Whether its shaft can be commanded to turn backwards."""
    sags = False
    """Whether a joint under load sinks at velocity zero, so that only its position holds it."""
    offsets = False
    """Whether it adds `torque_offset` to what its position and velocity loops command."""
    torque_offset: float | None = None
    """Torque that is fed forward with a set-point, N·m at the shaft; None: none is wanted."""
    rate: float = 50.0
    """Set-points per second."""
    watchdog: float | None = 0.5
    """Time-out in s of the drive's own watchdog; None keeps its setting."""
    neighbours: Mapping[int, str] = {}
    """The other motors of its profile or family on its bus: their names by node."""

    def __init__(self, node: int, options: Any, bus: Bus) -> None:
        self.node, self.options, self.bus = node, options, bus
        self.status = Status()
        self.protection = Protection("none known")
        """The mechanism that stops the drive without the gateway, as far as known."""
        self.identity: Identity | None = None
        """What it is; None: not read, or the profile has no such report."""
        self._waiters: list[tuple[Callable[[], bool], asyncio.Future[None]]] = []

    @property
    def beats(self) -> float | None:
        """Maximum time in s between its heartbeats; None if it sends none, or none yet."""
        return None

    def period(self, signal: str) -> float | None:
        """Return the period of a signal in s; None if it must be polled."""
        return None

    def pause(self, signal: str) -> float:
        """Return how long a procedure of its own may keep it from sending a signal now, s."""
        return 0.0

    @property
    def loose(self) -> bool:
        """Whether a set-point from another master would move it after a stop."""
        return False

    @property
    def busy(self) -> bool:
        """Whether it runs a procedure of its own, which may move it at any moment."""
        return False

    async def settled(self) -> None:  # noqa: B027 - most drives leave a procedure while they answer
        """Wait until a procedure of its own that was stopped has ended, if the drive is silent meanwhile.

        :raises DeviceTimeout: it does not end.
        """

    def procedures(self, gear: float, velocity: float) -> Sequence[Procedure]:
        """List what sets up this make of drive.

        `gear` is turns of its shaft per turn of the joint, `velocity` the limit of the joint in rad/s.
        """
        return ()

    @property
    def server(self) -> Sdo | None:
        """The SDO client of the drive, if it has one."""
        return None

    @abstractmethod
    def routes(self) -> tuple[Route, ...]:
        """Return the identifiers of this drive's frames."""

    @abstractmethod
    def take(self, message: can.Message) -> bool:
        """Decode one frame into `status`; return whether it belongs to this drive.

        :raises ValueError: the drive must not send such a frame.
        """

    def send(
        self,
        identifier: int,
        data: bytes = b"",
        *,
        lifetime: float | None = None,
        urgent: bool = False,
        **flags: Any,
    ) -> None:
        """Queue a frame to the drive; `lifetime`, `urgent` and the flags are those of `Bus.send`.

        What is not urgent always has a lifetime, so that it never follows a stop.

        :raises AdapterUnavailable: the bus is down, or off.
        :raises QueueFull: the send queue is full.
        :raises EstopActive: it belongs to a request that was cancelled by a stop.
        """
        if not urgent:  # urgent frames stop the drive
            check_fence()
            lifetime = KEPT if lifetime is None else lifetime
        self.bus.send(identifier, data, lifetime=lifetime, urgent=urgent, sender=self, **flags)

    def reach(self) -> Reach:
        """Return the limits of the profile."""
        return Reach()

    async def configure(self) -> None:  # noqa: B027 - most drives need nothing
        """Configure the drive, after its first message and after each boot."""

    def poll(self, tick: int) -> None:  # noqa: B027 - most drives need nothing
        """Request what the drive does not send by itself; called at the motor's rate.

        Must not move the drive.
        """

    def lose(self) -> None:  # noqa: B027 - most drives compare nothing
        """Forget what the next report would be compared with: none came for too long."""

    @abstractmethod
    async def enable(self) -> None:
        """Switch the power stage on, at rest; return when the drive reports it."""

    @abstractmethod
    async def disable(self) -> None:
        """Switch the power stage off; return when the drive reports it."""

    @abstractmethod
    async def clear_faults(self) -> None:
        """Reset the faults without switching on or off; return when the drive reports none.

        Called only while `status.faults` is not empty.
        """

    async def home(self, begun: Callable[[], object]) -> None:
        """Home the drive, if it `homes`; return when the drive reports that it is done.

        `begun` is to be called once the drive may move: a failure from then on is no refusal.
        """
        raise NotImplementedError

    async def set_zero(self) -> None:
        """Set the current position as zero, if it `zeroes`; return when its reports show it."""
        raise NotImplementedError

    @abstractmethod
    def command(self, mode: Mode, value: float, velocity: float) -> None:
        """Send a set-point; `velocity` is that of the ramp in mode position, for feed-forward."""

    async def move(self, position: float, velocity: float, acceleration: float | None) -> None:
        """Start a move along the drive's own trajectory, if it `moves`."""
        raise NotImplementedError

    @abstractmethod
    def stop(self) -> None:
        """Brake as hard as the drive can, ahead of every queue; repeated until it is at rest.

        Must not switch on a drive that is off.
        """

    def stop_frames(self) -> Sequence[StopFrame]:
        """List frames that stop it in any state and never switch it on."""
        return ()

    async def until_zero(self, request: Callable[[], object], what: str = "at zero") -> None:
        """Send a request for a new zero until reports from after it show the shaft there.

        :raises DeviceTimeout: they do not.
        :raises DeviceRejected: the drive enters fault instead.
        """
        counts = self.status.counts
        before = counts["position"] + _UNDER_WAY

        def shown() -> bool:
            position = self.status.position
            fresh = counts["position"] > before
            return fresh and position is not None and abs(position) <= _AT_ZERO

        await self.until(shown, what, again=request)

    def wake_waiters(self) -> None:
        """Wake tasks that wait for the status; called after each batch of frames."""
        if self._waiters:
            for holds, future in self._waiters:
                if not future.done() and holds():
                    future.set_result(None)
            self._waiters = [waiter for waiter in self._waiters if not waiter[1].done()]

    async def until(
        self,
        holds: Callable[[], bool],
        what: str,
        *,
        seconds: float = _ANSWER,
        again: Callable[[], object] | None = None,
        every: float = _AGAIN,
        faults: bool = True,
    ) -> None:
        """Wait until `holds` returns true; `again` sends the request, now and every `every` s.

        Time in which the event loop was held up is not counted: no drive could be heard then.

        :raises DeviceTimeout: the status does not appear within `seconds`.
        :raises DeviceRejected: the drive enters fault instead.
        """
        old = self.status.faults if faults else ()

        def done() -> bool:
            return holds() or (faults and bool(set(self.status.faults) - set(old)))

        loop = asyncio.get_running_loop()
        end = loop.time() + seconds
        while True:
            if again is not None:
                again()
            future = loop.create_future()
            self._waiters.append((done, future))
            self.wake_waiters()
            left = end - loop.time()
            pause = max(0.0, min(every, left) if again is not None else left)
            due = loop.time() + pause
            await asyncio.wait((future,), timeout=pause)
            future.cancel()
            if (late := loop.time() - due) > _LATE:
                end += late
            if holds():
                return
            if faults and (new := set(self.status.faults) - set(old)):
                raise DeviceRejected("; ".join(fault.text for fault in new))
            if loop.time() >= end:
                raise DeviceTimeout(
                    f"node {self.node}: not {what} within {seconds:g} s",
                    remedy="Check sensor/…/state and event/…/fault of the motor; clear its faults.",
                )


class Profile(NamedTuple):
    """A drive type: its options, driver and simulation."""

    name: str
    description: str
    options: Any
    """Struct type of the motor's `options`."""
    drive: type[Drive]
    twin: str
    """Module and class of its twin, imported on demand: `rcp_can.sim.odrive:ODriveTwin`."""
    nodes: range
    """The valid node ids."""
    fd: bool = False
    """Whether it requires CAN FD."""
    family: str = ""
    """Shared by profiles whose drives take each other's set-points if they have the same id."""
