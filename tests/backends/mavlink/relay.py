"""A UDP relay between the gateway and a vehicle, which loses what a test says, and notes the rest."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from typing import Any

from rcp_mavlink_sim.wire import mav

HEARTBEAT, COMMAND_ACK, SET_MODE = 0, 77, 176


class Relay:
    """Both directions; `up` and `down` are asked of each message whether it passes."""

    def __init__(self, vehicle: tuple[str, int]) -> None:
        self.vehicle = vehicle
        self.cut = False
        self.up: Callable[[Any], bool] = lambda _: True
        self.down: Callable[[int], bool] = lambda _: True
        self.sent: list[Any] = []
        """What the gateway has sent since the list was cleared, but heartbeats and questions."""
        self.port = 0
        self._gateway: Any = None
        self.to_gateway: Any = None
        self.to_vehicle: Any = None
        self._parser: Any = mav.MAVLink(None)
        self._parser.robust_parsing = True

    def commands(self, number: int) -> list[Any]:
        """Return the commands of a number that were sent."""
        return [m for m in self.sent if getattr(m, "command", None) == number]

    def from_gateway(self, data: bytes, address: Any) -> None:
        """Pass on what passes."""
        self._gateway = address
        messages = [
            m for m in self._parser.parse_buffer(data) or () if m.get_type() != "BAD_DATA"
        ]  # fmt: skip
        if self.cut:
            return
        self.sent += [m for m in messages if not _asks(m)]
        if all(self.up(m) for m in messages):  # one in each datagram
            self.to_vehicle.sendto(data, self.vehicle)

    def from_vehicle(self, data: bytes, _: Any) -> None:
        """Pass on what passes."""
        number = int.from_bytes(data[7:10], "little")
        if not self.cut and self._gateway is not None and self.down(number):
            self.to_gateway.sendto(data, self._gateway)


def _asks(message: Any) -> bool:
    return message.get_type() == "HEARTBEAT" or getattr(message, "command", None) in (511, 512)


class _Protocol(asyncio.DatagramProtocol):
    def __init__(self, take: Callable[[bytes, Any], None]) -> None:
        self._take = take

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self._take(data, addr)


@asynccontextmanager
async def relay(vehicle: tuple[str, int]) -> AsyncGenerator[Relay]:
    """Run a relay to a vehicle's address while entered."""
    loop, found = asyncio.get_running_loop(), Relay(vehicle)
    here = ("127.0.0.1", 0)
    found.to_gateway, _ = await loop.create_datagram_endpoint(
        lambda: _Protocol(found.from_gateway), local_addr=here
    )
    found.to_vehicle, _ = await loop.create_datagram_endpoint(
        lambda: _Protocol(found.from_vehicle), local_addr=here
    )
    found.port = found.to_gateway.get_extra_info("sockname")[1]
    try:
        yield found
    finally:
        found.to_gateway.close()
        found.to_vehicle.close()


class Commander:
    """Somebody else who commands the vehicle, past the gateway."""

    def __init__(self, vehicle: tuple[str, int]) -> None:
        self.vehicle = vehicle
        self.mav: Any = mav.MAVLink(self, 254, 190)
        self.transport: Any = None

    def write(self, frame: bytes) -> None:
        self.transport.sendto(bytes(frame), self.vehicle)

    def mode(self, number: int) -> None:
        """Change the flight mode."""
        self.mav.command_long_send(1, 1, SET_MODE, 0, 1, number, 0, 0, 0, 0, 0)

    def arm(self) -> None:
        """Start the motors."""
        self.mav.command_long_send(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)

    def fly(self, north: float, height: float) -> None:
        """Bring it into GUIDED, and lead it to a place."""
        self.mode(4)
        self.go(north, height)

    def go(self, north: float, height: float) -> None:
        """Send a set-point."""
        self.mav.set_position_target_local_ned_send(
            0, 1, 1, 1, 0b1101_1111_1000, north, 0, -height, 0, 0, 0, 0, 0, 0, 0, 0
        )


@asynccontextmanager
async def commander(vehicle: tuple[str, int]) -> AsyncGenerator[Commander]:
    """Have somebody else at the vehicle while entered."""
    found = Commander(vehicle)
    loop = asyncio.get_running_loop()
    found.transport, _ = await loop.create_datagram_endpoint(
        lambda: _Protocol(lambda *_: None), local_addr=("127.0.0.1", 0)
    )
    try:
        yield found
    finally:
        found.transport.close()
