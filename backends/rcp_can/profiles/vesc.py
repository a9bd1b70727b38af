"""VESC: 29-bit identifiers, command << 8 | id, big-endian; it sends its state periodically."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncGenerator, Sequence
from contextlib import asynccontextmanager, suppress
from typing import TYPE_CHECKING, Annotated

import anyio
from msgspec import Meta, Struct

from rcp_can.asking import answer_to
from rcp_can.bus import Bus, Route
from rcp_can.codec import Field, Layout
from rcp_can.drive import KEPT, Drive, Profile, Protection, StopFrame
from rcp_can.motor_messages import Mode
from rcp_can.node_change import node_procedure
from rcp_can.procedure import Procedure
from rcp_can.profiles.vesc_detection import (
    ALIVE,
    LONGEST,
    PRINT,
    REBOOT,
    detection_procedure,
    put_back,
)
from rcp_can.profiles.vesc_packets import PING, PONG, SHORT, Assembler, frames
from rcp_can.profiles.vesc_settings import VescSettings, change_node, read_version
from rcp_can.settings_procedures import settings_procedures
from rcp_kernel.errors import DeviceRejected, DeviceTimeout, RcpError
from rcp_kernel.spi import check_fence

if TYPE_CHECKING:
    import can

__all__ = ["MESSAGES", "PROFILE", "VescDrive", "VescOptions"]

_FAST = 0.05  # s: a set-point older than this is not worth sending
_PERIOD = 0.05  # s: the slowest useful status messages, 20 Hz
_TIMEOUT = 1.0  # s: default timeout of the VESC application
_ANSWERS = 0.5  # s
_PROBED = 0.3  # s for another drive to answer
_REBOOTS = 5.0  # s within which it has rebooted
_ASKED = 0.2  # s between two questions whether it has
_PLACES = 1.0  # s within which it sends its position again
_TURN = 4.0  # s for others' requests: storing may take 3 s
NODES = range(255)
_STEPS = 6  # tachometer steps per electrical turn
_WRAP = 1 << 31  # steps at which its counter wraps around
_FASTER = 3  # times its reported speed, and a turn, that it may have turned on between two counts

MESSAGES: dict[str, tuple[int, Layout]] = {
    "duty": (0, Layout(">", Field("duty", "i", 1e-5))),
    "current": (1, Layout(">", Field("current", "i", 1e-3))),
    "brake": (2, Layout(">", Field("current", "i", 1e-3))),
    "rpm": (3, Layout(">", Field("erpm", "i"))),
    "position": (4, Layout(">", Field("degrees", "i", 1e-6))),
    "status": (
        9,
        Layout(">", Field("erpm", "i"), Field("current", "h", 0.1), Field("duty", "h", 1e-3)),
    ),
    "status_2": (14, Layout(">", Field("used", "i", 1e-4), Field("charged", "i", 1e-4))),
    "status_3": (15, Layout(">", Field("used", "i", 1e-4), Field("charged", "i", 1e-4))),
    "status_4": (
        16,
        Layout(
            ">",
            *(Field("drive", "h", 0.1), Field("motor", "h", 0.1)),
            *(Field("input", "h", 0.1), Field("position", "h", 0.02)),
        ),
    ),
    "status_5": (27, Layout(">", Field("tachometer", "i"), Field("voltage", "h", 0.1))),
    "status_6": (
        58,
        Layout(">", *(Field(name, "h", 1e-3) for name in ("adc1", "adc2", "adc3", "ppm"))),
    ),
}
"""Command and payload of each message."""


class VescOptions(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Motor constants: the VESC counts electrical turns and does not know torque."""

    pole_pairs: Annotated[int, Meta(ge=1, le=200)] = 7
    torque_constant: Annotated[float, Meta(gt=0)] = 0.05
    """N·m/A."""
    brake_current: Annotated[float, Meta(gt=0, le=1000)] = 10.0
    """Current of a quick stop, A."""
    host: Annotated[int, Meta(ge=0, le=254)] = 254
    """Id to which the drive answers packets, that no drive has."""


class _OneAtATime:
    """Requests to the drives of a bus: two that answer at once send the same identifiers, and collide."""

    def __init__(self, _bus: Bus) -> None:
        self._lock = asyncio.Lock()
        self._holder = ""

    @asynccontextmanager
    async def turn(self, node: int, what: str) -> AsyncGenerator[None]:
        """Wait until no other request runs.

        :raises DeviceTimeout: one runs too long, as a detection does.
        """
        try:
            with anyio.fail_after(_TURN):
                await self._lock.acquire()
        except TimeoutError:
            raise DeviceTimeout(
                f"node {node} was asked nothing: the {self._holder} still runs on this bus",
                remedy="Try again when that has ended, or end it.",
            ) from None
        self._holder = f"{what} of node {node}"
        try:
            yield
        finally:
            self._lock.release()


class VescDrive(Drive):
    """A VESC, which has no enable state of its own: enabled means that set-points are sent.

    It releases the motor a second after the last one, unless VESC Tool has set another time.
    """

    holds = True
    modes = frozenset[Mode](("velocity", "torque"))

    def __init__(self, node: int, options: VescOptions, bus: Bus) -> None:
        super().__init__(node, options, bus)
        if node == options.host:
            raise ValueError(f"`host` is the gateway's own id, and node {node} that of the drive")
        self._on = False
        self.pole_pairs = options.pole_pairs
        self._detecting = self._ending = False
        """Whether it detects its motor, as far as is known; whether it is to end that."""
        self._unplaced = False
        """Whether a detection may have ended its reports of position."""
        self._rebooted = self._asked = -math.inf
        self._tachometer: tuple[int, float] | None = None
        """Its last count, and when that was received."""
        self.application: bytes | None = None
        self._requests = bus.shared(_OneAtATime, _OneAtATime)
        self.protection = Protection(
            "the application timeout, 1 s unless configured otherwise in VESC Tool: it "
            "releases the motor, which coasts; cannot be read over CAN",
            _TIMEOUT,
        )
        self._read = {
            MESSAGES[name][0]: (MESSAGES[name][1], getattr(self, f"_on_{name}"))
            for name in ("status", "status_4", "status_5")
        }
        self._per_erpm = 2 * math.pi / 60 / options.pole_pairs

    def procedures(self, gear: float, velocity: float) -> Sequence[Procedure]:
        """Offer its limits, another id, and detection of its motor."""
        return (
            *detection_procedure(self),
            *settings_procedures(VescSettings(self)),
            node_procedure(
                self.node,
                NODES,
                {**self.neighbours, self.options.host: "the gateway"},
                lambda wanted, begun: change_node(self, wanted, begun),
                self._is_there,
            ),
        )

    async def configure(self) -> None:
        """Ask what it is, which some firmware does not tell; undo what a detection left that was stopped."""
        if self._detecting:
            await self.settled()
        await put_back(self)
        self._unplaced = False
        with suppress(DeviceTimeout, DeviceRejected):
            self.identity = await read_version(self)

    async def ask(
        self,
        payload: bytes,
        *,
        node: int | None = None,
        seconds: float = _ANSWERS,
        once: bool = False,
    ) -> bytes:
        """Return the answer to a command, from this drive or another id of it; it may send it again.

        :raises DeviceTimeout: there is none.
        """
        async with self._requests.turn(self.node, "request"):
            return await self._ask(payload, node=node, seconds=seconds, once=once)

    async def _ask(
        self, payload: bytes, *, node: int | None = None, seconds: float, once: bool
    ) -> bytes:
        host, joined = self.options.host, Assembler()
        to = self.node if node is None or once else node
        found: list[bytes] = []

        def matches(message: can.Message) -> bool:
            packet = joined.take(message.arbitration_id >> 8, bytes(message.data))
            if packet is not None and packet[0] in (to, node) and packet[1][0] == payload[0]:
                found.append(packet[1])
            return bool(found)

        def send() -> None:
            check_fence()
            parts = frames(payload, to=to, sender=host)
            self.bus.send_together(parts, lifetime=KEPT, sender=self)

        route = Route(host, 0xFF, extended=True)
        await answer_to(self.bus, (route,), send, matches, seconds=seconds, once=once)
        if not found:
            raise DeviceTimeout(
                f"node {to}: no answer to command {payload[0]} within {seconds:g} s"
            )
        return found[0]

    async def _is_there(self, node: int) -> bool:
        """Return whether a drive answers to an id."""
        host = self.options.host

        def ping() -> None:
            self.send(PING << 8 | node, bytes((host,)), extended=True, lifetime=_FAST)

        def pong(message: can.Message) -> bool:
            return message.data[:1] == bytes((node,))

        route = Route(PONG << 8 | host, 0x1FFFFFFF, extended=True)
        return await answer_to(self.bus, (route,), ping, pong, seconds=_PROBED) is not None

    @property
    def busy(self) -> bool:
        """Whether it detects its motor, or is not known to have ended that."""
        return self._detecting

    async def detect(self, request: bytes, seconds: float) -> bytes:
        """Return the answer to a detection; if there is none, the drive is made to reboot.

        :raises DeviceTimeout: it does not answer within `seconds`.
        """
        async with self._requests.turn(self.node, "detection"):
            check_fence()
            self._detecting = self._unplaced = self.status.enabled = True
            try:
                answer = await self._ask(request, seconds=seconds, once=True)
            except BaseException:
                self._ending = True
                with suppress(RcpError):  # `poll` tries again
                    self._end_detection()
                raise
            self._detecting = False
        return answer

    async def restore(self) -> None:
        """Put back what a detection changed; return when it sends its position again, if it ever did.

        However else that ends, the motor is configured again, which no stop of a request ends.
        """
        status = self.status
        seen = status.counts["position"]
        try:
            await put_back(self)
            if seen:
                with suppress(DeviceTimeout):  # the motor tells, if it needs the position
                    await self.until(
                        lambda: status.counts["position"] > seen,
                        "seen to send its position",
                        seconds=_PLACES,
                    )
        except BaseException:
            status.reset = "the status messages that its detection changed are put back"
            status.resets += 1
            raise
        self._unplaced = False

    def _end_detection(self) -> None:
        """Let it reboot, and ask whether it has: nothing else ends a detection."""
        now, host = time.monotonic(), self.options.host
        if now - self._rebooted > _REBOOTS:
            for identifier, data in frames(bytes((REBOOT,)), to=self.node, sender=host):
                self.send(identifier, data, extended=True, urgent=True)
            self._rebooted = self._asked = now
        elif now - self._asked > _ASKED:
            self._asked = now
            for identifier, data in frames(ALIVE, to=self.node, sender=host):
                self.bus.send(identifier, data, extended=True, lifetime=_FAST, sender=self)

    def _is_alive(self, message: can.Message) -> bool:
        """Take the answer to that question, which comes if no detection runs."""
        data = bytes(message.data)
        if data[:1] != bytes((self.node,)) or data[2:3] != bytes((PRINT,)):
            return False
        if self._ending and data[3:].startswith(b"pong"):
            self._detecting = self._ending = False
            self._rebooted = -math.inf
            self.status.reset = "the drive rebooted"
            self.status.resets += 1
        return True

    async def settled(self) -> None:
        """Wait until a detection that was stopped has ended."""
        await self.until(lambda: not self._detecting, "seen to reboot", seconds=2 * _REBOOTS)

    def poll(self, tick: int) -> None:
        """See to the end of a detection that was stopped."""
        if self._ending:
            self._end_detection()

    def period(self, signal: str) -> float:
        """Return the period of its status messages."""
        return _PERIOD

    def pause(self, signal: str) -> float:
        """Allow for no position from the beginning of a detection until its status messages are back.

        Until then, the motor cannot be enabled: it counts as used, or as not configured.
        """
        return LONGEST if self._unplaced and signal == "position" else 0.0

    def routes(self) -> tuple[Route, ...]:
        """Return all its identifiers, and that of short answers to the gateway."""
        answers = Route(SHORT << 8 | self.options.host, 0x1FFFFFFF, extended=True)
        return (Route(self.node, 0xFF, extended=True), answers)

    def take(self, message: can.Message) -> bool:
        """Decode one frame."""
        known = self._read.get(message.arbitration_id >> 8)
        if known is None:
            return message.arbitration_id & 0xFF == self.options.host and self._is_alive(message)
        layout, handler = known
        handler(**layout.decode(message.data))
        self.status.enabled = self._on or self._detecting
        self.status.reports += 1
        return True

    def _on_status(self, erpm: float, current: float, duty: float) -> None:
        status = self.status
        status.velocity = erpm * self._per_erpm
        status.current = current
        status.torque = current * self.options.torque_constant
        status.moved += 1

    def _on_status_4(self, drive: float, motor: float, input: float, position: float) -> None:  # noqa: A002
        self.status.drive_temperature, self.status.motor_temperature = drive, motor

    def _on_status_5(self, tachometer: float, voltage: float) -> None:
        self._look_for_a_boot(int(tachometer))
        self.status.position = tachometer / (_STEPS * self.options.pole_pairs) * 2 * math.pi
        self.status.voltage = voltage
        self.status.moved += 1

    def lose(self) -> None:
        """Forget its count: how far it has turned since then is not known."""
        self._tachometer = None

    def _look_for_a_boot(self, tachometer: int) -> None:
        """Detect a reboot by its counter, which begins at 0: set-points would turn it again at once."""
        status, before = self.status, self._tachometer
        now = time.monotonic() if status.frame_at is None else status.frame_at
        self._tachometer = tachometer, now
        if before is None or self._detecting:
            return
        turned = (tachometer - before[0] + _WRAP) % (2 * _WRAP) - _WRAP
        gap, velocity = max(now - before[1], _PERIOD), status.velocity or 0.0
        faster = _FASTER if turned * velocity > 0 else 1
        most = 1 + faster * abs(velocity) * gap / (2 * math.pi)  # turns
        if abs(turned) > most * _STEPS * self.pole_pairs:
            self._on = status.enabled = False
            status.resets, status.reset = status.resets + 1, "the drive rebooted"

    def _transmit(self, name: str, *, urgent: bool = False, **values: float) -> None:
        command, layout = MESSAGES[name]
        self.send(
            command << 8 | self.node,
            layout.encode(**values),
            extended=True,
            urgent=urgent,
            lifetime=None if urgent else _FAST,
        )

    async def enable(self) -> None:
        """Accept set-points, with the motor released."""
        self._transmit("current")
        self._on = True
        await self.until(lambda: bool(self.status.enabled), "heard")

    async def disable(self) -> None:
        """Release the motor."""
        self._on = False
        self._transmit("current", urgent=True)
        await self.until(lambda: self.status.enabled is False, "heard", faults=False)

    async def clear_faults(self) -> None:
        """Do nothing: a VESC clears its faults by itself, and these messages report none."""

    def command(self, mode: Mode, value: float, velocity: float) -> None:
        """Send a set-point."""
        if mode == "velocity":
            self._transmit("rpm", erpm=value / self._per_erpm)
        else:
            self._transmit("current", current=value / self.options.torque_constant)

    def stop(self) -> None:
        """Brake with the configured current, or end a detection, which heeds no brake."""
        if self._detecting:
            self._ending = True
            self._end_detection()
            return
        self._transmit("brake", urgent=True, current=self.options.brake_current)

    def stop_frames(self) -> Sequence[StopFrame]:
        """Brake: a braking current does not move a motor at rest."""
        command, layout = MESSAGES["brake"]
        data = layout.encode(current=self.options.brake_current)
        return (StopFrame(command << 8 | self.node, data, extended=True),)


PROFILE = Profile(
    "vesc",
    "VESC speed controllers.",
    VescOptions,
    VescDrive,
    "rcp_can.sim.vesc:VescTwin",
    NODES,
)
