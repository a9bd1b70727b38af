"""A simulated ODrive."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rcp_can.profiles.odrive import MESSAGES
from rcp_can.sim.plant import Plant
from rcp_can.sim.twin import Twin

if TYPE_CHECKING:
    import can

__all__ = ["OdriveTwin"]

_NAMES = {command: name for name, (command, _) in MESSAGES.items()}
_WATCHDOG = 24  # bit of the error
_DONE = 0.01  # rad


class OdriveTwin(Twin):
    """An axis; options: `serial`, `watchdog` (s), `heartbeat` and `feedback` (periods, s)."""

    def __init__(self, node: int, plant: Plant | None = None, **options: Any) -> None:
        super().__init__(node, plant, **options)
        self.error = 0
        self.state = 1
        self.control, self.input = 2, 1
        self.watchdog: float | None = options.get("watchdog")
        self._homing = 0.0
        self._heartbeat = options.get("heartbeat", 0.05)
        self._feedback = options.get("feedback", 0.01)

    def boot(self) -> None:
        """Reboot."""
        super().boot()
        self.error, self.state = 0, 0
        self._transmit("heartbeat")
        self.state = 1

    def break_down(self) -> None:
        """Trip on over-current."""
        super().break_down()
        self.error, self.state = 1 << 12, 1

    def take(self, message: can.Message) -> None:
        """Handle a command or a request."""
        if message.arbitration_id >> 5 != self.node or message.is_extended_id:
            return
        name = _NAMES.get(message.arbitration_id & 0x1F)
        if name is None:
            return
        if message.is_remote_frame:
            self._transmit(name)
            return
        handler = getattr(self, f"_on_{name}", None)
        if handler is not None:
            layout = MESSAGES[name][1]
            try:
                handler(**layout.decode(message.data.ljust(layout.size, b"\0")))
            except ValueError:
                return

    def _on_state(self, state: int) -> None:
        if state in (8, 11) and not self.refuses and not self.error:
            self.enabled = True
            self.state = int(state)
            self.feed()
            if state == 11:
                self._homing = 0.3
            else:
                self.plant.hold()
        elif state == 1:
            self.enabled = False
            self.state = 1
            self.plant.off()

    def _on_mode(self, control: int, input: int) -> None:  # noqa: A002
        self.control, self.input = int(control), int(input)

    def _feed(self, name: str, control: int, value: float) -> bool:
        self.feed()
        if not self.enabled or self.control != control or self.state != 8:
            return False
        self.took(name, value)
        self.plant.goal = value
        return True

    def _on_position(self, position: float, velocity: float, torque: float) -> None:
        if self._feed("position", 3, position):
            self.plant.loop = "position"
            if self.input != 5:
                self.plant.speed, self.plant.ramp = self.plant.velocity_limit, None

    def _on_velocity(self, velocity: float, torque: float) -> None:
        if self._feed("velocity", 2, velocity):
            self.plant.loop, self.plant.ramp = "velocity", None

    def _on_torque(self, torque: float) -> None:
        if self._feed("torque", 1, torque):
            self.plant.loop = "torque"

    def _on_trap_velocity(self, velocity: float) -> None:
        self.plant.speed = max(velocity, 0.01)

    def _on_trap_acceleration(self, acceleration: float, deceleration: float) -> None:
        self.plant.ramp = max(acceleration, 0.01)

    def _on_clear(self, identify: int) -> None:
        self.error = 0

    def _on_absolute(self, position: float) -> None:
        self.plant.position = position

    def tick(self, now: float) -> None:
        """Send heartbeat and feedback; check the watchdog."""
        step = 0.005
        if self.enabled and self.watchdog is not None and self.is_quiet(self.watchdog):
            super().break_down()
            self.error, self.state = 1 << _WATCHDOG, 1
        if self.state == 11:
            self._homing -= step
            if self._homing <= 0:
                self.state, self.plant.position = 8, 0.0
                self.plant.hold()
        if not self.heartless and self.every("heartbeat", self._heartbeat, now):
            self._transmit("heartbeat")
        if not self.blind and self.every("feedback", self._feedback, now):
            self._transmit("encoder")
        if self.every("current", 0.05, now):
            self._transmit("current")
            self._transmit("torques")

    def _values(self, name: str) -> dict[str, float] | None:
        plant = self.plant
        serial: int = self.options.get("serial", 0x1000 + self.node)
        match name:
            case "heartbeat":
                done = self.control == 3 and abs(plant.goal - plant.position) < _DONE
                done = done and abs(plant.velocity) < 0.1
                return {"error": self.error, "state": self.state, "done": done}
            case "error":
                return {"active": self.error}
            case "address":
                return {"node": self.node, "serial_low": serial}
            case "encoder":
                return {"position": plant.position, "velocity": plant.velocity}
            case "current":
                return {"set_point": plant.torque / 0.1, "measured": plant.torque / 0.1}
            case "torques":
                return {"target": plant.torque, "estimate": plant.torque}
            case "temperature":
                return {"drive": 30.0, "motor": plant.temperature}
            case "supply":
                return {"voltage": 24.0, "current": 0.5}
            case _:
                return None

    def _transmit(self, name: str) -> None:
        values = self._values(name)
        if values is not None:
            command, layout = MESSAGES[name]
            self.send(self.node << 5 | command, layout.encode(**values).ljust(8, b"\0"))
