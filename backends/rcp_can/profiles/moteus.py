"""mjbots moteus on CAN FD: id = reply flag << 15 | source << 8 | destination."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

from msgspec import Meta, Struct

from rcp_can.asking import answer_to
from rcp_can.bus import Bus, Route
from rcp_can.drive import KEPT, Drive, Fault, Identity, Profile, Protection
from rcp_can.motor_messages import Mode as MotorMode
from rcp_can.node_change import node_procedure
from rcp_can.procedure import Procedure
from rcp_can.profiles.moteus_settings import MoteusSettings, change_node
from rcp_can.profiles.moteus_stream import FROM_DRIVE, Stream, content
from rcp_can.profiles.moteus_wire import REGISTERS, Access, Kind, Mode, Width, build, pad, parse
from rcp_can.settings_procedures import settings_procedures
from rcp_kernel.spi import check_fence

if TYPE_CHECKING:
    import can

__all__ = ["PROFILE", "MoteusDrive", "MoteusOptions"]

TURN = 2 * math.pi  # rad: moteus counts turns
_FAST = 0.05  # s: a set-point older than this is not worth sending
_QUERIED = (
    *(("mode", Width.INT8), ("position", Width.FLOAT), ("velocity", Width.FLOAT)),
    *(("torque", Width.FLOAT), ("q_current", Width.FLOAT), ("motor_temperature", Width.INT16)),
    *(("trajectory_complete", Width.INT8), ("voltage", Width.INT16)),
    *(("temperature", Width.INT16), ("fault", Width.INT8)),
    *(("watchdog", Width.FLOAT), ("milliseconds", Width.INT32)),
)
_QUERY = build(Access(Kind.READ, REGISTERS[name].number, width) for name, width in _QUERIED)
_STILL = {"command_position": math.nan, "command_velocity": 0.0}
"""Hold velocity zero at the current position."""
_NAMES = {register.number: name for name, register in REGISTERS.items()}
_ON = frozenset((Mode.POSITION, Mode.ZERO_VELOCITY, Mode.BRAKE, 13, 14))
_OWN_TIMEOUT = 0.1  # s: factory setting of servo.default_timeout_s
_OWN = "servo.default_timeout_s, 0.1 s unless configured otherwise: zero velocity, damped"
_WRAPS = 2**31 - 60_000  # ms: near its end the clock may wrap around
_UNDER_WAY = 64  # requests that may have been lost, or wait to be sent
_TOO_MANY = 4  # unsolicited responses
_STRAY = 0.5  # s after a reboot in which an earlier set-point may still arrive
_PROBED = 0.3  # s for a drive to answer
_IDENTITY = "model", "firmware", "serial_1", "serial_2", "serial_3"
NODES = range(1, 127)

_FAULTS = {
    32: "calibration",
    33: "driver fault",
    34: "over-voltage",
    35: "encoder",
    36: "not configured",
    37: "PWM cycle overrun",
    38: "over-temperature",
    39: "outside its limits",
    40: "under-voltage",
    41: "configuration changed",
    42: "theta invalid",
    43: "position invalid",
    44: "driver enable",
    46: "timing violation",
}


class MoteusOptions(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The gateway's id, and the drive's own limits."""

    source: Annotated[int, Meta(ge=0, le=127)] = 0
    """Id of the gateway."""
    max_torque: Annotated[float, Meta(gt=0)] | None = None
    """N·m at the drive's shaft."""
    switched: bool = True
    """Send the data phase at its own bit rate."""


class MoteusDrive(Drive):
    """A moteus controller."""

    moves = True
    zeroes = True
    holds = True

    def __init__(self, node: int, options: MoteusOptions, bus: Bus) -> None:
        super().__init__(node, options, bus)
        self._mode = 0
        self._spoken = self._moving = False
        self._owed = 0
        self._target: dict[str, float] = {}
        self.protection = Protection(_OWN, _OWN_TIMEOUT)
        self._clock = math.nan
        self._rebooted_at = -math.inf
        self._stream = Stream(bus, options.source, self._send_text)

    def procedures(self, gear: float, velocity: float) -> Sequence[Procedure]:
        """Offer its configuration, and another id."""
        return (
            *settings_procedures(MoteusSettings(self._stream, self.node)),
            node_procedure(
                self.node,
                NODES,
                self.neighbours,
                lambda wanted, begun: change_node(self._stream, self.node, wanted, begun),
                self._is_there,
                note=" All other settings are stored with it.",
            ),
        )

    def _send_text(self, node: int, payloads: Sequence[bytes], answers: bool) -> None:  # noqa: FBT001 - of Stream
        check_fence()
        if answers and node == self.node:
            self._owed = min(self._owed + 1, _UNDER_WAY)
        head = answers << 15 | self.options.source << 8 | node
        self.bus.send_together(
            [(head, pad(payload)) for payload in payloads],
            fd=True,
            switched=self.options.switched,
            lifetime=KEPT,
            sender=self,
        )

    def _send_to(self, node: int, payload: bytes, *, answers: bool, **more: Any) -> None:
        self.send(
            answers << 15 | self.options.source << 8 | node,
            pad(payload),
            extended=True,
            fd=True,
            switched=self.options.switched,
            **more,
        )

    async def _is_there(self, node: int) -> bool:
        return await self._told(node, ("mode",)) is not None

    async def _told(self, node: int, names: Sequence[str]) -> dict[str, float] | None:
        """Return registers of whichever drive has an id; None if none answers."""
        query = build(Access(Kind.READ, REGISTERS[name].number, Width.INT32) for name in names)
        wanted = {REGISTERS[name].number: name for name in names}
        found: dict[str, float] = {}

        def ask() -> None:
            if node == self.node:
                self._owed = min(self._owed + 1, _UNDER_WAY)
            self._send_to(node, query, answers=True, lifetime=_FAST)

        def matches(message: can.Message) -> bool:
            if message.data[:1] == bytes((FROM_DRIVE,)):
                return False
            for access in parse(bytes(message.data)):
                if access.register in wanted and access.value is not None:
                    found[wanted[access.register]] = access.value
            return len(found) == len(names)

        value = node << 8 | self.options.source
        routes = [Route(value, 0x7FFF, extended=extended) for extended in (True, False)]
        answer = await answer_to(self.bus, routes, ask, matches, seconds=_PROBED)
        return None if answer is None else found

    async def configure(self) -> None:
        """Ask what it is; older firmware does not tell."""
        told = await self._told(self.node, _IDENTITY)
        if told is None:
            return
        serial = [int(told[f"serial_{each}"]) & 0xFFFFFFFF for each in (1, 2, 3)]
        self.identity = Identity(
            vendor="mjbots",
            model=f"moteus {int(told['model']):x}",
            firmware=f"0x{int(told['firmware']):04x}",
            serial="".join(f"{each:08x}" for each in serial),
        )

    def routes(self) -> tuple[Route, ...]:
        """Return the identifier of its responses to the gateway."""
        return tuple(
            Route(self.node << 8 | self.options.source, 0x7FFF, extended=extended)
            for extended in (True, False)
        )

    def take(self, message: can.Message) -> bool:
        """Decode a response; one of the stream is taken by who waits for it."""
        if content(message) is not None:
            self._count()
            self.status.reports += 1
            return True
        values: dict[str, float] = {}
        for access in parse(bytes(message.data)):
            if access.kind == Kind.REPLY and access.register in _NAMES and access.value is not None:
                values[_NAMES[access.register]] = access.value
        self._count()
        if "mode" not in values:  # what it is, which says nothing about its state or its clock
            self.status.reports += 1
            return True
        self._look_at_the_watchdog(values.get("watchdog", math.nan))
        self._look_for_a_boot(values.get("milliseconds", math.nan))
        status = self.status
        for name, factor in (("position", TURN), ("velocity", TURN), ("torque", 1.0)):
            if math.isfinite(value := values.get(name, math.nan)):
                setattr(status, name, value * factor)
        for name, field in _OTHERS.items():
            if math.isfinite(value := values.get(name, math.nan)):
                setattr(status, field, value)
        if "mode" in values and math.isfinite(values["mode"]):
            self._state(int(values["mode"]), int(values.get("fault", 0)))
        done = values.get("trajectory_complete", 0)
        status.reached = bool(done) if self._moving and self._mode == Mode.POSITION else None
        status.moved += 1
        status.reports += 1
        return True

    def _look_at_the_watchdog(self, seconds: float) -> None:
        """Check that the drive uses the watchdog time sent with each set-point."""
        if self.watchdog is not None and math.isfinite(seconds) and self._mode in _ON:
            same = math.isclose(seconds, self.watchdog, rel_tol=0.01)
            text = f"watchdog register 0x027 = {seconds * 1000:g} ms: zero velocity, damped"
            self.protection = Protection(text, seconds, verified=same)

    def _look_for_a_boot(self, milliseconds: float) -> None:
        """Detect a reboot from the drive's clock.

        A set-point switches on a moteus that is off, so one that has rebooted is stopped at once.
        """
        before, self._clock = self._clock, milliseconds
        if milliseconds < before < _WRAPS:
            self.status.resets += 1
            self._rebooted_at = time.monotonic()
            if self.status.enabled:
                self._moving = False
                self._write({"mode": Mode.STOPPED}, urgent=True)

    def _state(self, mode: int, fault: int) -> None:
        self._mode = mode
        status = self.status
        status.enabled = mode in _ON
        # Its time-out damps to zero velocity, and lasts until a stop command.
        status.holding = mode in _ON or mode == Mode.TIMEOUT
        if mode == Mode.FAULT:
            text = _FAULTS.get(fault, f"fault {fault}")
            status.faults = (Fault(text.replace(" ", "_"), text, fault),)
        elif mode == Mode.TIMEOUT:
            status.faults = (Fault("watchdog", "its watchdog has expired", mode),)
        else:
            status.faults = ()

    def _count(self) -> None:
        self._owed -= 1
        if self._owed <= -_TOO_MANY:
            self._owed = 0
            self.status.twins += 1

    def _write(self, values: dict[str, float], *, urgent: bool = False) -> None:
        """Write registers, the mode first, and request the state in the same frame."""
        writes = [
            Access(
                Kind.WRITE,
                REGISTERS[name].number,
                Width.INT8 if name == "mode" else Width.FLOAT,
                value,
            )
            for name, value in values.items()
        ]
        self._spoken = True
        self._owed = min(self._owed + 1, _UNDER_WAY)
        payload = build(writes) + _QUERY
        lifetime = None if urgent else _FAST
        self._send_to(self.node, payload, answers=True, urgent=urgent, lifetime=lifetime)

    def _drive(self, values: dict[str, float], *, urgent: bool = False) -> None:
        options = self.options
        whole = {"mode": float(Mode.POSITION), **values}
        if options.max_torque is not None:
            whole["max_torque"] = options.max_torque
        if self.watchdog is not None:
            whole["watchdog"] = self.watchdog
        self._write(whole, urgent=urgent)

    def poll(self, tick: int) -> None:
        """Request the state if no set-point has; the request keeps a move alive."""
        spoken, self._spoken = self._spoken, False
        if spoken:
            return
        if self._moving and self.status.enabled:
            self._drive(self._target)
        else:
            self._write({})
        self._spoken = False

    async def enable(self) -> None:
        """Hold the current position: position mode with no position and velocity zero."""
        self._moving = False
        await self.until(
            lambda: bool(self.status.enabled),
            "enabled",
            again=lambda: self._drive(_STILL),
        )

    async def disable(self) -> None:
        """Send the stop mode."""
        self._moving = False
        await self.until(
            lambda: self._mode in (Mode.STOPPED, Mode.FAULT),
            "disabled",
            again=lambda: self._write({"mode": Mode.STOPPED}),
            faults=False,
        )

    async def clear_faults(self) -> None:
        """Send the stop mode, which clears a fault or a time-out."""
        self._moving = False
        await self.until(
            lambda: self._mode == Mode.STOPPED,
            "free of faults",
            again=lambda: self._write({"mode": Mode.STOPPED}),
            faults=False,
        )

    async def set_zero(self) -> None:
        """Set the current position as zero."""
        await self.until_zero(lambda: self._write({"set_output": 0.0}))

    def command(self, mode: MotorMode, value: float, velocity: float) -> None:
        """Send a set-point."""
        self._moving = False
        match mode:
            case "position":
                self._drive({"command_position": value / TURN, "command_velocity": velocity / TURN})
            case "velocity":
                self._drive({**_STILL, "command_velocity": value / TURN})
            case "torque":
                self._drive({**_STILL, "command_torque": value, "kp_scale": 0.0, "kd_scale": 0.0})

    async def move(self, position: float, velocity: float, acceleration: float | None) -> None:
        """Move by the drive's own trajectory."""
        self._target = {
            "command_position": position / TURN,
            "command_velocity": 0.0,
            "velocity_limit": velocity / TURN,
        }
        if acceleration is not None:
            self._target["acceleration_limit"] = acceleration / TURN
        self._drive(self._target)
        self._moving = True
        self.status.reached = None

    def stop(self) -> None:
        """Brake with all available torque and hold velocity zero; a drive that is off stays off."""
        self._moving = False
        # One that has rebooted may be on by a set-point that was under way, and is to be off.
        rebooted = time.monotonic() - self._rebooted_at < _STRAY
        if self._mode in _ON and not rebooted:
            self._drive(_STILL, urgent=True)
        elif self._mode != Mode.TIMEOUT:  # the time-out mode brakes by itself
            self._write({"mode": Mode.STOPPED}, urgent=True)
        else:
            self._write({}, urgent=True)


_OTHERS = {
    "q_current": "current",
    "voltage": "voltage",
    "temperature": "drive_temperature",
    "motor_temperature": "motor_temperature",
}

PROFILE = Profile(
    "moteus",
    "mjbots moteus, on CAN FD.",
    MoteusOptions,
    MoteusDrive,
    "rcp_can.sim.moteus:MoteusTwin",
    NODES,
    fd=True,
)
