"""The links: UDP and TCP, listening or connecting, and serial. All on the event loop."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import time
from collections.abc import Callable
from typing import Any

import structlog

from rcp_mavlink.config import LinkSpec
from rcp_mavlink.frames import Frame, Framer
from rcp_mavlink.serial_port import SerialPort
from rcp_mavlink.twins import keep_twin

__all__ = ["Link", "Take"]

log = structlog.get_logger("rcp.mavlink")
_FIRST_WAIT, _LONGEST_WAIT = 0.5, 5.0  # s between attempts to connect
_FORGET = 60.0  # s without data after which nothing more is sent to a UDP address
_MOST_ADDRESSES = 256
_RECEIVED = 4 << 20  # bytes of receive buffer, for when the loop is busy
_ROOM = 65_536  # bytes that may wait for a peer that does not read; a stop may wait beside them
_UNSENT = 16_384  # bytes of them that the system takes before it can send them
_LEAST = 2048  # bytes that may wait for a slow serial line
_BYTES = 0.05  # bytes in half a second, by the bit rate

Take = Callable[["Link", Any, list[Frame]], None]


class Link:
    """One link; `take` receives its frames with the sender's address."""

    def __init__(self, number: int, text: str, make: Callable[[], Framer], take: Take) -> None:
        self.number = number
        self.text = text
        self.spec = LinkSpec.of(text)
        self._make, self._take = make, take
        self._full = False
        """Whether what was to be sent last was dropped."""
        self._waiting_room = _ROOM
        if self.spec.kind == "serial":  # or a stop would be sent seconds later
            self._waiting_room = max(_LEAST, round(self.spec.port * _BYTES))
        self.framer = make()
        self.framers: dict[Any, Framer] = {}
        """Parser per address: the data of different senders is kept apart."""
        self._transports: dict[Any, Any] = {}
        self._last_seen: dict[Any, float] = {}
        self._datagrams: asyncio.DatagramTransport | None = None
        self._server: asyncio.Server | None = None
        self._task: asyncio.Task[None] | None = None
        self.twin: dict[str, object] = {}
        """Settings of a simulated vehicle."""
        self.joined: Callable[[], None] = lambda: None
        """Called when a peer becomes reachable."""
        self.error: str | None = None
        """Why it is down."""

    @property
    def port(self) -> int:
        """The local port of a listening link."""
        if self._datagrams is not None:
            return self._datagrams.get_extra_info("sockname")[1]
        assert self._server is not None
        return self._server.sockets[0].getsockname()[1]

    async def open(self) -> None:
        """Open it.

        :raises OSError: a port to listen on is not available.
        """
        loop, spec = asyncio.get_running_loop(), self.spec
        if spec.kind in ("udpin", "sim"):
            address = ("127.0.0.1", 0) if spec.kind == "sim" else (spec.host, spec.port)
            self._datagrams, _ = await loop.create_datagram_endpoint(
                lambda: _Datagrams(self), local_addr=address
            )
            found: Any = self._datagrams.get_extra_info("socket")
            found.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVED)
            if spec.kind == "sim":
                self._task = loop.create_task(keep_twin(self.twin, self.port, self._failed))
        elif spec.kind == "tcpin":
            self._server = await loop.create_server(lambda: _Stream(self), spec.host, spec.port)
        else:
            self._task = loop.create_task(self._keep())

    def _failed(self, why: str) -> None:
        self.error = why

    async def close(self) -> None:
        """Close it."""
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task
        if self._server is not None:
            self._server.close()
        for transport in [*self._transports.values(), self._datagrams]:
            if transport is not None:
                transport.abort()
        self._transports.clear()
        await asyncio.sleep(0)

    async def _keep(self) -> None:
        """Connect, and reconnect whenever the connection is lost."""
        wait = _FIRST_WAIT
        while True:
            try:
                done = await self._call()
                self.error, wait = None, _FIRST_WAIT
                await done.wait()
                self.error = "the connection was closed"
            except OSError as error:
                self.error = str(error) or type(error).__name__
            await asyncio.sleep(wait)
            wait = min(_LONGEST_WAIT, wait * 2)

    async def _call(self) -> asyncio.Event:
        loop, spec, done = asyncio.get_running_loop(), self.spec, asyncio.Event()
        if spec.kind == "tcp":
            await loop.create_connection(lambda: _Stream(self, done), spec.host, spec.port)
        elif spec.kind == "udpout":
            transport, _ = await loop.create_datagram_endpoint(
                lambda: _Datagrams(self, done), remote_addr=(spec.host, spec.port)
            )
            self.join(None, transport)
        else:
            port = SerialPort(spec.host, spec.port, _Stream(self, done))
            port.open(loop)
        return done

    def join(self, address: Any, transport: Any) -> None:
        """Add an address."""
        self._transports[address] = transport
        self.joined()

    def part(self, address: Any) -> None:
        """Remove an address."""
        self._transports.pop(address, None)
        self.framers.pop(address, None)
        self._last_seen.pop(address, None)

    def datagram(self, address: Any, data: bytes) -> None:
        """Handle a datagram."""
        self._take(self, address, self._framer(address).datagram(data))

    def stream(self, address: Any, data: bytes) -> None:
        """Handle bytes of a connection."""
        self._take(self, address, self._framer(address).stream(data))

    def _framer(self, address: Any) -> Framer:
        if address is None:
            return self.framer
        framer = self.framers.get(address)
        if framer is None:
            framer = self._make()
            framer.stats = self.framer.stats
            self._room()
            self.framers[address] = framer
        self._last_seen[address] = time.monotonic()
        return framer

    def _room(self) -> None:
        """Evict silent senders of datagrams, because anybody can send one."""
        if self._datagrams is None:
            return
        now = time.monotonic()
        for address, seen_at in list(self._last_seen.items()):
            if now - seen_at > _FORGET or len(self._last_seen) >= _MOST_ADDRESSES:
                del self._last_seen[address]
                self.framers.pop(address, None)

    def send(self, frame: bytes, address: Any, *, urgent: bool = False) -> None:
        """Send a frame to a known address; dropped, and counted, if too many wait, of which a stop has its own number."""
        transport = self._transports.get(address)
        if transport is not None:
            room = self._waiting_room * (2 if urgent else 1)
            if transport.get_write_buffer_size() < room:
                if self.spec.kind == "udpout":
                    transport.sendto(frame)
                else:
                    transport.write(frame)
                self.framer.stats.sent += 1
                if not urgent:
                    self._full = False
            else:
                self._drop()
        elif self._datagrams is not None and address is not None:
            self._datagrams.sendto(frame, address)
            self.framer.stats.sent += 1

    def _drop(self) -> None:
        self.framer.stats.dropped += 1
        if not self._full:
            self._full = True
            log.warning("link_full", link=self.text)

    def send_all(self, frame: bytes) -> None:
        """Send a frame to all peers."""
        for address in list(self._transports):
            self.send(frame, address)
        if self._datagrams is not None:
            now = time.monotonic()
            for address, seen_at in list(self._last_seen.items()):
                if now - seen_at < _FORGET:
                    self.send(frame, address)


class _Datagrams(asyncio.DatagramProtocol):
    def __init__(self, link: Link, done: asyncio.Event | None = None) -> None:
        self._link, self._done = link, done

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self._link.datagram(None if self._done is not None else addr, data)

    def error_received(self, exc: Exception) -> None:
        """Ignore it: the peer is not up yet."""

    def connection_lost(self, exc: Exception | None) -> None:
        if self._done is not None:
            self._link.part(None)
            self._done.set()


class _Stream(asyncio.Protocol):
    def __init__(self, link: Link, done: asyncio.Event | None = None) -> None:
        self._link, self._done = link, done
        self._address: Any = None

    def connection_made(self, transport: Any) -> None:
        if self._done is None:
            self._address = transport.get_extra_info("peername")
        else:
            self._link.framer.reset()
        stream = transport.get_extra_info("socket")
        if stream is not None and stream.family in (socket.AF_INET, socket.AF_INET6):
            with contextlib.suppress(AttributeError, OSError):  # not every system has it
                stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, _UNSENT)
        self._link.join(self._address, transport)

    def data_received(self, data: bytes) -> None:
        self._link.stream(self._address, data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._link.part(self._address)
        if self._done is not None:
            self._done.set()
