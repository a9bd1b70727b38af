"""The vehicle's links: UDP listening or connecting, and TCP listening."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from typing import Any

from rcp_mavlink_sim.factory import station_of
from rcp_mavlink_sim.faults import Faults
from rcp_mavlink_sim.ground_station import GroundStation
from rcp_mavlink_sim.vehicle import Vehicle

__all__ = ["Twin", "fly"]

_TURN = 0.005  # s
_LONGEST = 0.25  # s that are caught up after the machine was suspended
_SILENT = 30.0  # s after which a silent UDP address is removed


class Twin:
    """A vehicle with its links, on the event loop that opened them."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle = vehicle
        self.ports: list[tuple[str, int]] = []
        """Its listening addresses, in the order of the links."""
        self.peers: list[GroundStation] = []
        self.on_reboot: list[Callable[[], None]] = []

    @property
    def faults(self) -> Faults:
        """The injected faults."""
        return self.vehicle.faults

    @property
    def muted(self) -> bool:
        """Whether nothing is received or sent, as with a dead radio."""
        return self.faults.uplink_cut and self.faults.downlink_cut

    @muted.setter
    def muted(self, value: bool) -> None:
        self.faults.uplink_cut = self.faults.downlink_cut = value

    def join(self, send_bytes: Callable[[bytes], None]) -> GroundStation:
        """Add a peer."""
        latency = self.vehicle.options.latency
        loop = asyncio.get_running_loop()

        def send(frame: bytes) -> None:
            if not latency:
                send_bytes(frame)
            elif not self.faults.downlink_cut:
                loop.call_later(latency, arrive, frame)

        def arrive(frame: bytes) -> None:
            if not self.faults.downlink_cut:  # cut while in transit
                send_bytes(frame)

        peer = station_of(self.vehicle, send)
        self.peers.append(peer)
        return peer

    def part(self, peer: GroundStation) -> None:
        """Remove a peer."""
        if peer in self.peers:
            self.peers.remove(peer)
            peer.close()

    async def run(self) -> None:
        """Advance in real time until cancelled."""
        before = time.monotonic()
        while True:
            await asyncio.sleep(_TURN)
            now = time.monotonic()
            self.vehicle.advance(now, min(_LONGEST, now - before))
            before = now
            for peer in list(self.peers):
                peer.turn(now)
            if self.vehicle.rebooted:
                self.vehicle.rebooted = False
                for drop in list(self.on_reboot):
                    drop()


class _Udp(asyncio.DatagramProtocol):
    """Each sending address is a peer; the target of an outgoing link is one from the start."""

    def __init__(self, twin: Twin, calls: tuple[str, int] | None) -> None:
        self._twin = twin
        self._calls = calls
        self._peers: dict[Any, GroundStation] = {}
        self._last_seen: dict[Any, float] = {}

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport: Any = transport
        self._twin.on_reboot.append(self._forget)
        if self._calls is not None:
            self._peer(self._calls)

    def _peer(self, address: Any) -> GroundStation:
        if address not in self._peers:
            self._drop_silent()
            transport = self._transport

            def send(frame: bytes) -> None:
                if not transport.is_closing():
                    transport.sendto(frame, address)

            self._peers[address] = self._twin.join(send)
        return self._peers[address]

    def _drop_silent(self) -> None:
        now = time.monotonic()
        for address, seen_at in list(self._last_seen.items()):
            if now - seen_at > _SILENT and address != self._calls:
                self._twin.part(self._peers.pop(address))
                del self._last_seen[address]

    def _forget(self) -> None:
        for peer in self._peers.values():
            self._twin.part(peer)
        self._peers.clear()
        self._last_seen.clear()
        if self._calls is not None:
            self._peer(self._calls)

    def datagram_received(self, data: bytes, addr: Any) -> None:
        if not self._twin.faults.uplink_cut:
            self._last_seen[addr] = time.monotonic()
            self._peer(addr).feed(data, datagram=True)

    def error_received(self, exc: Exception) -> None:
        """Ignore it: the peer is not listening yet."""


class _Tcp(asyncio.Protocol):
    """Like ArduPilot's, it accepts a second client but sends it nothing."""

    def __init__(self, twin: Twin, busy: set[_Tcp]) -> None:
        self._twin, self._busy = twin, busy
        self._peer: GroundStation | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport: Any = transport
        self._twin.on_reboot.append(self.drop)
        if not self._busy:
            self._busy.add(self)
            self._peer = self._twin.join(self._transport.write)

    def drop(self) -> None:
        """Close the connection, as a reboot does."""
        self._transport.abort()

    def data_received(self, data: bytes) -> None:
        if self._peer is not None:
            self._peer.feed(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._busy.discard(self)
        self._twin.on_reboot.remove(self.drop)
        if self._peer is not None:
            self._twin.part(self._peer)


@asynccontextmanager
async def fly(vehicle: Vehicle, *links: str) -> AsyncGenerator[Twin]:
    """Run a vehicle with its links while entered.

    A link is `udpin:HOST:PORT` (listens), `udpout:HOST:PORT` (connects) or `tcpin:HOST:PORT`
    (listens); port 0 takes a free one.

    :raises ValueError: not a valid link.
    """
    loop = asyncio.get_running_loop()
    twin = Twin(vehicle)
    closers: list[Callable[[], object]] = []
    try:
        closers.extend([await _open(loop, twin, link) for link in links])
        running = asyncio.create_task(twin.run())
        closers.append(running.cancel)
        try:
            yield twin
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)
    finally:
        for close in closers:
            close()


async def _open(loop: asyncio.AbstractEventLoop, twin: Twin, link: str) -> Callable[[], None]:
    kind, host, port = link.split(":")
    address = (host, int(port))
    if kind == "tcpin":
        busy: set[_Tcp] = set()
        server = await loop.create_server(lambda: _Tcp(twin, busy), *address)
        twin.ports.append(server.sockets[0].getsockname()[:2])

        def close() -> None:
            server.close()
            for connection in busy.copy():
                connection.drop()

        return close
    if kind == "udpin":
        transport, _ = await loop.create_datagram_endpoint(
            lambda: _Udp(twin, None), local_addr=address
        )
    elif kind == "udpout":
        transport, _ = await loop.create_datagram_endpoint(
            lambda: _Udp(twin, address), local_addr=(_any(host), 0)
        )
    else:
        raise ValueError(f"{link!r} is not udpin, udpout or tcpin, then host and port")
    twin.ports.append(transport.get_extra_info("sockname")[:2])
    return transport.close


def _any(host: str) -> str:
    """Return the local address to bind for a remote host."""
    return "127.0.0.1" if host.startswith("127.") or host == "localhost" else "0.0.0.0"  # noqa: S104
