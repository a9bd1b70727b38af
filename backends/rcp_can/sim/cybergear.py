"""A simulated CyberGear."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

from rcp_can.profiles.cybergear import COMMAND, FEEDBACK, TORQUE
from rcp_can.profiles.cybergear_settings import PARAMETERS
from rcp_can.sim.plant import Plant
from rcp_can.sim.twin import Twin

if TYPE_CHECKING:
    import can

__all__ = ["CyberGearTwin"]

_TIMEOUT = 0x7028
_FACTORY = {
    "limit_torque": 12.0,
    "cur_kp": 0.125,
    "cur_ki": 0.0158,
    "cur_filt_gain": 0.1,
    "limit_spd": 30.0,
    "limit_cur": 23.0,
    "loc_kp": 30.0,
    "spd_kp": 1.0,
    "spd_ki": 0.002,
}
_SET_POINTS = 0x7006, 0x700A, 0x7016


class CyberGearTwin(Twin):
    """One actuator."""

    def __init__(self, node: int, plant: Plant | None = None, **options: Any) -> None:
        super().__init__(node, plant, **options)
        self.faults = 0
        self.serial = struct.pack(">Q", 0x4359_4247_0000_0000 | node)
        """The number of its processor."""
        self.anonymous = False
        """Does not tell that number."""
        self.keeps: set[int] = set()
        """Parameters that it answers to but does not change."""
        self.parameters = _parameters()
        self._host = options.get("host", 0xFD)

    def boot(self) -> None:
        """Reboot; the watchdog is off again."""
        super().boot()
        self.faults = 0
        self.parameters = _parameters()

    def break_down(self) -> None:
        """Trip on over-current."""
        super().break_down()
        self.faults = 1 << 1

    def take(self, message: can.Message) -> None:
        """Handle a command, and respond."""
        identifier, data = message.arbitration_id, bytes(message.data)
        if not message.is_extended_id or identifier & 0xFF != self.node or len(data) < 8:
            return
        kind, word = identifier >> 24, identifier >> 8 & 0xFFFF
        host = word & 0xFF
        self.feed()
        if kind != 1:
            self._host = host
        match kind:
            case 0:
                self._identify()
                return
            case 1:
                self._control(data, word)
                host = self._host
            case 3:
                if not self.refuses and not self.faults:
                    self.enabled = True
                    self.plant.impedance(0, 0, 0, 0, 0)
            case 4:
                self.enabled = False
                self.plant.off()
                if data[0]:
                    self.faults = 0
            case 6:
                if not self.keeps_zero:
                    self.plant.position = 0.0
            case 7:
                self.node = word >> 8  # stored at once
                self._identify()
                return
            case 17:
                index = struct.unpack_from("<H", data)[0]
                value = self.parameters.get(index)
                head = 17 << 24 | (value is None) << 16 | self.node << 8 | host
                self.send(head, data[:4] + (value or bytes(4)), is_extended_id=True)
                return
            case 18:
                self._write(struct.unpack_from("<H", data)[0], data[4:])
            case _:
                return
        self._answer(host)

    def _identify(self) -> None:
        if not self.anonymous:
            self.send(self.node << 8 | 0xFE, self.serial, is_extended_id=True)

    def _write(self, index: int, data: bytes) -> None:
        if index in self.parameters and index not in self.keeps:
            self.parameters[index] = data
            self._set(index, data)

    def _control(self, data: bytes, word: int) -> None:
        if not self.enabled:
            return
        values = COMMAND.decode(data)
        torque = TORQUE.decode(word.to_bytes(2, "big"))["torque"]
        self.plant.impedance(**values, torque=torque)
        mode = "position" if values["kp"] else "velocity" if values["kd"] else "torque"
        self.took(mode, torque if mode == "torque" else values[mode])

    def _set(self, index: int, data: bytes) -> None:
        """Apply the set-points of the other modes: speed reference and current reference."""
        if not self.enabled or index not in (0x700A, 0x7006, 0x7016):
            return
        value = struct.unpack("<f", data)[0]
        mode = int.from_bytes(self.parameters.get(0x7005, b"\0")[:1], "little")
        if index == 0x700A and mode == 2:
            self.plant.loop, self.plant.goal = "velocity", value
        elif index == 0x7016 and mode == 1:
            self.plant.loop, self.plant.goal = "position", value
        elif index == 0x7006 and mode == 3:
            self.plant.loop, self.plant.goal = "torque", value

    def _answer(self, host: int) -> None:
        plant = self.plant
        state = 2 if self.enabled else 0
        identifier = 2 << 24 | state << 22 | self.faults << 16 | self.node << 8 | host
        data = FEEDBACK.encode(
            position=plant.position,
            velocity=plant.velocity,
            torque=plant.torque,
            temperature=plant.temperature * 10,
        )
        self.send(identifier, data, is_extended_id=True)

    def tick(self, now: float) -> None:
        """Check the watchdog."""
        timeout = int.from_bytes(self.parameters.get(_TIMEOUT, b""), "little") * 50e-6
        if self.enabled and timeout and self.is_quiet(timeout):
            self.enabled = False
            self.plant.off()


def _parameters() -> dict[int, bytes]:
    """Return the parameters after a boot: it stores none."""
    found = {index: bytes(4) for index in _SET_POINTS}
    for name, each in PARAMETERS.items():
        found[each.number] = struct.pack("<f", _FACTORY[name]) if name in _FACTORY else bytes(4)
    return found
