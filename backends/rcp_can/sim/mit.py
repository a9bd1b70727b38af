"""Simulated actuators with the MIT protocol."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

from rcp_can.codec import Span
from rcp_can.profiles.mit import MODELS, Ranges, command_codec, reply_codec
from rcp_can.sim.plant import Plant
from rcp_can.sim.twin import Twin

if TYPE_CHECKING:
    import can

__all__ = ["DamiaoTwin", "MitTwin", "TMotorTwin"]


class MitTwin(Twin):
    """A mini-cheetah; options `model` or `ranges`, and `reply_id`, as in the profile."""

    model = "mini-cheetah"
    extra: tuple[Span, ...] = ()

    def __init__(self, node: int, plant: Plant | None = None, **options: Any) -> None:
        super().__init__(node, plant, **options)
        ranges = options.get("ranges")
        span = Ranges(*ranges) if ranges else MODELS[options.get("model", self.model)]
        self._command, self._reply = command_codec(span), reply_codec(span, *self.extra)
        self.fault = 0

    def boot(self) -> None:
        """Reboot."""
        super().boot()
        self.fault = 0

    def break_down(self) -> None:
        """Trip on over-current."""
        super().break_down()
        self.fault = 2

    def take(self, message: can.Message) -> None:
        """Handle a set-point or one of the special frames, and respond."""
        if message.arbitration_id != self.node or message.is_extended_id or len(message.data) < 8:
            return
        data = bytes(message.data)
        self.feed()
        if data[:7] == b"\xff" * 7 and data[7] >= 0xFB:
            self._special(data[7])
        elif self.enabled:
            values = self._command.decode(data)
            self.plant.impedance(
                values["position"], values["velocity"], values["kp"], values["kd"], values["torque"]
            )
            mode = "position" if values["kp"] else "velocity" if values["kd"] else "torque"
            self.took(mode, values[mode])
        self.answer()

    def _special(self, code: int) -> None:
        match code:
            case 0xFC if not self.refuses and not self.fault:
                self.enabled = True
                self.plant.impedance(0, 0, 0, 0, 0)
            case 0xFD:
                self.enabled = False
                self.plant.off()
                self._clear_by_disabling()
            case 0xFE:
                self.plant.position = 0.0
            case 0xFB:
                self.fault = 0
            case _:
                pass

    def _clear_by_disabling(self) -> None:
        self.fault = 0

    def more(self) -> dict[str, float]:
        """Return the fields that a make appends to its responses."""
        return {"id": self.node}

    def answer(self) -> None:
        """Send the state."""
        plant = self.plant
        data = self._reply.encode(
            position=plant.position, velocity=plant.velocity, torque=plant.torque, **self.more()
        )
        self.send(self.options.get("reply_id", 0), data)


class TMotorTwin(MitTwin):
    """A T-Motor AK."""

    extra = (Span("temperature", 8), Span("fault", 8))

    def more(self) -> dict[str, float]:
        """Add temperature and fault."""
        return {"id": self.node, "temperature": self.plant.temperature + 40, "fault": self.fault}


class DamiaoTwin(MitTwin):
    """A Damiao, with its registers and watchdog."""

    model = "4310"
    extra = (Span("drive", 8), Span("motor", 8))

    def __init__(self, node: int, plant: Plant | None = None, **options: Any) -> None:
        super().__init__(node, plant, **options)
        self.registers: dict[int, bytes] = {
            7: struct.pack("<I", options.get("reply_id", 0)),
            8: struct.pack("<I", node),
            9: struct.pack("<I", 0),
            10: struct.pack("<I", 1),
        }

    def _clear_by_disabling(self) -> None:
        """Keep the fault: it has a command of its own."""

    def break_down(self) -> None:
        """Trip on over-current."""
        super().break_down()
        self.fault = 0xA

    def more(self) -> dict[str, float]:
        """Add state and temperatures."""
        state = self.fault or int(self.enabled)
        return {"id": state << 4 | self.node & 0xF, "drive": 30, "motor": self.plant.temperature}

    def take(self, message: can.Message) -> None:
        """Handle register accesses as well."""
        data = bytes(message.data)
        if message.arbitration_id != 0x7FF or len(data) < 4:
            super().take(message)
            return
        node, command, register = struct.unpack_from("<HBB", data)
        if node != self.node:
            return
        if command == 0xCC:
            self.answer()
            return
        if command == 0x55 and len(data) == 8:
            self.registers[register] = data[4:]
        elif command != 0x33:
            return
        value = self.registers.get(register, bytes(4))
        reply = struct.pack("<HBB", self.node, command, register) + value
        self.send(self.options.get("reply_id", 0), reply)

    def tick(self, now: float) -> None:
        """Check the watchdog."""
        timeout = int.from_bytes(self.registers[9], "little") * 50e-6
        if self.enabled and timeout and self.is_quiet(timeout):
            self.enabled, self.fault = False, 0xD
            self.plant.off()
