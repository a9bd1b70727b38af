"""ODrive's CANSimple protocol, firmware 0.5.6 to 0.6: id = node << 5 | command, little-endian."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from msgspec import Struct

from rcp_can.bus import Route
from rcp_can.drive import Drive, Identity, Profile, Protection, Reach, StopFrame
from rcp_can.motor_messages import Mode
from rcp_can.procedure import Procedure
from rcp_can.profiles.odrive_endpoints import Endpoints, set_watchdog
from rcp_can.profiles.odrive_messages import MESSAGES, faults_of
from rcp_can.profiles.odrive_procedures import odrive_procedures
from rcp_can.profiles.odrive_states import HOMING, PREPARING, SELF_MOVING, History, reason
from rcp_kernel.errors import DeviceRejected, DeviceTimeout

if TYPE_CHECKING:
    import can

__all__ = ["PROFILE", "OdriveDrive", "OdriveOptions"]

_IDLE, _CLOSED_LOOP = 1, 8
_CONTROL: dict[Mode, int] = {"torque": 1, "velocity": 2, "position": 3}
_PASSTHROUGH, _TRAPEZOID = 1, 5
_SLOW = 0.4  # s between two requests for a state, which take time to take effect
_BEATS = 0.5  # s within which a heartbeat must come
_ENCODER, _HEARTBEAT = 0.02, 0.1  # s: periods of the drive's reports, which are 10 and 100 ms
_FEED_PERIOD = 0.1  # s without a message that feeds the drive's watchdog, after which one is sent
_IDENTITY = 0.5  # s within which it tells what it is
_REBOOT = 10.0  # s within which it has stored its configuration and is back
_SAVE = 1  # action of a reboot
_FAST = 0.05  # s: a set-point older than this is not worth sending


_DONE = 1 << 7  # of the controller's flags of firmware 0.5


class OdriveOptions(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Options of an ODrive axis."""

    torque_constant: float | None = None
    """N·m/A; gives the torque from the current if the drive sends no torques."""
    trapezoid: bool = True
    """Use the drive's own trapezoidal trajectories, which report their end."""
    home_timeout: float = 60.0
    endpoints: str = ""
    """The file `flat_endpoints.json` of its firmware, 0.6 or newer: the watchdog is set and read
    back."""


class OdriveDrive(Drive):
    """One axis of an ODrive."""

    homes = True
    zeroes = True

    def __init__(self, node: int, options: OdriveOptions, bus: object) -> None:
        super().__init__(node, options, bus)  # type: ignore[arg-type]
        self.moves = options.trapezoid
        self._base = node << 5
        self._mode: tuple[int, int] | None = None
        self._state = 0
        self._serial: tuple[float, float] | None = None
        self._version: dict[str, int] | None = None
        self._result = 0
        self._history = History()
        self.values: dict[int, int] = {}
        """The endpoints read since they were last asked for, as raw 32-bit values."""
        self._endpoints = Endpoints.load(options.endpoints) if options.endpoints else None
        self._moving = False
        self._ours = False
        self._fed = float("-inf")
        self._input: tuple[str, dict[str, float]] = ("velocity", {})
        self.protection = Protection(
            "the axis watchdog is configured by odrivetool only (axis.config.enable_watchdog, "
            "watchdog_timeout) and cannot be read over CANSimple; the gateway feeds it"
        )
        self._read = {
            MESSAGES[name][0]: (MESSAGES[name][1], getattr(self, f"_on_{name}"))
            for name in (
                *("version", "heartbeat", "error", "value", "address", "encoder"),
                *("current", "temperature", "supply", "torques"),
            )
        }

    @property
    def beats(self) -> float | None:
        """Several of its periods, which are 100 ms by default."""
        return _BEATS if self.status.beat > float("-inf") else None

    @property
    def busy(self) -> bool:
        """Whether it calibrates or homes, or may be about to."""
        return not self._history.settled or self._state in SELF_MOVING

    def procedures(self, gear: float, velocity: float) -> Sequence[Procedure]:
        """Offer calibration, and storing of the configuration."""
        return odrive_procedures(self)

    def period(self, signal: str) -> float:
        """Return the period of its encoder message, or of the heartbeat for the state."""
        return _HEARTBEAT if signal == "enabled" else _ENCODER

    def routes(self) -> tuple[Route, ...]:
        """Return all identifiers of the node."""
        return (Route(self._base, 0x7E0),)

    def take(self, message: can.Message) -> bool:
        """Decode one frame."""
        if message.is_remote_frame:
            return False
        known = self._read.get(message.arbitration_id & 0x1F)
        if known is not None:
            layout, handler = known
            handler(**layout.decode(message.data))
        return known is not None

    def _on_heartbeat(
        self, error: int, state: int, result: int, done: int, controller: int
    ) -> None:
        status = self.status
        status.beat = time.monotonic()
        if state == 0 or (self._state not in (0, 1) and state == _IDLE and error & 1):
            status.resets += 1
        self._state, self._result = state, result
        received = status.beat if status.frame_at is None else status.frame_at
        self._history.add(state, result, received, sent=self.bus.lag == 0.0)
        status.enabled = state not in (0, _IDLE)
        if self._version is None and (error or controller & _DONE):
            done = controller >> 7  # 0.5, which tells no version, has an encoder's error there
        status.reached = bool(done & 1) if self._moving else None
        status.faults = faults_of(error) if error else ()
        status.reports += 1

    def _on_error(self, active: int, disarm_reason: int) -> None:
        self.status.faults = faults_of(active)
        self.status.reports += 1

    def _on_address(self, node: int, serial_low: int, serial_high: int) -> None:
        serial = serial_low, serial_high
        if self._serial not in (None, serial):
            self.status.twins += 1
        self._serial = serial
        self._identify()

    def _on_version(self, **found: float) -> None:
        self._version = {name: int(value) for name, value in found.items()}
        self._identify()

    def _on_value(self, endpoint: float, value: float, **_: float) -> None:
        self.values[int(endpoint)] = int(value)
        self.status.reports += 1

    def _identify(self) -> None:
        version, serial = self._version, self._serial
        if version is None:
            return
        hardware = ".".join(
            str(version[f"hardware_{part}"]) for part in ("major", "minor", "variant")
        )
        self.identity = Identity(
            vendor="ODrive",
            model=f"hardware {hardware}",
            firmware=".".join(
                str(version[f"firmware_{part}"]) for part in ("major", "minor", "revision")
            )
            + ("-dev" if version["unreleased"] else ""),
            serial=None if serial is None else f"{int(serial[1]):04X}{int(serial[0]):08X}",
        )
        self.status.reports += 1

    def _on_encoder(self, position: float, velocity: float) -> None:
        self.status.position, self.status.velocity = position, velocity
        self.status.moved += 1

    def _on_current(self, set_point: float, measured: float) -> None:
        self.status.current = measured
        if self.options.torque_constant is not None:
            self.status.torque = measured * self.options.torque_constant

    def _on_temperature(self, drive: float, motor: float) -> None:
        self.status.drive_temperature, self.status.motor_temperature = drive, motor

    def _on_supply(self, voltage: float, current: float) -> None:
        self.status.voltage = voltage

    def _on_torques(self, target: float, estimate: float) -> None:
        self.status.torque = estimate

    def reach(self) -> Reach:
        """Return the limits within which 32-bit floats keep a useful resolution."""
        return Reach(position=1e5)

    def _transmit(
        self, name: str, *, urgent: bool = False, stale: float | None = None, **values: float
    ) -> None:
        command, layout = MESSAGES[name]
        # Always eight bytes: common tools and mocks accept no fewer.
        data = layout.encode(**values).ljust(8, b"\0")
        self.send(self._base | command, data, urgent=urgent, lifetime=stale)

    def poll(self, tick: int) -> None:
        """Feed its watchdog; request temperatures and supply, and periodically its address."""
        name, values = self._input
        again = self._moving or not any(values.values())  # no old set-point would move it
        if (
            self._ours
            and again
            and self.status.enabled
            and time.monotonic() - self._fed > _FEED_PERIOD
        ):
            self._feed(name, values)
        slow = tick % 64
        if slow in (1, 17, 33):
            name = {1: "temperature", 17: "supply", 33: "address"}[slow]
            self.send(self._base | MESSAGES[name][0], remote=True, length=8, lifetime=_FAST)

    def _request(self, name: str) -> None:
        self.send(self._base | MESSAGES[name][0], remote=True, length=8)

    async def configure(self) -> None:
        """Ask what it is; set its watchdog and read it back, if its endpoints are known."""

        def ask() -> None:
            self._request("version")
            self._request("address")

        # After a boot it may run other firmware, or be another drive.
        self._version = self._serial = self.identity = None
        try:
            await self.until(
                lambda: None not in (self.identity, self._serial, self.status.enabled),
                "telling its version and state",
                again=ask,
                seconds=_IDENTITY,
                faults=False,
            )
        except DeviceTimeout:  # older firmware does not tell
            if self._endpoints is not None:
                raise
        if self._endpoints is not None:
            self.protection = await set_watchdog(self, self._endpoints, self.watchdog)

    async def read_endpoint(self, number: int) -> int:
        """Read one of its endpoints, as a raw 32-bit value.

        :raises DeviceTimeout: it does not answer.
        """
        self.values.pop(number, None)
        await self.until(
            lambda: number in self.values,
            f"telling endpoint {number}",
            again=lambda: self._transmit("access", endpoint=number),
            faults=False,
        )
        return self.values[number]

    def write_endpoint(self, number: int, value: int) -> None:
        """Write one of its endpoints; it does not answer."""
        self._transmit("access", opcode=1, endpoint=number, value=value)

    async def calibrate(
        self, state: int, seconds: float, tell: Callable[[int], None], begun: Callable[[], object]
    ) -> None:
        """Run a calibration; return when it has ended in idle without an error.

        `begun` is called once it is known to have run: a failure from then on is no refusal.

        :raises DeviceRejected: it does not start, or fails, with the drive's reason.
        :raises DeviceTimeout: it does not end in time, or may have run unheard.
        """
        history, told = self._history, 0
        self._ours, self._input = True, ("velocity", {})
        history.begin(self._result, time.monotonic())

        def ended() -> bool:
            nonlocal told
            seen = [each for each in history.states if each in PREPARING]
            for each in seen[told:]:
                tell(each)
            told = len(seen)
            return not self.busy

        try:
            self._transmit("state", state=state)
            await self.until(ended, "at the end of its calibration", seconds=seconds)
        finally:
            self._ours = False
            if history.ran:
                begun()
        if history.ran and (failure := reason(self._result)) is not None:
            raise DeviceRejected(f"the calibration failed: {failure}")
        if history.ran:
            return
        if history.complete:
            raise DeviceRejected(
                "the drive did not start the calibration",
                remedy="Check that its motor and encoder are configured (odrivetool).",
            )
        raise DeviceTimeout(
            "heartbeats of the drive were missed: it is not known whether it ran the calibration",
            remedy="Check with odrivetool that it is calibrated, or run it again.",
        )

    async def save(self) -> None:
        """Store the configuration; the drive reboots once it has.

        :raises DeviceTimeout: it was not seen to reboot.
        """
        resets = self.status.resets
        self._transmit("reboot", action=_SAVE)
        await self.until(
            lambda: self.status.resets > resets and self._state == _IDLE,
            "seen to reboot, so it may not have stored its configuration",
            seconds=_REBOOT,
            faults=False,
        )

    async def enable(self) -> None:
        """Enter closed loop control at velocity zero, whatever set-point the drive still has."""
        self._mode = None
        self._moving = False

        def request() -> None:
            self._control("velocity", _PASSTHROUGH)
            self._transmit("velocity")
            self._transmit("state", state=_CLOSED_LOOP)

        self._input = "velocity", {}
        await self.until(lambda: self._state == _CLOSED_LOOP, "enabled", again=request, every=_SLOW)
        self._ours = True

    async def disable(self) -> None:
        """Enter idle."""
        self._ours = False
        await self.until(
            lambda: self._state == _IDLE,
            "disabled",
            again=lambda: self._transmit("state", state=_IDLE),
            every=_SLOW,
            faults=False,
        )

    async def clear_faults(self) -> None:
        """Clear the errors; an axis with errors is idle already."""
        await self.until(
            lambda: not self.status.faults,
            "free of faults",
            again=lambda: self._transmit("clear"),
            faults=False,
        )

    async def set_zero(self) -> None:
        """Set the absolute position; requires firmware 0.6."""
        await self.until_zero(
            lambda: self._transmit("absolute"), "at zero (older firmware cannot be set to zero)"
        )

    async def home(self, begun: Callable[[], object]) -> None:
        """Run the drive's own homing, then return to closed loop."""
        self._moving = False
        self._history.begin(self._result, time.monotonic())
        self._input = "torque", {}  # feeds its watchdog; a velocity would be that of homing
        self._transmit("state", state=HOMING)
        await self.until(lambda: HOMING in self._history.states, "homing")
        begun()
        await self.until(
            lambda: not self.busy, "done with homing", seconds=self.options.home_timeout
        )
        if self._state != _CLOSED_LOOP:
            failure = reason(self._result)
            raise DeviceRejected(
                "homing ended, and the axis is idle" + (f": {failure}" if failure else "")
            )
        self.status.homed = True

    def _control(self, mode: Mode, input_mode: int) -> None:
        wanted = _CONTROL[mode], input_mode
        if wanted != self._mode:
            self._transmit("mode", control=wanted[0], input=wanted[1])
            self._mode = wanted

    def command(self, mode: Mode, value: float, velocity: float) -> None:
        """Send a set-point."""
        self._moving = False
        self._control(mode, _PASSTHROUGH)
        match mode:
            case "position":
                self._feed(mode, {"position": value, "velocity": velocity})
            case "velocity" | "torque":
                self._feed(mode, {mode: value})

    def _feed(self, name: str, values: dict[str, float], *, stale: float | None = _FAST) -> None:
        """Send an input, which feeds the watchdog, and keep it for repetition."""
        self._transmit(name, urgent=False, stale=stale, **values)
        self._fed, self._input = time.monotonic(), (name, values)

    async def move(self, position: float, velocity: float, acceleration: float | None) -> None:
        """Follow a trapezoidal trajectory."""
        self._transmit("trap_velocity", velocity=velocity)
        if acceleration is not None:
            self._transmit(
                "trap_acceleration", acceleration=acceleration, deceleration=acceleration
            )
        self._control("position", _TRAPEZOID)
        self._feed("position", {"position": position}, stale=None)
        self._moving = True
        self.status.reached = None

    def stop(self) -> None:
        """Brake with all available torque: velocity zero, without a ramp; end what turns it by itself."""
        self._moving = False
        if self.busy:  # no input would end that
            self._transmit("state", urgent=True, state=_IDLE)
        self._mode = _CONTROL["velocity"], _PASSTHROUGH
        self._fed, self._input = time.monotonic(), ("velocity", {})
        self._transmit("velocity", urgent=True)
        self._transmit("mode", urgent=True, control=self._mode[0], input=self._mode[1])

    def stop_frames(self) -> Sequence[StopFrame]:
        """Set velocity zero as in `stop`: the drive's emergency stop would drop a load."""
        words = {"mode": {"control": _CONTROL["velocity"], "input": _PASSTHROUGH}, "velocity": {}}
        return [
            StopFrame(self._base | command, layout.encode(**words[name]).ljust(8, b"\0"))
            for name in words
            for command, layout in (MESSAGES[name],)
        ]


PROFILE = Profile(
    "odrive",
    "ODrive, by CANSimple.",
    OdriveOptions,
    OdriveDrive,
    "rcp_can.sim.odrive:OdriveTwin",
    range(64),
)
