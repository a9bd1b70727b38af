"""Simulated actuators with the MIT protocol."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rcp_can.codec import Span
from rcp_can.profiles.mit import MODELS, Ranges, command_codec, reply_codec
from rcp_can.sim.plant import Plant
from rcp_can.sim.twin import Twin

if TYPE_CHECKING:
    import can

__all__ = ["MitTwin", "TMotorTwin"]


class MitTwin(Twin):
    """A mini-cheetah; options `model` or `ranges`, and `reply_id`, as in the profile."""

    model = "mini-cheetah"
    extra: tuple[Span, ...] = ()

    def __init__(self, node: int, plant: Plant | None = None, **options: Any) -> None:
        super().__init__(node, plant, **options)
        ranges = options.get("ranges")
        self.span = Ranges(*ranges) if ranges else MODELS[options.get("model", self.model)]
        self._command = command_codec(self.span)
        self._reply = reply_codec(self.span, *self.extra)
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
            case 0xFE if not self.keeps_zero:
                self.plant.position = 0.0
            case 0xFB:
                self.fault = 0
            case _:
                pass

    def _clear_by_disabling(self) -> None:
        self.fault = 0

    @property
    def reply_id(self) -> int:
        """The identifier of its responses."""
        return self.options.get("reply_id", 0)

    def more(self) -> dict[str, float]:
        """Return the fields that a make appends to its responses."""
        return {"id": self.node}

    def answer(self) -> None:
        """Send the state."""
        plant = self.plant
        data = self._reply.encode(
            position=plant.position, velocity=plant.velocity, torque=plant.torque, **self.more()
        )
        self.send(self.reply_id, data)


class TMotorTwin(MitTwin):
    """A T-Motor AK."""

    extra = (Span("temperature", 8), Span("fault", 8))

    def more(self) -> dict[str, float]:
        """Add temperature and fault."""
        return {"id": self.node, "temperature": self.plant.temperature + 40, "fault": self.fault}
