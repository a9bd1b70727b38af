"""The text console of a simulated moteus: its configuration, in memory until it is written."""

from __future__ import annotations

from collections.abc import Callable

__all__ = ["MoteusConsole"]

_FACTORY = {
    "id.id": "1",
    "can.prefix": "0",
    "motor.poles": "14",
    "motor.resistance_ohm": "0.053000",
    "motor.Kv": "302.000000",
    **{f"motor.offset.{place}": "0.000000" for place in range(64)},
    "servo.pwm_rate_hz": "30000",
    "servo.max_current_A": "100.000000",
    "servo.max_voltage": "46.000000",
    "servo.max_power_W": "nan",
    "servo.max_position_slip": "nan",
    "servo.max_velocity": "500.000000",
    "servo.default_timeout_s": "0.100000",
    "servo.fault_temperature": "75.000000",
    "servo.pid_position.kp": "4.000000",
    "servo.pid_position.kd": "0.050000",
    "servopos.position_min": "nan",
    "servopos.position_max": "nan",
}
"""A part of what firmware 0x010a has; it is enough for an answer of many frames."""


class MoteusConsole:
    """Takes text, and keeps what it says until it is polled."""

    def __init__(self, node: int, changed: Callable[[str], object]) -> None:
        self.stored = {**_FACTORY, "id.id": str(node)}
        self.settings = dict(self.stored)
        self.writes = 0
        """How often it has written its memory."""
        self.keeps: set[str] = set()
        """Settings that it acknowledges but does not change."""
        self._changed = changed
        self._heard = b""
        self._said = b""

    def boot(self) -> None:
        """Reboot with what is stored."""
        self.settings = dict(self.stored)
        self._heard = self._said = b""

    def hear(self, data: bytes) -> None:
        """Take a part of a line, or several."""
        *lines, self._heard = (self._heard + data).replace(b"\r", b"\n").split(b"\n")
        for line in filter(None, lines):
            self._said += "".join(f"{each}\r\n" for each in self._answer(line.decode())).encode()

    def say(self, most: int) -> bytes:
        """Return the next part of what it has to say."""
        part, self._said = self._said[:most], self._said[most:]
        return part

    def _answer(self, line: str) -> list[str]:
        match line.split():
            case ["conf", "enumerate"]:
                return [*(f"{name} {value}" for name, value in self.settings.items()), "OK"]
            case ["conf", "get", name] if name in self.settings:
                return [self.settings[name]]
            case ["conf", "get", _]:
                return ["ERR error reading"]
            case ["conf", "set", name, value]:
                return [self._set(name, value)]
            case ["conf", "write"]:
                self.stored, self.writes = dict(self.settings), self.writes + 1
                return ["OK"]
            case ["conf", "load"]:
                self.settings = dict(self.stored)
                return ["OK"]
            case _:
                return ["ERR unknown command"]

    def _set(self, name: str, value: str) -> str:
        if name not in self.settings:
            return "ERR error setting"
        try:
            number = float(value)
        except ValueError:
            return "ERR error setting"
        if name not in self.keeps:
            whole = "." not in self.settings[name] and self.settings[name] != "nan"
            self.settings[name] = str(int(number)) if whole else f"{number:.6f}"
            self._changed(name)
        return "OK"
