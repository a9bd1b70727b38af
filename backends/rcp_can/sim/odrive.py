"""A simulated ODrive."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

from rcp_can.profiles.odrive_messages import MESSAGES
from rcp_can.sim.plant import Plant
from rcp_can.sim.twin import Twin

if TYPE_CHECKING:
    import can

__all__ = ["ENDPOINTS", "OdriveTwin"]

_NAMES = {command: name for name, (command, _) in MESSAGES.items()}
_WATCHDOG = 24  # bit of the error
_DONE = 0.01  # rad
_CALIBRATING = {3: (4, 7), 4: (4,), 6: (6,), 7: (7,), 10: (10,), 12: (12,), 13: (13,), 14: (14,)}
"""The states that a requested one goes through."""
_LASTS = 0.4  # s of each
_TURNS = 3.0  # rad/s
_FIRMWARE = "firmware_major", "firmware_minor", "firmware_revision"
_BOOT = 0.3  # s without a message
_HOMES = 3.0  # rad/s towards the end stop
_OFFSET = -0.4  # rad: where the end stop is, counted from zero
ENDPOINTS = {"axis0.config.watchdog_timeout": 301, "axis0.config.enable_watchdog": 300}
"""Its settings that can be accessed, by their names in flat_endpoints.json."""


class OdriveTwin(Twin):
    """An axis; options: `serial`, `watchdog` (s), `heartbeat` and `feedback` (periods, s)."""

    def __init__(self, node: int, plant: Plant | None = None, **options: Any) -> None:
        super().__init__(node, plant, **options)
        self.error = 0
        self.state = 1
        self.control, self.input = 2, 1
        self.watchdog: float | None = options.get("watchdog")
        self._watchdog_time = self.watchdog or 0.0
        self._stored = self._watchdog_time, self.watchdog
        self.end_stop = _OFFSET
        """Position at which its end stop closes, rad."""
        self._leaving = 0.0
        """Time left to go from the end stop to zero, s; 0: it has not closed."""
        self.result = 0
        self.fails: tuple[int, int] | None = None
        """Error bits and result with which its next calibration fails."""
        self.keeps_watchdog = False
        """Ignores writes to the settings of its watchdog."""
        self.firmware = 0, 6, 10
        self.accesses: list[tuple[int, int]] = []
        """Reads and writes of its settings, by operation and number."""
        self.saved: list[float | None] = []
        """The time of the watchdog, each time that its configuration was stored."""
        self._sequence: list[tuple[int, float]] = []
        """The states of a calibration that are left, and how long each lasts, s."""
        self._booting = 0.0
        self._heartbeat = options.get("heartbeat", 0.05)
        self._feedback = options.get("feedback", 0.01)

    def boot(self) -> None:
        """Reboot."""
        super().boot()
        self.error, self.state, self.result = 0, 0, 0
        self._sequence = []
        self._watchdog_time, self.watchdog = self._stored
        self._transmit("heartbeat")
        self.state = 1

    def break_down(self) -> None:
        """Trip on over-current."""
        super().break_down()
        self._sequence = []
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
            if self._booting:
                return
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
                self._leaving = 0.0
                self.plant.loop, self.plant.goal, self.plant.ramp = "velocity", -_HOMES, None
            else:
                self.plant.hold()
        elif state in _CALIBRATING and self.state == 1 and not self.refuses and not self.error:
            self.feed()
            self.result = 1
            self._sequence = [(each, _LASTS) for each in _CALIBRATING[int(state)]]
            self._next_state()
        elif state == 1:
            self.result = 2 if self.state != 1 else self.result
            self.enabled = False
            self.state = 1
            self._sequence = []
            self.plant.off()

    def _home(self, step: float) -> None:
        """Search the end stop at whatever velocity there is, and go to zero once it has closed."""
        plant = self.plant
        if self._leaving:
            self._leaving = max(0.0, self._leaving - step)
            if not self._leaving:
                self.state = 8
                plant.hold()
        elif plant.position <= self.end_stop:
            plant.position, self.end_stop, self._leaving = _OFFSET, _OFFSET, 0.4
            plant.loop, plant.goal, plant.speed = "position", 0.0, _HOMES

    def _next_state(self) -> None:
        """Enter the next state of the calibration; each but that of the motor turns the shaft."""
        self.enabled = bool(self._sequence)
        self.state = self._sequence[0][0] if self._sequence else 1
        if not self._sequence:
            self.result = 0
        if self.state in (1, 4):
            self.plant.off()
        else:
            self.plant.loop, self.plant.goal, self.plant.ramp = "velocity", _TURNS, None

    def _calibrate(self, step: float) -> None:
        state, left = self._sequence[0]
        if self.fails is not None and left < _LASTS / 2:
            (self.error, self.result), self.fails = self.fails, None
            self.enabled, self.state, self._sequence = False, 1, []
            self.plant.off()
            return
        self._sequence[0] = state, left - step
        if left <= step:
            self._sequence.pop(0)
            self._next_state()

    def _on_access(self, opcode: float, endpoint: float, reserved: float, value: float) -> None:
        self.accesses.append((int(opcode), int(endpoint)))
        raw = struct.pack("<I", int(value))
        match int(endpoint), int(opcode):
            case (number, 0) if number in ENDPOINTS.values():
                on = self.watchdog is not None
                word = struct.pack("<f", self._watchdog_time)
                if number == ENDPOINTS["axis0.config.enable_watchdog"]:
                    word = struct.pack("<I", on)
                self._tell_value(number, struct.unpack("<I", word)[0])
            case _ if self.keeps_watchdog:
                return
            case (number, 1) if number == ENDPOINTS["axis0.config.watchdog_timeout"]:
                self._watchdog_time = struct.unpack("<f", raw)[0]
                if self.watchdog is not None:
                    self.watchdog = self._watchdog_time
            case (number, 1) if number == ENDPOINTS["axis0.config.enable_watchdog"]:
                self.watchdog = self._watchdog_time if raw[0] else None
            case _:
                return

    def _tell_value(self, endpoint: int, value: int) -> None:
        command, layout = MESSAGES["value"]
        self.send(self.node << 5 | command, layout.encode(endpoint=endpoint, value=value))

    def _on_reboot(self, action: float) -> None:
        if self.state != 1 or action > 1:
            return
        if action == 1:
            self._stored = self._watchdog_time, self.watchdog
            self.saved.append(self.watchdog)
        super().boot()
        self._booting = _BOOT

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
        elif self.state == 11 and not self._leaving:
            self.plant.goal = velocity  # in place of that of homing, which goes on

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
        if not self.keeps_zero:
            self.plant.position = position

    def tick(self, now: float) -> None:
        """Send heartbeat and feedback; check the watchdog."""
        step = 0.005
        if self._booting:
            self._booting = max(0.0, self._booting - step)
            if not self._booting:
                self.boot()
            return
        if self._sequence:
            self._calibrate(step)
        if self.enabled and self.watchdog is not None and self.is_quiet(self.watchdog):
            super().break_down()
            self._sequence = []
            self.error, self.state = 1 << _WATCHDOG, 1
        if self.state == 11:
            self._home(step)
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
                return {
                    "error": self.error,
                    "state": self.state,
                    "result": self.result,
                    "done": done,
                }
            case "version":
                return {
                    "protocol": 2,
                    "hardware_major": 4,
                    "hardware_minor": 4,
                    "hardware_variant": 58,
                    **dict(zip(_FIRMWARE, self.firmware, strict=True)),
                }
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
