"""A simulated VESC."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from rcp_can.profiles.vesc import MESSAGES
from rcp_can.sim.plant import Plant
from rcp_can.sim.twin import Twin

if TYPE_CHECKING:
    import can

__all__ = ["VescTwin"]

_SILENCE = 1.0  # s without messages after which it releases the motor, VESC Tool's default
_NAMES = {command: name for name, (command, _) in MESSAGES.items()}


class VescTwin(Twin):
    """One controller; options `pole_pairs` and `torque_constant` as in the profile."""

    def __init__(self, node: int, plant: Plant | None = None, **options: Any) -> None:
        super().__init__(node, plant, **options)
        self.poles: int = options.get("pole_pairs", 7)
        self.constant: float = options.get("torque_constant", 0.05)
        self._per_erpm = 2 * math.pi / 60 / self.poles

    def take(self, message: can.Message) -> None:
        """Handle a set-point."""
        identifier = message.arbitration_id
        if not message.is_extended_id or identifier & 0xFF != self.node:
            return
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
