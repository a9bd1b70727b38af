"""CiA 402 drives on CANopen: a non-blocking state machine, and configurable PDO mapping."""

from __future__ import annotations

import struct
import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import structlog

from rcp_can.bus import Bus, Route
from rcp_can.drive import Drive, Fault, Profile, Protection, Reach, StopFrame
from rcp_can.motor_messages import Mode
from rcp_can.procedure import Procedure
from rcp_can.profiles.cia402_homing import Homing, homing_of
from rcp_can.profiles.cia402_identity import read_identity
from rcp_can.profiles.cia402_objects import (
    COMMANDS,
    MESSAGES,
    MODES,
    OBJECTS,
    emergency,
    state_of,
)
from rcp_can.profiles.cia402_options import Cia402Options
from rcp_can.profiles.cia402_pdos import eds_map, own_map, own_pdos
from rcp_can.profiles.cia402_procedures import Units, cia402_procedures
from rcp_can.profiles.cia402_setup import has_object, map_pdos, set_up
from rcp_can.sdo import Sdo
from rcp_kernel.errors import DeviceRejected, DeviceTimeout

if TYPE_CHECKING:
    import can

__all__ = ["PROFILE", "Cia402Drive"]

log = structlog.get_logger("rcp.can")
_PRE_OPERATIONAL, _OPERATIONAL, _START, _RESET = 0x7F, 0x05, 0x01, 0x81
_NMT_STATE = 0x7F  # the other bit toggles if another master guards the node (CiA 301, 7.2.8.2.2)
_REACHED, _LIMIT, _ACKNOWLEDGED = 1 << 10, 1 << 11, 1 << 12
_NEW_SET_POINT, _AT_ONCE = 1 << 4, 1 << 5
_FAST = 0.05  # s: a set-point older than this is not worth sending
_UNDER_WAY = 1  # PDOs that may have left the drive before our request reached it
_PROBE = 0.3  # s between two probes of a silent node
_SWITCHING = 2.0  # s for the transitions of the state machine
_I32, _I16 = 2**31 - 1, 2**15 - 1
_EMERGENCY, _ANSWER, _REQUEST, _HEARTBEAT = 0x080, 0x580, 0x600, 0x700
_BY_SDO = 0.1  # s between two control words by SDO, where PDOs have no effect
_PATIENCE = 0.06  # s after which a quick stop by PDO should have taken effect
_NEW_STOP = 0.5  # s without a stop, after which the next counts as a new one
_ARRIVE = 1.0  # s within which every mapped PDO must arrive once
_BEATS = 5  # heartbeats of the gateway within the drive's consumer time
_RATES = "target_velocity", "target_torque"
_TARGETS: dict[Mode, str] = {
    "position": "target_position",
    "velocity": "target_velocity",
    "torque": "target_torque",
}
_CONTROLLED = frozenset(("statusword", "position", "velocity"))
"""Signals that control requires; they must arrive once after every configuration."""
_FAULTS = frozenset(("fault", "fault_reaction"))
_POWERED = frozenset(("enabled", "quick_stop", "fault_reaction"))
_CONTROL_WRITTEN = b"\x60\x40\x60\0", b"\x80\x40\x60\0"  # or aborted: CiA 301, 7.2.4.3.4


class Cia402Drive(Drive):
    """One axis of a CiA 402 device."""

    moves = True
    homes = True
    offsets = True

    def __init__(self, node: int, options: Cia402Options, bus: Bus) -> None:
        super().__init__(node, options, bus)
        self.moves = options.control == "profile"
        self.sdo = Sdo(bus, node)
        self.state = "unknown"
        self._scale, self._rates = options.positions, options.velocities
        self._statusword = 0
        self._shown = self._mode = 0
        self._control = COMMANDS["disable_voltage"]
        self._goal = self._rate = self._torque = self._offset = 0
        self._nmt: int | None = None
        self._moving = self._homing = False
        self._statuswords = 0
        self._configured = self._watched = False
        self._sync = options.sync
        self._probes = 0
        self._stop_began = self._stop_last = float("-inf")
        self._reported: Counter[str] = Counter()
        self._emergencies: dict[int, Fault] = {}
        self._pdos = eds_map(options.eds, node) if options.eds else own_map(node)
        carried = self._pdos.commanded
        self.modes = frozenset(mode for mode, target in _TARGETS.items() if target in carried)

    @property
    def beats(self) -> float | None:
        """Three of its heartbeat periods, once they are set."""
        return 0.003 * self.options.heartbeat or None if self._configured else None

    def period(self, signal: str) -> float:
        """Return the period of its PDOs, which carry all signals."""
        return (self._sync or self.options.feedback) / 1000

    @property
    def loose(self) -> bool:
        """Whether it is in operation enabled: a quick stop takes it out of that."""
        return self.state == "enabled"

    @property
    def server(self) -> Sdo:
        """Its SDO client, the only one for this node."""
        return self.sdo

    @property
    def busy(self) -> bool:
        """Whether it homes."""
        return self._homing

    def procedures(self, gear: float, velocity: float) -> Sequence[Procedure]:
        """Offer homing by a method, and storing of its parameters."""
        units = Units(gear * self._rates, gear * self.options.accelerations)
        return cia402_procedures(self, units, velocity)

    def routes(self) -> tuple[Route, ...]:
        """Return its PDOs, emergencies, heartbeats and SDO responses."""
        own = (cob + self.node for cob in (_EMERGENCY, _ANSWER, _HEARTBEAT))
        return tuple(Route(cob) for cob in (*own, *self._pdos.feedback))

    def reach(self) -> Reach:
        """Return the limits given by the widths of the objects."""
        return Reach(
            position=_I32 / self._scale,
            velocity=_I32 / self._rates,
            torque=_I16 / 1000 * self.options.rated_torque,
        )

    # Receiving

    def take(self, message: can.Message) -> bool:
        """Decode one frame."""
        layout = self._pdos.feedback.get(message.arbitration_id)
        if layout is not None:
            self._on_pdo(layout.decode(message.data))
            return True
        cob = message.arbitration_id - self.node
        if cob == _ANSWER and bytes(message.data[:4]) in _CONTROL_WRITTEN:
            self.status.reports += 1  # responses to a stop that bypassed the SDO client
        elif cob == _ANSWER and self._probes and not self.sdo.busy:
            self._probes -= 1
            self.status.reports += 1
        elif cob == _ANSWER:
            unasked = self.sdo.unasked
            self.sdo.take(message)
            self.status.twins += self.sdo.unasked - unasked
        elif cob == _EMERGENCY:
            self._on_emergency(int(MESSAGES["emergency"][1].decode(message.data)["code"]))
        else:
            state = int(MESSAGES["heartbeat"][1].decode(message.data)["state"])
            self._on_heartbeat(state & _NMT_STATE)
        return True

    def _on_heartbeat(self, state: int) -> None:
        status = self.status
        status.beat = time.monotonic()
        if state == 0:
            self._nmt = 0
            self._configured = False
            self.state = "unknown"
            self._emergencies.clear()
            status.enabled, status.holding, status.faults = False, False, ()
            status.resets, status.reset = status.resets + 1, "the drive rebooted"
        elif state != self._nmt:
            fell = self._nmt == _OPERATIONAL and self._configured
            self._nmt = state
            if fell:  # no more PDOs arrive, and the motor may still turn
                self._configured = False
                status.enabled = status.holding = None
                status.resets, status.reset = status.resets + 1, self._left_operational()
        status.reports += 1

    def _left_operational(self) -> str:
        told = "; ".join(f"{emergency(code)}, 0x{code:04X}" for code in self._emergencies)
        return "the drive left the NMT state operational" + (f" ({told})" if told else "")

    def _on_emergency(self, code: int) -> None:
        if code < 0x100:  # 00xx: error reset, or no error (CiA 301, table 26)
            self._emergencies.clear()
        else:
            text = f"{emergency(code)} (0x{code:04X})"
            self._emergencies[code] = Fault(f"emergency_{code:04x}", text, code)
        self._sum_up()

    def _sum_up(self) -> None:
        faults = tuple(self._emergencies.values())
        if not faults and self.state in _FAULTS:
            faults = (Fault("fault", "the drive is in fault"),)
        self.status.faults = faults
        self.status.reports += 1

    def _on_pdo(self, values: dict[str, float]) -> None:
        status, scale = self.status, self._scale
        self._reported.update(values.keys())
        for name, value in values.items():
            match name:
                case "position":
                    status.position = value / scale
                case "velocity":
                    status.velocity = value / self._rates
                case "torque":
                    status.torque = value / 1000 * self.options.rated_torque
                case "mode_shown":
                    self._shown = int(value)
                case _:
                    continue
        if "statusword" in values:
            self._on_state(int(values["statusword"]))
        status.moved += 1

    def _on_state(self, statusword: int) -> None:
        status = self.status
        self._statusword = statusword
        self._statuswords += 1
        was, self.state = self.state, state_of(statusword)
        status.enabled = self.state == "enabled"
        self._homing = self._homing and status.enabled
        status.holding = self.state in _POWERED
        if was in _FAULTS and self.state not in _FAULTS:
            self._emergencies.clear()
        status.reached = bool(statusword & _REACHED) if self._moving else None
        self._sum_up()

    # Configuration

    async def read(self, name: str) -> int:
        """Read one of the profile's objects."""
        index, sub, code = OBJECTS[name]
        data = await self.sdo.upload(index, sub)
        return struct.unpack("<" + code, data[: struct.calcsize(code)])[0]

    async def write(self, name: str, value: int) -> None:
        """Write one of the profile's objects."""
        index, sub, code = OBJECTS[name]
        await self.sdo.download(index, sub, struct.pack("<" + code, value))

    async def configure(self) -> None:
        """Set heartbeats, quick stop and PDOs, and start the node."""
        self._configured = False
        self._nmt_command(0x80)
        self.protection = Protection("not read yet")
        found = await set_up(self.sdo, self.options, self.watchdog, self.rate)
        self.protection, self._watched = found.protection, True
        if self.options.map_pdos:
            fed = self.torque_offset is not None
            offset = fed and await has_object(self.sdo, "torque_offset")
            self._pdos = own_map(self.node, offset=offset)
            pdos = own_pdos(offset=offset)
            self._sync = await map_pdos(self.sdo, self.node, self.options, pdos)
        self.identity = await read_identity(self.sdo)
        if self.torque_offset is not None and "torque_offset" not in self._pdos.commanded:
            log.warning("no_torque_offset", node=self.node, text="no 0x60B2, or in no PDO")
        self._control = COMMANDS["disable_voltage"]
        self._nmt_command(_START)
        self._nmt = None
        self._reported.clear()
        mapped = {name for layout in self._pdos.feedback.values() for name in layout.names}
        due = mapped & _CONTROLLED
        try:
            await self.until(
                lambda: due <= self._reported.keys(),
                "sending its PDOs",
                again=self._start_again,
                seconds=_ARRIVE,
            )
        except DeviceTimeout:
            missing = ", ".join(sorted(due - self._reported.keys()))
            raise DeviceTimeout(
                f"node {self.node} accepted its PDO mapping, but {missing} did not arrive",
                remedy="Use the drive's own PDO mapping: map_pdos = false, with its EDS.",
            ) from None
        self.status.beat = time.monotonic()
        self._configured = True

    def _start_again(self) -> None:
        self._nmt_command(_START)
        if self._sync:
            self.send(0x080)

    def _nmt_command(self, command: int) -> None:
        self.send(0x000, MESSAGES["nmt"][1].encode(command=command, node=self.node))

    # Commands

    def poll(self, tick: int) -> None:
        """Send SYNC and the gateway's heartbeat when they are due; probe a silent node."""
        options, bus = self.options, self.bus
        name = f"heartbeat {options.master}"
        if self._watched and self.watchdog and bus.paced(name, self.watchdog / _BEATS):
            bus.send(_HEARTBEAT + options.master, bytes((_OPERATIONAL,)), lifetime=_FAST)
        if not self._configured:
            if self._nmt is None and not self.sdo.busy and bus.paced(f"probe {self.node}", _PROBE):
                self._probes = 1
                device_type = struct.pack("<BHBxxxx", 0x40, 0x1000, 0)
                bus.send(_REQUEST + self.node, device_type, lifetime=_FAST)
            return
        if self._sync and bus.paced("sync", 0.9 * self._sync / 1000):
            bus.send(0x080, lifetime=_FAST)

    def _transmit(self, *names: str, urgent: bool = False) -> None:
        """Send the PDOs that carry some objects, with their current values."""
        lifetime = None if urgent else _FAST
        values: dict[str, float] = {
            "controlword": self._control,
            "mode": self._mode,
            "target_position": self._goal,
            "target_velocity": self._rate,
            "target_torque": self._torque,
            "torque_offset": self._offset,
        }
        for cob, layout in self._pdos.carrying(*names):
            data = layout.encode(**{name: values.get(name, 0) for name in layout.names})
            self.send(cob, data, urgent=urgent, lifetime=lifetime)

    def _push_by_sdo(self, control: int) -> None:
        """Write the control word by SDO without the client: it works where PDOs have no effect."""
        if self.bus.paced(f"control {self.node}", _BY_SDO):
            self.send(_REQUEST + self.node, _control_request(control), urgent=True)

    def _push(self, control: int, *, urgent: bool = False) -> None:
        self._control = control
        self._transmit("target_position", "mode", "controlword", urgent=urgent)

    def _step(self) -> None:
        """Request the next transition towards operation enabled (CiA 402-2, figure 5)."""
        word = {
            "switch_on_disabled": "shutdown",
            "ready": "switch_on",
            "switched_on": "enable",
            "quick_stop": "disable_voltage",  # restart, so that no old command continues
        }.get(self.state)
        if word is not None:
            self._push(COMMANDS[word])

    async def enable(self) -> None:
        """Go through the states to operation enabled, at velocity zero."""
        self._rate = self._torque = 0
        self._goal = round((self.status.position or 0.0) * self._scale)
        self._mode = self._modes("velocity")
        self._transmit(*_RATES)
        if self.state == "quick_stop":
            await self.until(
                lambda: self.state == "switch_on_disabled", "switched off", again=self._step
            )
        await self.until(
            lambda: self.state == "enabled", "enabled", again=self._step, seconds=_SWITCHING
        )

    async def disable(self) -> None:
        """Switch the voltage off."""
        self._rate = self._torque = 0
        stale = self._statuswords + _UNDER_WAY  # one on the bus predates the request
        until = time.monotonic() + _PATIENCE

        def request() -> None:
            self._push(COMMANDS["disable_voltage"])
            if time.monotonic() > until:
                self._push_by_sdo(COMMANDS["disable_voltage"])

        await self.until(
            lambda: (
                self._statuswords > stale
                and self.state in ("switch_on_disabled", "ready", "fault", "not_ready")
            ),
            "disabled",
            again=request,
            faults=False,
        )

    async def clear_faults(self) -> None:
        """Reset the fault by the rising edge of bit 7; a drive without fault is sent nothing."""

        def edge() -> None:
            if self.state == "fault":  # not while the fault reaction is active
                self._push(COMMANDS["disable_voltage"])
                self._push(COMMANDS["fault_reset"])

        if self.state in _FAULTS:
            self._rate = self._torque = 0
            await self.until(
                lambda: self.state not in _FAULTS,
                "free of faults",
                again=edge,
                seconds=_SWITCHING,
                faults=False,
            )
            self._push(COMMANDS["disable_voltage"])
        self._emergencies.clear()
        self._sum_up()

    def _modes(self, mode: Mode) -> int:
        kind = "cyclic" if self.options.control == "cyclic" else "profile"
        if mode == "position":
            kind = "cyclic"  # a stream of set-points; `move` uses profile position
        return MODES[f"{kind}_{mode}"]

    async def home(self, begun: Callable[[], object]) -> None:
        """Home by the configured method."""
        await self.write("homing_method", self.options.homing_method)
        await self.find_reference(self.options.home_timeout, begun)

    async def find_reference(self, seconds: float, begun: Callable[[], object]) -> None:
        """Home by the method and the speeds in the drive (CiA 402-2, 10.5).

        `begun` is called once the drive is told to start.

        :raises DeviceRejected: it does not start, or ends with an error.
        :raises DeviceTimeout: it takes longer than `seconds`.
        """
        self._mode = MODES["homing"]
        await self.until(
            lambda: self._shown == MODES["homing"],
            "in homing mode",
            again=lambda: self._push(COMMANDS["enable"]),
        )
        # A statusword that was on the bus may still tell the end of the last homing.
        first = self._statuswords + _UNDER_WAY
        self._homing = True
        self._push(COMMANDS["enable"] | _NEW_SET_POINT)
        begun()
        began = time.monotonic()

        def outcome() -> Homing:
            if self._statuswords <= first:
                return Homing.RUNNING
            return homing_of(self._statusword, time.monotonic() - began)

        await self.until(
            lambda: outcome() is not Homing.RUNNING or not self._homing, "homed", seconds=seconds
        )
        found = outcome()
        self._goal = round((self.status.position or 0.0) * self._scale)
        self._mode, self._rate = self._modes("velocity"), 0
        self._transmit(*_RATES)
        self._push(COMMANDS["enable"])
        self._homing = False
        if found is not Homing.DONE:
            raise DeviceRejected(f"homing failed: {found.value}")
        self.status.homed = True

    def command(self, mode: Mode, value: float, velocity: float) -> None:
        """Send a set-point together with its mode."""
        self._moving = self._homing = False
        offset = (self.torque_offset or 0.0) / self.options.rated_torque * 1000
        self._offset = round(max(-_I16, min(_I16, offset)))
        if mode == "position":
            self._goal = round(max(-_I32, min(_I32, value * self._scale)))
            if "torque_offset" in self._pdos.commanded:
                self._transmit("torque_offset")
        else:
            self._rate = self._torque = 0
            if mode == "velocity":
                self._rate = round(value * self._rates)
            else:
                self._torque = round(value / self.options.rated_torque * 1000)
            self._transmit(*_RATES)
        wanted = self._modes(mode)
        if mode == "position" or wanted != self._mode or wanted != self._shown:
            self._mode = wanted
            self._push(COMMANDS["enable"])

    async def move(self, position: float, velocity: float, acceleration: float | None) -> None:
        """Move to a position by the drive's profile generator (CiA 402-2, 10.3)."""
        await self.write("profile_velocity", max(1, round(velocity * self._rates)))
        if acceleration is not None:
            ramp = max(1, round(acceleration * self.options.accelerations))
            for name in ("profile_acceleration", "profile_deceleration"):
                await self.write(name, ramp)
        self._mode = MODES["profile_position"]
        self._goal = round((self.status.position or 0.0) * self._scale)
        shown, enable = MODES["profile_position"], COMMANDS["enable"]
        # A statusword already on the bus may acknowledge an older set-point.
        stale = self._statuswords + _UNDER_WAY
        await self.until(
            lambda: (
                self._statuswords > stale
                and self._shown == shown
                and not self._statusword & _ACKNOWLEDGED
            ),
            "in profile position mode",
            again=lambda: self._push(enable),
        )
        self._goal = round(max(-_I32, min(_I32, position * self._scale)))
        await self.until(
            lambda: bool(self._statusword & _ACKNOWLEDGED),
            "taking its new target",
            again=lambda: self._push(enable | _NEW_SET_POINT | _AT_ONCE),
        )
        self._push(enable)
        self.status.reached = None
        self._moving = True

    def stop(self) -> None:
        """Quick stop by PDO, and by SDO if that has no effect, as when not operational."""
        now = time.monotonic()
        if now - self._stop_last > _NEW_STOP:
            self._stop_began = now
        self._stop_last = now
        self._rate = self._torque = 0
        self._moving = False
        self._push(COMMANDS["quick_stop"], urgent=True)
        unheard = (
            not self._configured or now - self.status.at.get("enabled", float("-inf")) > _PATIENCE
        )
        if unheard or (self.state == "enabled" and now - self._stop_began > _PATIENCE):
            self._push_by_sdo(COMMANDS["quick_stop"])

    def stop_frames(self) -> Sequence[StopFrame]:
        """Quick stop by SDO: a PDO would carry a mode and a target that may be outdated."""
        data = _control_request(COMMANDS["quick_stop"])
        return (StopFrame(_REQUEST + self.node, data),)


def _control_request(control: int) -> bytes:
    """Return an expedited download of the control word (CiA 301, 7.2.4.3.3)."""
    return struct.pack("<BHBHxx", 0x2B, *OBJECTS["controlword"][:2], control)


PROFILE = Profile(
    "cia402",
    "CiA 402 drives on CANopen.",
    Cia402Options,
    Cia402Drive,
    "rcp_can.sim.cia402:Cia402Twin",
    range(1, 128),
)
