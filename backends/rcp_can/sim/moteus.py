"""A simulated moteus."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any

from rcp_can.profiles.moteus_stream import CHANNEL, FROM_DRIVE, POLL, TO_DRIVE
from rcp_can.profiles.moteus_wire import REGISTERS, Access, Kind, Mode, build, pad, parse
from rcp_can.sim.moteus_console import MoteusConsole
from rcp_can.sim.plant import Plant
from rcp_can.sim.twin import Twin

if TYPE_CHECKING:
    import can

__all__ = ["MoteusTwin"]

TURN = 2 * math.pi
_TIMEOUT = 0.1  # s: factory setting of servo.default_timeout_s
_CHANGED = 41  # fault: a setting was changed while it was on
_DAMPING = 0.05  # N·m·s/rad of servo.timeout_mode 12, factory setting
_NAMES = {register.number: name for name, register in REGISTERS.items()}
_COMMAND: dict[str, float] = {
    "command_position": 0.0,
    "command_velocity": 0.0,
    "command_torque": 0.0,
    "kp_scale": 1.0,
    "kd_scale": 1.0,
    "max_torque": math.nan,
    "stop_position": math.nan,
    "watchdog": math.nan,
    "velocity_limit": math.nan,
    "acceleration_limit": math.nan,
}
"""Defaults of the fields that a set-point leaves out."""


class MoteusTwin(Twin):
    """One controller."""

    def __init__(self, node: int, plant: Plant | None = None, **options: Any) -> None:
        super().__init__(node, plant, **options)
        self.mode = int(Mode.STOPPED)
        self.fault = 0
        self.command = dict(_COMMAND)
        self._booted = time.monotonic() - 10.0  # it was running before the first request
        self.firmware = 0x010A
        self.console = MoteusConsole(node, self._on_setting)

    def boot(self) -> None:
        """Reboot."""
        super().boot()
        self.mode, self.fault = int(Mode.STOPPED), 0
        self._booted = time.monotonic()
        self.console.boot()
        self.node = int(self.console.settings["id.id"])

    def _on_setting(self, name: str) -> None:
        if name == "id.id":
            self.node = int(self.console.settings[name])
        elif self.enabled:  # only a drive that is stopped takes these
            super().break_down()
            self.mode, self.fault = int(Mode.FAULT), _CHANGED

    def break_down(self) -> None:
        """Trip the gate driver, as over-current does."""
        super().break_down()
        self.mode, self.fault = int(Mode.FAULT), 33

    def take(self, message: can.Message) -> None:
        """Handle a frame, and respond if requested."""
        identifier = message.arbitration_id
        if identifier & 0x7F != self.node or self._talk(message):
            return
        try:
            accesses = parse(bytes(message.data))
        except ValueError:
            return
        writes = [a for a in accesses if a.kind == Kind.WRITE]
        if any(a.register == 0 for a in writes):
            self.command = dict(_COMMAND)
        for access in writes:
            self._written(_NAMES.get(access.register, ""), access.value or 0.0)
        if any(a.register == 0 for a in writes):
            self._obey()
        if identifier & 0x8000:
            self._answer(identifier >> 8 & 0x7F, accesses, message)

    def _talk(self, message: can.Message) -> bool:
        """Handle a frame of the stream; return whether it is one."""
        data = bytes(message.data)
        if len(data) < 3 or data[0] not in (TO_DRIVE, POLL):
            return False
        if data[:2] == bytes((TO_DRIVE, CHANNEL)):
            self.console.hear(data[3 : 3 + data[2]])
        elif data[1] == CHANNEL:
            part = self.console.say(data[2])
            payload = bytes((FROM_DRIVE, CHANNEL, len(part))) + part
            self._send(message.arbitration_id >> 8 & 0x7F, payload, message)
        return True

    def _written(self, name: str, value: float) -> None:
        if name in self.command:
            self.command[name] = value
        elif name == "set_output" and not self.keeps_zero:
            self.plant.goal += value * TURN - self.plant.position
            self.plant.position = value * TURN
        elif name == "mode":
            mode = int(value)
            if mode == Mode.STOPPED:
                self.mode, self.fault, self.enabled = mode, 0, False
                self.plant.off()
            elif self.mode not in (Mode.FAULT, Mode.TIMEOUT) and not self.refuses:
                self.mode, self.enabled = mode, True

    def _obey(self) -> None:
        if not self.enabled:
            return
        self.feed()
        command, plant = self.command, self.plant
        velocity = command["command_velocity"]
        if self.mode != Mode.POSITION:
            plant.hold()
        elif command["kp_scale"] == 0.0 and command["kd_scale"] == 0.0:
            plant.loop, plant.goal = "torque", command["command_torque"]
            self.took("torque", plant.goal)
        elif math.isnan(command["command_position"]):
            plant.loop, plant.ramp = "velocity", None
            plant.goal = 0.0 if math.isnan(velocity) else velocity * TURN
            self.took("velocity", plant.goal)
        else:
            limit, ramp = command["velocity_limit"], command["acceleration_limit"]
            plant.loop, plant.goal = "position", command["command_position"] * TURN
            plant.speed = plant.velocity_limit if math.isnan(limit) else limit * TURN
            plant.ramp = None if math.isnan(ramp) else ramp * TURN
            self.took("position", plant.goal)

    def tick(self, now: float) -> None:
        """Check the watchdog: damp to zero velocity until a stop command."""
        timeout = self.command["watchdog"]
        if math.isnan(timeout):
            timeout = _TIMEOUT
        if self.enabled and self.is_quiet(timeout):
            self.enabled, self.mode = False, int(Mode.TIMEOUT)
            self.plant.impedance(0.0, 0.0, 0.0, _DAMPING, 0.0)

    def _read(self, name: str) -> float:
        plant = self.plant
        near = abs(plant.goal - plant.position) < 0.01 and abs(plant.velocity) < 0.1
        if self.blind and name in ("position", "velocity"):
            return math.nan
        values = {
            "watchdog": self.command["watchdog"],
            "mode": float(self.mode),
            "position": plant.position / TURN,
            "velocity": plant.velocity / TURN,
            "torque": plant.torque,
            "q_current": plant.torque / 0.1,
            "motor_temperature": plant.temperature,
            "trajectory_complete": float(plant.loop == "position" and near),
            "voltage": 24.0,
            "temperature": 31.0,
            "fault": float(self.fault),
            "model": 0x0204,
            "firmware": float(self.firmware),
            "serial_3": float(self.node),
            "milliseconds": (time.monotonic() - self._booted) * 1000,
        }
        return values.get(name, 0.0)

    def _answer(self, to: int, accesses: list[Access], message: can.Message) -> None:
        replies = [
            Access(Kind.REPLY, a.register, a.width, self._read(_NAMES.get(a.register, "")))
            for a in accesses
            if a.kind == Kind.READ
        ]
        self._send(to, build(replies), message)

    def _send(self, to: int, payload: bytes, message: can.Message) -> None:
        self.send(
            self.node << 8 | to,
            pad(payload),
            is_extended_id=message.is_extended_id,
            is_fd=True,
            bitrate_switch=message.bitrate_switch,
        )
