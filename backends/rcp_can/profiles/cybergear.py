"""Xiaomi CyberGear: MIT-style control in 29-bit identifiers, type << 24 | data << 8 | id."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

from msgspec import Meta

from rcp_can.bus import Bus, Route
from rcp_can.codec import Packed, Span
from rcp_can.drive import Fault, Profile, Protection, Reach, StopFrame
from rcp_can.profiles.impedance import FAST, Gains, ImpedanceDrive
from rcp_kernel.errors import DeviceTimeout

if TYPE_CHECKING:
    import can

__all__ = ["COMMAND", "FEEDBACK", "PROFILE", "TORQUE", "CyberGearDrive", "CyberGearOptions"]

_CONTROL, _FEEDBACK, _ENABLE, _STOP, _ZERO, _READ, _WRITE = 1, 2, 3, 4, 6, 17, 18
_P, _V, _T = 4 * math.pi, 30.0, 12.0
_RUN_MODE, _CAN_TIMEOUT = 0x7005, 0x7028
_RUNNING = 2
_TICKS = 20_000  # timer steps per second
_ANSWERS = 0.5  # s for a parameter's response

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
        self._parameters: dict[int, int] = {}

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
        if not failed:
            index, value = struct.unpack("<HxxI", data[:8])
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
        word = int.from_bytes(TORQUE.encode(torque=torque), "big")
        data = COMMAND.encode(position=position, velocity=velocity, kp=kp, kd=kd)
        self._transmit(_CONTROL, data, word=word, urgent=urgent)

    def query(self) -> None:
        """Send the stop command to a drive that is off: it responds without moving."""
        self._transmit(_STOP)

    def _parameter(self, index: int, value: bytes) -> None:
        self._transmit(_WRITE, struct.pack("<Hxx", index) + value.ljust(4, b"\0"))

    async def configure(self) -> None:
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
        word = int.from_bytes(TORQUE.encode(torque=0.0), "big")
        data = COMMAND.encode(kd=self._gains.brake)
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
        self._transmit(_ZERO, b"\1" + bytes(7))
        await self.until(lambda: abs(self.status.position or 0.0) < 0.05, "at zero")


PROFILE = Profile(
    "cybergear",
    "Xiaomi CyberGear.",
    CyberGearOptions,
    CyberGearDrive,
    "rcp_can.sim.cybergear:CyberGearTwin",
    range(1, 128),
)
