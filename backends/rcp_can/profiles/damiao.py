"""Damiao actuators in MIT mode: registers beside the set-points, read and written by id 0x7FF."""

from __future__ import annotations

import asyncio
import struct
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rcp_can.asking import answer_to
from rcp_can.bus import Bus, Route
from rcp_can.codec import Span
from rcp_can.drive import Identity, Profile, Protection
from rcp_can.procedure import Procedure
from rcp_can.profiles.damiao_registers import (
    ESC_ID,
    MODE,
    RANGES,
    REGISTERS,
    SUB_VERSION,
    TIMEOUT,
    VERSION,
    unpack,
)
from rcp_can.profiles.damiao_settings import NODES, damiao_procedures
from rcp_can.profiles.impedance import FAST
from rcp_can.profiles.mit import MitDrive, MitOptions, fault_of
from rcp_kernel.errors import DeviceRejected, DeviceTimeout

if TYPE_CHECKING:
    import can

__all__ = ["DAMIAO", "DamiaoDrive", "DamiaoOptions"]

_CLEAR = 0xFB
_REGISTERS, _READ, _WRITE, _STORE, _REFRESH = 0x7FF, 0x33, 0x55, 0xAA, 0xCC
_MIT_MODE = 1
_TICKS = 20_000  # timer steps per second
_OPTIONAL = 0.3  # s for a register that older firmware does not have
_LATE = 1.0  # s after which no response to a repeated access comes
_PROBED = 0.3  # s for another drive to answer
_STORED = 5.0  # s
_NEAR = 0.005  # of a full scale: configurations have rounded ones
_FAULTS = {
    0x8: "over-voltage",
    0x9: "under-voltage",
    0xA: "over-current",
    0xB: "over-temperature of the drive",
    0xC: "over-temperature of the motor",
    0xD: "communication lost",
    0xE: "overload",
}


class DamiaoOptions(MitOptions, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Gains and the model."""

    model: str = "4310"


class DamiaoDrive(MitDrive):
    """A Damiao actuator: it reports its state, fault and two temperatures, and has registers."""

    extra = (Span("drive", 8), Span("motor", 8))
    clearing = _CLEAR

    def __init__(self, node: int, options: DamiaoOptions, bus: Bus) -> None:
        super().__init__(node, options, bus)
        self._lock = asyncio.Lock()
        self._asked: dict[tuple[int, int], float] = {}
        """Until when a response to an access may come, by command and register."""
        self._scales: dict[int, float] = {}
        """The full scales that the drive has told, by register."""

    def procedures(self, gear: float, velocity: float) -> Sequence[Procedure]:
        """Offer its registers, and another id."""
        return damiao_procedures(self, self._is_there)

    def take(self, message: can.Message) -> bool:
        """Decode a response to a set-point; one to an access is taken by who waits for it."""
        data = message.data
        if len(data) == 8 and data[0] == self.node and not data[1] and self._due(data[2], data[3]):
            self.status.reports += 1
            return True
        return super().take(message)

    def _due(self, command: int, register: int) -> bool:
        """Return whether a response to an access may come."""
        return self._asked.get((command, register), 0.0) > time.monotonic()

    def _mine(self, identifier: int) -> bool:
        return identifier & 0xF == self.node & 0xF

    def _more(self, identifier: int, **values: float) -> None:
        status, state = self.status, identifier >> 4
        status.enabled = state == 1
        status.faults = fault_of(state, _FAULTS) if state > 1 else ()
        status.drive_temperature, status.motor_temperature = values["drive"], values["motor"]

    def _send_access(self, command: int, register: int, value: int, node: int) -> None:
        data = struct.pack("<HBBI", node, command, register, value)
        self.send(_REGISTERS, data, lifetime=None if command == _STORE else FAST)

    async def access(
        self,
        command: int,
        register: int,
        value: int = 0,
        *,
        node: int | None = None,
        seconds: float = 1.0,
    ) -> int:
        """Access a register, of a drive with another id if `node` is one; return its raw value.

        :raises DeviceTimeout: it does not answer, as it does not for a register that it does not have.
        """
        to = self.node if node is None else node
        head = struct.pack("<HBB", to, command, register)
        route = Route(0, 0) if node is not None else Route(self.options.reply_id)

        def matches(message: can.Message) -> bool:
            return message.arbitration_id != _REGISTERS and bytes(message.data[:4]) == head

        async with self._lock:
            self._asked[command, register] = time.monotonic() + seconds + _LATE
            answer = await answer_to(
                self.bus,
                (route,),
                lambda: self._send_access(command, register, value, to),
                matches,
                seconds=seconds,
                once=command == _STORE,
            )
        if answer is None or len(answer.data) < 8:
            known = REGISTERS.get(register)
            name = f" ({known.name})" if known is not None else ""
            raise DeviceTimeout(
                f"node {to}: not responding with its registers: {register}{name} within {seconds:g} s"
            )
        return int.from_bytes(answer.data[4:8], "little")

    async def store(self, node: int | None = None) -> None:
        """Store all registers; an enabled drive does not.

        :raises DeviceTimeout: it does not confirm.
        """
        await self.access(_STORE, 1, node=node, seconds=_STORED)

    async def _is_there(self, node: int) -> bool:
        try:
            await self.access(_READ, ESC_ID, node=node, seconds=_PROBED)
        except DeviceTimeout:
            return False
        return True

    async def configure(self) -> None:
        """Set mode and watchdog (register 9, in 50 µs), read them back, and what it tells of itself."""
        await self._set_up()
        self.identity = Identity(vendor="Damiao")
        try:
            version = await self.access(_READ, VERSION, seconds=_OPTIONAL)
            for register in RANGES:
                raw = await self.access(_READ, register, seconds=_OPTIONAL)
                self.scaled(register, unpack(register, raw))
            self.identity = Identity(vendor="Damiao", firmware=str(version))
            sub = await self.access(_READ, SUB_VERSION, seconds=_OPTIONAL)
            self.identity = Identity(vendor="Damiao", firmware=f"{version}.{sub}")
        except DeviceTimeout:  # older firmware does not have them
            return

    async def _set_up(self) -> None:
        await self.access(_WRITE, MODE, _MIT_MODE)
        if self.watchdog is not None:
            await self.access(_WRITE, TIMEOUT, round(self.watchdog * _TICKS))
        seconds = await self.access(_READ, TIMEOUT) / _TICKS
        if seconds:
            text = (
                f"register 9 (TIMEOUT) = {seconds * 1000:g} ms: it goes into fault, without torque"
            )
            self.protection = Protection(text, seconds, verified=True)
        else:
            self.protection = Protection("register 9 (TIMEOUT) = 0: its watchdog is off")

    def scaled(self, register: int, value: float) -> None:
        """Note the full scale that a register has."""
        if register in RANGES:
            self._scales[register] = value

    async def enable(self) -> None:
        """Enter motor mode with zero gains.

        :raises DeviceRejected: its full scales are not those of the configuration, which would
            multiply every set-point.
        """
        await self._set_up()  # it has forgotten them if it rebooted unnoticed
        for register in tuple(self._scales):
            self.scaled(register, unpack(register, await self.access(_READ, register)))
        for register, ours in zip(RANGES, self.span, strict=True):
            kept = self._scales.get(register, ours)
            if abs(kept - ours) > _NEAR * ours:
                listed = ", ".join(f"{self._scales.get(each, 0.0):g}" for each in RANGES)
                raise DeviceRejected(
                    f"{REGISTERS[register].name} of the drive is {kept:g}, and of this motor {ours:g}",
                    remedy=f"Set `ranges = [{listed}]` in the motor's options, or load {ours:g}.",
                )
        await super().enable()

    def query(self) -> None:
        """Request its state."""
        self.count_query()
        self._send_access(_REFRESH, 0, 0, self.node)


DAMIAO = Profile(
    "damiao",
    "Damiao actuators in MIT mode.",
    DamiaoOptions,
    DamiaoDrive,
    "rcp_can.sim.damiao:DamiaoTwin",
    NODES,
    family="mit",
)
