"""A ground station in memory: it talks to a vehicle by bytes and lets its time pass."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rcp_mavlink_sim import Options, vehicle_of
from rcp_mavlink_sim.factory import station_of
from rcp_mavlink_sim.wire import mav

TURN = 0.05  # s


class _Out:
    def __init__(self) -> None:
        self.data = b""

    def write(self, frame: bytes) -> None:
        self.data += frame


class Station:
    """One vehicle and one peer of it."""

    def __init__(self, **options: Any) -> None:
        self.vehicle = vehicle_of(Options(**{"warmup": 1.0, **options}))
        self.heard: list[Any] = []
        self._out = _Out()
        self.mav: Any = mav.MAVLink(self._out, 255, 190)
        self._in: Any = mav.MAVLink(None)
        self._in.robust_parsing = True
        self.peer = station_of(self.vehicle, self._hear)

    def _hear(self, frame: bytes) -> None:
        self.heard.extend(self._in.parse_buffer(frame) or ())

    def send(self, message: Any) -> list[Any]:
        """Send one message and return what is answered at once."""
        del self.heard[:]
        self.mav.send(message)
        data, self._out.data = self._out.data, b""
        self.peer.feed(data, datagram=True)
        return list(self.heard)

    def pass_time(self, seconds: float) -> None:
        """Let time pass."""
        for _ in range(round(seconds / TURN)):
            self.vehicle.advance(self.vehicle.wall + TURN, TURN)
            self.peer.turn(self.vehicle.wall)

    def until(self, holds: Callable[[], bool], seconds: float = 120.0) -> float:
        """Let time pass until something holds; return how much."""
        before = self.vehicle.time
        while not holds():
            assert self.vehicle.time - before < seconds, "it never came to hold"
            self.pass_time(TURN)
        return self.vehicle.time - before

    def command(self, number: int, *params: float) -> int:
        """Send COMMAND_LONG; return its MAV_RESULT."""
        given = [*params, *([0.0] * (7 - len(params)))]
        heard = self.send(mav.MAVLink_command_long_message(1, 1, number, 0, *given))
        return next(m.result for m in heard if m.get_type() == "COMMAND_ACK")

    def reposition(self, lat: float, lon: float, height: float, flags: float = 0) -> int:
        """Send DO_REPOSITION as COMMAND_INT; return its MAV_RESULT."""
        heard = self.send(
            mav.MAVLink_command_int_message(
                1, 1, 6, 192, 0, 0, -1, flags, 0, 0, round(lat * 1e7), round(lon * 1e7), height
            )
        )
        return next(m.result for m in heard if m.get_type() == "COMMAND_ACK")

    def mode(self, number: int) -> int:
        """Ask for a mode."""
        return self.command(mav.MAV_CMD_DO_SET_MODE, 1, number)

    @property
    def texts(self) -> list[str]:
        """What STATUSTEXT said since the last message."""
        return [m.text for m in self.heard if m.get_type() == "STATUSTEXT"]

    def last(self, type_: str) -> Any:
        """Return the newest message of a type."""
        return next(m for m in reversed(self.heard) if m.get_type() == type_)

    def fly(self, height: float = 10.0) -> None:
        """Bring it into the air in GUIDED."""
        self.pass_time(1.2)
        assert self.mode(4) == 0
        assert self.command(400, 1) == 0
        assert self.command(22, 0, 0, 0, 0, 0, 0, height) == 0
        self.until(lambda: not self.vehicle.flight.taking_off)
