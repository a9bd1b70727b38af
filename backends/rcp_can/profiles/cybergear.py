"""Xiaomi CyberGear: MIT-style control in 29-bit identifiers, type << 24 | data << 8 | id."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated

from msgspec import Meta

from rcp_can.asking import answer_to
from rcp_can.bus import Bus, Route
from rcp_can.codec import Packed, Span
from rcp_can.drive import Fault, Identity, Profile, Protection, Reach, StopFrame
from rcp_can.node_change import NodeChange, node_procedure
from rcp_can.procedure import Procedure
from rcp_can.profiles.cybergear_settings import CyberGearSettings
from rcp_can.profiles.impedance import FAST, Gains, ImpedanceDrive
from rcp_can.profiles.torque_rounding import TorqueRounding
from rcp_can.settings_procedures import settings_procedures
from rcp_kernel.errors import DeviceRejected, DeviceTimeout

if TYPE_CHECKING:
    import can

__all__ = ["COMMAND", "FEEDBACK", "PROFILE", "TORQUE", "CyberGearDrive", "CyberGearOptions"]

_CONTROL, _FEEDBACK, _ENABLE, _STOP, _ZERO, _READ, _WRITE = 1, 2, 3, 4, 6, 17, 18
_IDENTIFY, _SET_ID, _ANYBODY = 0, 7, 0xFE
_P, _V, _T = 4 * math.pi, 30.0, 12.0
_RUN_MODE, _CAN_TIMEOUT = 0x7005, 0x7028
_RUNNING = 2
NODES = range(1, 128)
_TICKS = 20_000  # timer steps per second
_ANSWERS = 0.5  # s for a parameter's response
_PROBED = 0.3  # s for another drive to answer
_CHANGED = 1.0  # s for the drive to answer to another id

COMMAND = Packed(
    Span("position", 16, -_P, _P),
    Span("velocity", 16, -_V, _V),
    Span("kp", 16, 0.0, 500.0),
    Span("kd", 16, 0.0, 5.0),
)
TORQUE = Packed(Span("torque", 16, -_T, _T))
"""The torque of a set-point, in the middle bits of its identifier."""
FEEDBACK = Packed(
    Span("position", 16, -_P, _P),
    Span("velocity", 16, -_V, _V),
    Span("torque", 16, -_T, _T),
    Span("temperature", 16),
)
_FAULTS = (
    "under-voltage",
    "over-current",
    "over-temperature",
    "magnetic encoder",
    "hall encoder",
    "not calibrated",
)


class CyberGearOptions(Gains, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Gains, and the gateway's id."""

    host: Annotated[int, Meta(ge=0, le=0xFF)] = 0xFD
    """Id to which the drive responds."""


class CyberGearDrive(ImpedanceDrive):
    """A CyberGear in operation control mode."""

    def __init__(self, node: int, options: CyberGearOptions, bus: Bus) -> None:
        super().__init__(node, options, bus)
        self._rounding = TorqueRounding(COMMAND, TORQUE)
        self._parameters: dict[int, int] = {}
        self._refused: set[int] = set()
        """The parameters that it does not have, as it says."""

    def procedures(self, gear: float, velocity: float) -> Sequence[Procedure]:
        """Offer its parameters, and another id."""
        return (
            *settings_procedures(CyberGearSettings(self)),
            node_procedure(self.node, NODES, self.neighbours, self._change_node, self._is_there),
        )

    def routes(self) -> tuple[Route, ...]:
        """Return its feedback, with any data in the identifier, and its parameter responses."""
        low = self.node << 8 | self.options.host
        return tuple(
            Route(kind << 24 | low, 0x1F00FFFF, extended=True) for kind in (_FEEDBACK, _READ)
        )

    def reach(self) -> Reach:
        """Return the ranges of the payload."""
        return Reach(_P, _V, _T)

    def take(self, message: can.Message) -> bool:
        """Decode feedback or a parameter."""
        if message.arbitration_id >> 24 == _READ:
            return self._on_parameter(message.arbitration_id >> 16 & 0xFF, bytes(message.data))
        values = FEEDBACK.decode(message.data)
        word, status = message.arbitration_id >> 16, self.status
        status.position, status.velocity = values["position"], values["velocity"]
        status.torque = values["torque"]
        status.motor_temperature = values["temperature"] / 10
        status.enabled = word >> 6 & 3 == _RUNNING
        status.faults = tuple(
            Fault(text.replace(" ", "_"), text, bit)
            for bit, text in enumerate(_FAULTS)
            if word >> bit & 1
        )
        self.answered()
        status.moved += 1
        status.reports += 1
        return True

    def _on_parameter(self, failed: int, data: bytes) -> bool:
        if len(data) < 8:
            raise ValueError("a parameter has 8 bytes")
        self.answered()
        index, value = struct.unpack("<HxxI", data[:8])
        if failed:
            self._refused.add(index)
        else:
            self._parameters[index] = value
        self.status.reports += 1
        return True

    def _transmit(
        self, kind: int, data: bytes = bytes(8), *, word: int | None = None, **more: bool
    ) -> None:
        middle = self.options.host if word is None else word
        self.count_query()
        urgent = more.get("urgent", False)
        self.send(
            kind << 24 | middle << 8 | self.node,
            data,
            extended=True,
            urgent=urgent,
            lifetime=None if urgent else FAST,
        )

    def impede(
        self,
        position: float = 0.0,
        velocity: float = 0.0,
        kp: float = 0.0,
        kd: float = 0.0,
        torque: float = 0.0,
        *,
        urgent: bool = False,
    ) -> None:
        """Send one set-point."""
        torque = self._rounding.next(velocity, kd, torque)
        word = int.from_bytes(TORQUE.encode(torque=torque), "big")
        data = COMMAND.encode(position=position, velocity=velocity, kp=kp, kd=kd)
        self._transmit(_CONTROL, data, word=word, urgent=urgent)

    def query(self) -> None:
        """Send the stop command to a drive that is off: it responds without moving."""
        self._transmit(_STOP)

    def _parameter(self, index: int, value: bytes) -> None:
        self._transmit(_WRITE, struct.pack("<Hxx", index) + value.ljust(4, b"\0"))

    async def read_parameter(self, index: int) -> int:
        """Read a parameter, as its raw 32 bits.

        :raises DeviceRejected: it has none with this index.
        :raises DeviceTimeout: it does not answer.
        """
        self._parameters.pop(index, None)
        self._refused.discard(index)
        await self.until(
            lambda: index in self._parameters or index in self._refused,
            f"telling parameter 0x{index:04X}",
            again=lambda: self._transmit(_READ, struct.pack("<Hxxxxxx", index)),
            faults=False,
        )
        if index in self._refused:
            raise DeviceRejected(f"the drive has no parameter 0x{index:04X}")
        return self._parameters[index]

    async def write_parameter(self, index: int, raw: int) -> None:
        """Write a parameter until it reads as written, or the drive keeps another value.

        The answer to a write does not tell whether it was taken.
        """
        self._parameters.pop(index, None)

        def write() -> None:
            self._parameter(index, struct.pack("<I", raw))
            self._transmit(_READ, struct.pack("<Hxxxxxx", index))

        with suppress(DeviceTimeout):  # the reader tells
            await self.until(
                lambda: self._parameters.get(index) == raw,
                f"keeping parameter 0x{index:04X}",
                again=write,
                seconds=_ANSWERS,
                faults=False,
            )

    async def _ask_who(self, node: int, send: Callable[[], object], seconds: float) -> bytes | None:
        """Return the number of the processor of whichever drive has an id; None if none answers."""
        route = Route(_IDENTIFY << 24 | node << 8 | _ANYBODY, extended=True, mask=0x1FFFFFFF)
        found = await answer_to(self.bus, (route,), send, lambda _message: True, seconds=seconds)
        return None if found is None else bytes(found.data)

    def _identify(self, node: int) -> None:
        head = _IDENTIFY << 24 | self.options.host << 8 | node
        self.send(head, bytes(8), extended=True, lifetime=FAST)

    async def _is_there(self, node: int) -> bool:
        return await self._ask_who(node, lambda: self._identify(node), _PROBED) is not None

    async def _change_node(self, wanted: NodeChange, begun: Callable[[], object]) -> None:
        node = wanted.node
        serial = await self._ask_who(self.node, lambda: self._identify(self.node), _ANSWERS)
        if serial is None:
            raise DeviceTimeout(
                f"node {self.node} does not tell the number of its processor",
                remedy="Nothing was written; check the bus (sensor/can/…/state), then send it again.",
            )
        begun()
        head = _SET_ID << 24 | node << 16 | self.options.host << 8 | self.node
        self.send(head, b"\1" + bytes(7), extended=True)
        found = await self._ask_who(node, lambda: self._identify(node), _CHANGED)
        if found is None:
            raise DeviceTimeout(f"nothing answers to the id {node} after the drive was to take it")
        if found != serial:
            raise DeviceRejected(f"another drive than this one answers to the id {node}")

    async def configure(self) -> None:
        """Set the watchdog, and ask who it is."""
        await self._set_watchdog()
        serial = await self._ask_who(self.node, lambda: self._identify(self.node), _ANSWERS)
        self.identity = Identity(
            vendor="Xiaomi", model="CyberGear", serial=None if serial is None else serial.hex()
        )

    async def _set_watchdog(self) -> None:
        """Set the watchdog, in 50 µs, and read it back; older firmware has none."""
        wanted = None if self.watchdog is None else round(self.watchdog * _TICKS)
        self._parameters.clear()

        def query() -> None:
            if wanted is not None:
                self._parameter(_CAN_TIMEOUT, struct.pack("<I", wanted))
            self._transmit(_READ, struct.pack("<Hxxxxxx", _CAN_TIMEOUT))

        def reported() -> bool:
            found = self._parameters.get(_CAN_TIMEOUT)
            return found is not None and wanted in (None, found)

        try:
            await self.until(
                reported, "reporting its canTimeout", again=query, seconds=_ANSWERS, faults=False
            )
        except DeviceTimeout:
            self.protection = Protection(
                "canTimeout (0x7028) was not accepted: older firmware has none"
            )
            return
        if seconds := self._parameters[_CAN_TIMEOUT] / _TICKS:
            text = f"canTimeout (0x7028) = {seconds * 1000:g} ms: it switches itself off"
            self.protection = Protection(text, seconds, verified=True)
        else:
            self.protection = Protection("canTimeout (0x7028) = 0: its watchdog is off")

    async def enable(self) -> None:
        """Select operation control and run with zero gains."""

        def query() -> None:
            self._parameter(_RUN_MODE, b"\0")
            self._transmit(_ENABLE)

        await self.until(lambda: bool(self.status.enabled), "enabled", again=query)

    async def disable(self) -> None:
        """Send stop."""
        await self.until(
            lambda: self.status.enabled is False, "disabled", again=self.query, faults=False
        )

    def stop_frames(self) -> Sequence[StopFrame]:
        """Damp as in a quick stop: a drive that is off ignores it."""
        kd = self._gains.brake
        torque = self._rounding.single(0.0, kd, 0.0)
        word = int.from_bytes(TORQUE.encode(torque=torque), "big")
        data = COMMAND.encode(kd=kd)
        return (StopFrame(_CONTROL << 24 | word << 8 | self.node, data, extended=True),)

    async def clear_faults(self) -> None:
        """Send stop, with the bit that clears faults."""
        await self.until(
            lambda: not self.status.faults and not self.status.enabled,
            "free of faults",
            again=lambda: self._transmit(_STOP, b"\1" + bytes(7)),
            faults=False,
        )

    async def set_zero(self) -> None:
        """Set the current position as zero."""
        await self.until_zero(lambda: self._transmit(_ZERO, b"\1" + bytes(7)))


PROFILE = Profile(
    "cybergear",
    "Xiaomi CyberGear.",
    CyberGearOptions,
    CyberGearDrive,
    "rcp_can.sim.cybergear:CyberGearTwin",
    NODES,
)
