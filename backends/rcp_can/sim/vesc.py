"""A simulated VESC."""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING, Any

from rcp_can.profiles import vesc_settings as settings
from rcp_can.profiles.vesc import MESSAGES
from rcp_can.profiles.vesc_packets import PING, PONG, Assembler, frames
from rcp_can.sim.plant import Plant
from rcp_can.sim.twin import Twin

if TYPE_CHECKING:
    import can

__all__ = ["VescTwin"]

_SILENCE = 1.0  # s without messages after which it releases the motor, VESC Tool's default
_SET_SIZE = 5 + 40  # bytes of a command that sets limits
_NAMES = {command: name for name, (command, _) in MESSAGES.items()}


class VescTwin(Twin):
    """One controller; options `pole_pairs` and `torque_constant` as in the profile."""

    def __init__(self, node: int, plant: Plant | None = None, **options: Any) -> None:
        super().__init__(node, plant, **options)
        self.poles: int = options.get("pole_pairs", 7)
        self.constant: float = options.get("torque_constant", 0.05)
        self._per_erpm = 2 * math.pi / 60 / self.poles
        self.firmware = 6, 0
        self.limits = [1.0, 1.0, -1e5, 1e5, 0.005, 0.95, -1.5e6, 1.5e6, -60.0, 99.0]
        """In the order of the packets."""
        self.hardware_limits = {3: 120_000.0}
        """What its hardware allows at most, by place."""
        self.signature = 486554156
        self.stored = list(self.limits)
        self.stores = 0
        """How often it has stored anything."""
        self.rest = bytes(range(256)) + bytes(180)
        """The application's configuration after the id."""
        self._packets = Assembler()

    def boot(self) -> None:
        """Reboot with what is stored."""
        super().boot()
        self.limits = list(self.stored)

    def _packet(self, frame: int, data: bytes) -> None:
        """Handle a frame of a packet, or a ping."""
        if frame == PING and data:
            self.send(PONG << 8 | data[0], bytes((self.node, 0)), is_extended_id=True)
            return
        packet = self._packets.take(frame, data)
        if packet is None:
            return
        sender, payload = packet
        if (answer := self._answer(payload)) is not None:
            for identifier, part in frames(answer, to=sender, sender=self.node, answers=True):
                self.send(identifier, part, is_extended_id=True)

    def _answer(self, payload: bytes) -> bytes | None:
        """Return the answer to a command; None to those that it does not know."""
        match payload[0]:
            case settings.VERSION:
                serial = bytes(range(11)) + bytes((self.node,))
                return bytes((settings.VERSION, *self.firmware)) + b"410\0" + serial + bytes(4)
            case settings.GET_LIMITS:
                told = struct.pack(">Bff", 2 * self.poles, 3.0, 0.083)
                return payload[:1] + struct.pack(">10f", *self.limits) + told
            case settings.SET_LIMITS if len(payload) == _SET_SIZE:
                self._set_limits(payload)
                return payload[:1] if payload[3] else None
            case settings.GET_APP:
                head = self.signature.to_bytes(4, "big") + bytes((self.node,))
                return payload[:1] + head + self.rest
            case settings.SET_APP if payload[1:5] == self.signature.to_bytes(4, "big"):
                self.node, self.rest = payload[5], payload[6:]
                self.stores += 1
                return payload[:1]
            case _:
                return None

    def _set_limits(self, payload: bytes) -> None:
        for place, value in enumerate(struct.unpack(">10f", payload[5:])):
            self.limits[place] = min(value, self.hardware_limits.get(place, value))
        if payload[1]:
            self.stored, self.stores = list(self.limits), self.stores + 1

    def take(self, message: can.Message) -> None:
        """Handle a set-point."""
        identifier = message.arbitration_id
        if not message.is_extended_id or identifier & 0xFF != self.node:
            return
        self._packet(identifier >> 8, bytes(message.data))
        name = _NAMES.get(identifier >> 8, "")
        if name not in ("duty", "current", "brake", "rpm"):
            return
        layout = MESSAGES[name][1]
        if len(message.data) < layout.size:
            return
        value = next(iter(layout.decode(message.data).values()))
        plant = self.plant
        self.feed()
        self.enabled = True
        match name:
            case "rpm":
                plant.loop, plant.goal = "velocity", value * self._per_erpm
                self.took("velocity", plant.goal)
            case "current":
                plant.loop, plant.goal = "torque", value * self.constant
                self.enabled = value != 0.0
                self.took("torque", plant.goal)
            case "duty":
                plant.loop, plant.goal = "velocity", value * plant.velocity_limit
            case _:
                plant.hold()

    def tick(self, now: float) -> None:
        """Send its state; release the motor when no set-point arrives."""
        if self.is_quiet(_SILENCE):
            self.enabled = False
            self.plant.off()
        plant = self.plant
        if not self.blind and self.every("status", 0.02, now):
            current = plant.torque / self.constant
            self._transmit("status", erpm=plant.velocity / self._per_erpm, current=current)
            turns = plant.position / (2 * math.pi)
            self._transmit("status_5", tachometer=turns * 6 * self.poles, voltage=24.0)
        if self.every("status_4", 0.1, now):
            self._transmit("status_4", drive=32.0, motor=plant.temperature)

    def _transmit(self, name: str, **values: float) -> None:
        command, layout = MESSAGES[name]
        self.send(command << 8 | self.node, layout.encode(**values), is_extended_id=True)
