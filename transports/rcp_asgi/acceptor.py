"""Accepts connections: connection limits first, then TLS, then HTTP."""

from __future__ import annotations

import asyncio
import socket
import ssl
from collections.abc import Callable
from functools import partial

import structlog

from rcp_asgi.connection_limiter import ConnectionLimiter, Seat
from rcp_asgi.settings import Settings
from rcp_asgi.tls import Tls

__all__ = ["Acceptor"]

log = structlog.get_logger("rcp.asgi")
_AT_ONCE = 8  # connections accepted per loop iteration: each costs a handshake later
_PAUSE = 1.0  # s of pause after the process has run out of file descriptors
_TELL = 1.0  # s between log lines about failed handshakes


class _Guest:
    """A connection that is being accepted."""

    __slots__ = ("_make", "address", "handed_over", "seat", "socket")

    def __init__(
        self,
        made: socket.socket,
        address: str,
        seat: Seat,
        make: Callable[[Seat], asyncio.Protocol],
    ) -> None:
        self.socket = made
        self.address = address
        self.seat = seat
        self._make = make
        self.handed_over = False
        """The loop owns the socket and closes it; closing it twice might close another one."""

    def protocol(self) -> asyncio.Protocol:
        self.handed_over = True
        return self._make(self.seat)


class Acceptor:
    """One listening socket; `seats` are those of all sockets of the listener."""

    def __init__(
        self,
        listening: socket.socket,
        settings: Settings,
        tls: Tls | None,
        seats: ConnectionLimiter,
        make: Callable[[Seat], asyncio.Protocol],
    ) -> None:
        self._listening = listening
        self._settings = settings
        self._tls = tls
        self._seats = seats
        self._make = make
        self._loop = settings.client_api.loop
        self._opening: set[asyncio.Task[None]] = set()
        self._resume: asyncio.TimerHandle | None = None
        self._told = float("-inf")

    def open(self) -> None:
        """Start to accept connections."""
        self._resume = None
        self._loop.add_reader(self._listening, self._accept)

    def close(self) -> None:
        """Stop accepting, and drop the connections that have not reached HTTP yet."""
        if self._resume is not None:
            self._resume.cancel()
        self._loop.remove_reader(self._listening)
        self._listening.close()
        for task in self._opening:
            task.cancel()

    def _accept(self) -> None:
        for _ in range(_AT_ONCE):
            try:
                made, address = self._listening.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError as error:
                log.error("cannot_accept", reason=error.strerror)
                self._loop.remove_reader(self._listening)
                self._resume = self._loop.call_later(_PAUSE, self.open)
                return
            self._take(made, address[0])

    def _take(self, made: socket.socket, address: str) -> None:
        seat = self._seats.take(address, self._loop.time())
        if seat.refusal is not None:
            self._settings.client_api.refused("connection", seat.refusal.code)
            if self._tls is not None:  # a reply would require the handshake that is to be avoided
                seat.leave()
                made.close()
                return
        made.setblocking(False)
        made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        guest = _Guest(made, address, seat, self._make)
        task = self._loop.create_task(self._connect(guest))
        self._opening.add(task)
        task.add_done_callback(partial(self._connected, guest))

    async def _connect(self, guest: _Guest) -> None:
        config = self._settings.config
        if self._tls is None:
            await self._loop.connect_accepted_socket(guest.protocol, guest.socket)
            return
        await self._loop.connect_accepted_socket(
            guest.protocol,
            guest.socket,
            ssl=self._tls.context,
            ssl_handshake_timeout=config.header_timeout,
            ssl_shutdown_timeout=max(config.grace, _PAUSE),
        )

    def _connected(self, guest: _Guest, task: asyncio.Task[None]) -> None:
        self._opening.discard(task)
        error = None if task.cancelled() else task.exception()
        if error is None and not task.cancelled():
            return
        guest.seat.leave()
        if not guest.handed_over:
            guest.socket.close()
        if isinstance(error, (OSError, EOFError)):
            self._tell(error, guest.address)
        elif error is not None:
            log.error("connection_failed", peer=guest.address, exc_info=error)

    def _tell(self, error: Exception, address: str) -> None:
        self._settings.client_api.refused("connection", "tls")
        now = self._loop.time()
        if now - self._told > _TELL:
            self._told = now
            certificate = isinstance(error, ssl.SSLCertVerificationError)
            reason = error.verify_message if certificate else str(error) or type(error).__name__
            log.info("handshake_failed", peer=address, reason=reason)
