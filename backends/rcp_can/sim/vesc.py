"""A simulated VESC."""

from __future__ import annotations

import copy
import math
import struct
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rcp_can.profiles import vesc_settings as settings
from rcp_can.profiles.vesc import MESSAGES
from rcp_can.profiles.vesc_detection import ALIVE, DETECT, GET_MOTOR, PRINT, REBOOT, TERMINAL
from rcp_can.profiles.vesc_packets import PING, PONG, Assembler, frames
from rcp_can.sim.plant import Plant
from rcp_can.sim.twin import Twin
from rcp_can.sim.vesc_detection import Detection, MotorConfiguration

if TYPE_CHECKING:
    import can

__all__ = ["VescTwin"]

_SILENCE = 1.0  # s without messages after which it releases the motor, VESC Tool's default
_RATES = 12  # place of the status messages in the application's configuration, after the id
_AFTER_DETECTION = 0b00001111  # status messages that a detection leaves
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
        self.rest = bytes(range(_RATES)) + b"\x1f\0" + bytes(range(242)) + bytes(180)
        """The application's configuration after the id."""
        self.motor = MotorConfiguration()
        self.stored_motor = copy.deepcopy(self.motor)
        self.detection: Detection | None = None
        """What runs now."""
        self.detects = 0.4
        """How long a detection lasts, s."""
        self.pauses = 0.3
        """How long a detection waits after each of two configurations that it stores, s; the firmware 1 s."""
        self._left: list[tuple[float, Callable[[], object]]] = []
        """What a detection that has measured still does, and when."""
        self.fails = 0
        """The result of detections, if they fail."""
        self.boots = 0.3
        """How long it is silent while it reboots, s."""
        self._booting = -math.inf
        self._origin = 0.0
        """Where its counter began, rad."""
        self._asker = 0
        self._packets = Assembler()

    def boot(self) -> None:
        """Reboot with what is stored."""
        super().boot()
        self.limits, self.motor = list(self.stored), copy.deepcopy(self.stored_motor)
        self.detection, self._packets = None, Assembler()
        self._left.clear()
        self._booting, self._origin = time.monotonic(), self.plant.position

    def _packet(self, frame: int, data: bytes) -> None:
        """Handle a frame of a packet, or a ping."""
        if frame == PING and data:
            self.send(PONG << 8 | data[0], bytes((self.node, 0)), is_extended_id=True)
            return
        packet = self._packets.take(frame, data)
        if packet is None:
            return
        sender, payload = packet
        if payload[0] in (DETECT, TERMINAL):
            if self.detection is not None:
                return  # it discards a second command that takes long
            self._asker = sender
        if (answer := self._answer(payload)) is not None:
            self._tell(sender, answer)

    def _tell(self, to: int, answer: bytes) -> None:
        for identifier, part in frames(answer, to=to, sender=self.node, answers=True):
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
                return self._application()
            case settings.SET_APP if payload[1:5] == self.signature.to_bytes(4, "big"):
                self.node, self.rest = payload[5], payload[6:]
                self.stores += 1
                return payload[:1]
            case command if command == GET_MOTOR:
                return payload[:1] + bytes(self.motor.data)
            case _:
                return self._do(payload)

    def _do(self, payload: bytes) -> bytes | None:
        """Do what is not about settings."""
        if payload[0] == REBOOT:
            self.boot()
        elif payload == ALIVE:
            return bytes((PRINT,)) + b"pong\n"
        elif Detection.is_one(payload):
            self.detection = Detection(payload, self.plant, time.monotonic(), self.detects)
            self.detection.begin(self.motor, self._set_battery)
        return None

    def _set_battery(self, least: float, most: float) -> None:
        self.limits[8], self.limits[9] = least, most

    def _detect(self, now: float) -> None:
        """Go on with a detection; once it has measured, store that in parts, and tell its result."""
        assert self.detection is not None
        if self._left:
            if now >= self._left[0][0]:
                self._left.pop(0)[1]()
            return
        result = self.detection.advance(now, self.fails)
        if result is None:
            return
        if result < 0:
            self._end(result)
            return
        self.detection.apply(self.motor, self._set_battery)
        if self.rest[_RATES] != _AFTER_DETECTION:
            rates = bytes((_AFTER_DETECTION,))
            self.rest = self.rest[:_RATES] + rates + self.rest[_RATES + 1 :]
            self.stores += 1
            self._tell(self._asker, self._application())
            now += self.pauses
        self._left = [(now, self._store_motor), (now + self.pauses, lambda: self._end(result))]

    def _store_motor(self) -> None:
        self.stored, self.stored_motor = list(self.limits), copy.deepcopy(self.motor)
        self.stores += 1
        self._tell(self._asker, bytes((GET_MOTOR,)) + bytes(self.motor.data))

    def _end(self, result: int) -> None:
        self.detection = None
        self._tell(self._asker, struct.pack(">Bh", DETECT, result))

    def _application(self) -> bytes:
        head = bytes((settings.GET_APP,)) + self.signature.to_bytes(4, "big")
        return head + bytes((self.node,)) + self.rest

    def _set_limits(self, payload: bytes) -> None:
        for place, value in enumerate(struct.unpack(">10f", payload[5:])):
            self.limits[place] = min(value, self.hardware_limits.get(place, value))
        if payload[1]:
            self.stored, self.stores = list(self.limits), self.stores + 1

    def take(self, message: can.Message) -> None:
        """Handle a set-point."""
        identifier = message.arbitration_id
        if not message.is_extended_id or identifier & 0xFF != self.node or self._boots():
            return
        self._packet(identifier >> 8, bytes(message.data))
        name = _NAMES.get(identifier >> 8, "")
        if name not in ("duty", "current", "brake", "rpm"):
            return
        layout = MESSAGES[name][1]
        if len(message.data) < layout.size or self.detection is not None:
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
        if self._boots():
            return
        if self.detection is not None:
            self._detect(now)
        elif self.is_quiet(_SILENCE):
            self.enabled = False
            self.plant.off()
        plant = self.plant
        if not self.blind and self.every("status", 0.02, now):
            current = plant.torque / self.constant
            self._transmit("status", erpm=plant.velocity / self._per_erpm, current=current)
            turns = (plant.position - self._origin) / (2 * math.pi)
            if self.rest[_RATES] & 0x10:
                self._transmit("status_5", tachometer=turns * 6 * self.poles, voltage=24.0)
        if self.every("status_4", 0.1, now):
            self._transmit("status_4", drive=32.0, motor=plant.temperature)

    def _boots(self) -> bool:
        return time.monotonic() - self._booting < self.boots

    def _transmit(self, name: str, **values: float) -> None:
        command, layout = MESSAGES[name]
        self.send(command << 8 | self.node, layout.encode(**values), is_extended_id=True)
