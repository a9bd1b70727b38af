"""A vehicle that does what a test tells it: real MAVLink over UDP, and no physics behind it."""

from __future__ import annotations

import asyncio
import math
import struct
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega

import rcp_mavlink
from rcp_gateway.testing import eventually
from rcp_gateway.testing._serve import OPERATOR, serve_backend

KIND = next(iter(rcp_mavlink.rcp_backends()))
LAT, LON = 47.0, 8.0
ARDUPILOT, PX4 = 3, 12
_TICK = 0.05  # s
_CODES = {1: "B", 2: "b", 3: "H", 4: "h", 5: "I", 6: "i", 9: "f"}


class Puppet(asyncio.DatagramProtocol):
    """One vehicle; everything it says and answers can be changed."""

    def __init__(
        self, *, autopilot: int = ARDUPILOT, type_: int = 2, mav: Any = ardupilotmega
    ) -> None:
        self.mav, self.autopilot, self.type = mav, autopilot, type_
        self.mode, self.armed, self.landed = 0, False, 1
        self.lat, self.lon, self.height, self.sea = LAT, LON, 0.0, 400.0
        self.velocity = (0.0, 0.0, 0.0)
        self.heading = 0.0  # rad
        self.health = 1 << 28
        self.params: dict[str, tuple[float, int]] = {}
        self.results: dict[int, Callable[[Any], int]] = {}
        """What each command does, and its MAV_RESULT; others are unsupported."""
        self.on: dict[str, Callable[[Any], object]] = {}
        """What each message does, by its type."""
        self.got: list[Any] = []
        self.also: list[Callable[[], None]] = []
        """Called at each tick, to send more."""
        self.quiet = False
        self.booted = 0.0
        self._peers: set[Any] = set()
        self.out: Any = mav.MAVLink(self, 1, 1)
        self._in: Any = mav.MAVLink(None)
        self._in.robust_parsing = True

    # The wire

    def connection_made(self, transport: Any) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        if self.quiet:
            return
        self._peers.add(addr)
        for message in self._in.parse_buffer(data) or ():
            self.take(message)

    def write(self, frame: bytes) -> None:
        for address in self._peers if not self.quiet else ():
            self._transport.sendto(bytes(frame), address)

    def send(self, name: str, *fields: Any) -> None:
        """Send a message."""
        self.out.send(getattr(self.mav, f"MAVLink_{name.lower()}_message")(*fields))

    def say(self, text: str, severity: int = 4) -> None:
        """Send STATUSTEXT."""
        self.send("STATUSTEXT", severity, text.encode())

    # What it does

    def take(self, message: Any) -> None:
        """Take a message."""
        kind = message.get_type()
        if kind in ("HEARTBEAT", "BAD_DATA"):
            return
        self.got.append(message)
        if kind in self.on:
            self.on[kind](message)
        elif kind in ("COMMAND_LONG", "COMMAND_INT"):
            result = self.command(message)
            self.send("COMMAND_ACK", message.command, result, 0, 0, 255, 190)
        elif kind == "PARAM_REQUEST_LIST":
            for name in self.params:
                self.tell(name)
        elif kind == "PARAM_REQUEST_READ" and message.param_id in self.params:
            self.tell(message.param_id)
        elif kind == "PARAM_SET" and message.param_id in self.params:
            _, type_ = self.params[message.param_id]
            value = self._decoded(message.param_value, type_)
            self.params[message.param_id] = (value, type_)
            self.tell(message.param_id)

    def command(self, message: Any) -> int:
        """Carry out a command; return its MAV_RESULT."""
        if message.command in self.results:
            return self.results[message.command](message)
        if message.command == 511:
            return 0
        if message.command == 512:
            return self.request(int(message.param1))
        return 3

    def request(self, number: int) -> int:
        """Send one message that is asked for."""
        if number == 242:
            self.home()
            return 0
        return 0 if number in (0, 1, 33, 245) else 3

    def home(self) -> None:
        """Send HOME_POSITION."""
        place = (round(LAT * 1e7), round(LON * 1e7), round(self.sea * 1e3))
        self.send("HOME_POSITION", *place, 0, 0, 0, [1.0, 0, 0, 0], 0, 0, 0)

    def tell(self, name: str) -> None:
        """Send PARAM_VALUE."""
        value, type_ = self.params[name]
        names = list(self.params)
        encoded = self._encoded(value, type_)
        self.send("PARAM_VALUE", name.encode(), encoded, type_, len(names), names.index(name))

    def _encoded(self, value: float, type_: int) -> float:
        if self.autopilot != PX4 or type_ == 9:
            return value
        raw = struct.pack(f"<{_CODES[type_]}", int(value)).ljust(4, b"\0")
        return struct.unpack("<f", raw)[0]

    def _decoded(self, value: float, type_: int) -> float:
        if self.autopilot != PX4 or type_ == 9:
            return value
        size = struct.calcsize(_CODES[type_])
        return struct.unpack(f"<{_CODES[type_]}", struct.pack("<f", value)[:size])[0]

    def tick(self) -> None:
        """Say what it says unasked."""
        base = 1 | (128 if self.armed else 0)
        self.send("HEARTBEAT", self.type, self.autopilot, base, self.mode, 4, 3)
        here = (round(self.lat * 1e7), round(self.lon * 1e7))
        above = round((self.height + self.sea) * 1e3), round(self.height * 1e3)
        v = [round(100 * part) for part in self.velocity]
        self.send(
            "GLOBAL_POSITION_INT",
            self.clock,
            *here,
            *above,
            *v,
            round(math.degrees(self.heading) * 100),
        )
        self.send("EXTENDED_SYS_STATE", 0, self.landed)
        self.send("SYS_STATUS", 1 << 28, 1 << 28, self.health, 0, 12000, 0, 90, 0, 0, 0, 0, 0, 0)
        for more in self.also:
            more()

    @property
    def clock(self) -> int:
        """Milliseconds since it was booted."""
        return round((asyncio.get_running_loop().time() - self.booted) * 1e3)

    async def run(self) -> None:
        """Say it again and again."""
        self.booted = asyncio.get_running_loop().time() - 100.0
        while True:
            self.tick()
            await asyncio.sleep(_TICK)

    # What tests look at

    def commands(self, number: int) -> list[Any]:
        """Return the commands of a number that came."""
        return [m for m in self.got if m.get_type().startswith("COMMAND_") and m.command == number]

    def messages(self, name: str) -> list[Any]:
        """Return the messages of a type that came."""
        return [m for m in self.got if m.get_type() == name]

    def move(self, north: float, east: float, height: float) -> None:
        """Put it somewhere, m from home."""
        self.lat = LAT + north / 111_319.49
        self.lon = LON + east / (111_319.49 * math.cos(math.radians(LAT)))
        self.height = height


class Station:
    """A gateway with one puppet behind it, and an operator at it."""

    def __init__(self, served: Any, puppet: Any) -> None:
        self.served, self.puppet = served, puppet
        self.client = served.client(OPERATOR)

    @property
    def robot(self) -> Any:
        return self.served.life.backend.robots[""]

    async def do(self, name: str, body: Any = None, within: float = 120.0, **more: Any) -> Any:
        path = f"/tenant/t/{name}"
        return await self.client.request("execute", path, body=body, within=within, **more)

    async def read(self, name: str) -> Any:
        reply = await self.client.request("read", f"/tenant/t/{name}")
        assert reply["status"] == "completed", reply
        return reply["body"]

    async def write(self, name: str, body: Any, **more: Any) -> Any:
        return await self.client.request("write", f"/tenant/t/{name}", body=body, **more)


@asynccontextmanager
async def listening(puppet: Any) -> AsyncGenerator[int]:
    """Have a puppet wait at a port."""
    loop = asyncio.get_running_loop()
    transport, _ = await loop.create_datagram_endpoint(lambda: puppet, local_addr=("127.0.0.1", 0))
    task = asyncio.create_task(puppet.run())
    try:
        yield transport.get_extra_info("sockname")[1]
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        transport.abort()


@asynccontextmanager
async def station(puppet: Any, **config: Any) -> AsyncGenerator[Station]:
    """Run a gateway with a puppet behind it."""
    async with listening(puppet) as port:
        table = {"links": [f"udpout:127.0.0.1:{port}"], "timeout": 0.3, "silence": 1.5, **config}
        async with serve_backend(KIND, table) as served:
            await _open(served)
            yield Station(served, puppet)


async def _open(served: Any) -> None:
    async def there() -> bool:
        return bool(served.lives) and bool(served.life.backend.robots)

    await eventually(there, "it is open", 20.0)
