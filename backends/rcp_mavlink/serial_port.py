"""A serial port as an asyncio transport: raw, without a thread or a library."""

from __future__ import annotations

import asyncio
import os
from typing import Any

__all__ = ["SerialPort"]

_CHUNK = 4096  # bytes
_BACKLOG = 65_536


class SerialPort:
    """The subset of an asyncio transport that a link needs."""

    def __init__(self, device: str, baud: int, protocol: asyncio.Protocol) -> None:
        self._device, self._baud, self._protocol = device, baud, protocol
        self._fd = -1
        self._waiting = bytearray()
        self._loop: asyncio.AbstractEventLoop | None = None

    def open(self, loop: asyncio.AbstractEventLoop) -> None:
        """Open the device.

        :raises OSError: it does not exist, is not accessible, or does not support the baud rate.
        """
        import termios
        import tty

        speed = getattr(termios, f"B{self._baud}", None)
        if speed is None:
            raise OSError(f"{self._device} does not support {self._baud} bit/s")
        fd = os.open(self._device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            tty.setraw(fd)
            settings = termios.tcgetattr(fd)
            settings[2] = (settings[2] | termios.CLOCAL | termios.CREAD) & ~termios.CRTSCTS
            settings[4] = settings[5] = speed
            termios.tcsetattr(fd, termios.TCSANOW, settings)
        except termios.error as error:
            os.close(fd)
            raise OSError(f"{self._device} is not a serial port: {error}") from error
        self._fd, self._loop = fd, loop
        loop.add_reader(fd, self._read)
        self._protocol.connection_made(self)  # pyright: ignore[reportArgumentType]

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        """Return None: a serial port has no peer address."""
        return default

    def get_write_buffer_size(self) -> int:
        """Return the number of buffered bytes."""
        return len(self._waiting)

    def write(self, data: bytes) -> None:
        """Send, as fast as the port accepts it."""
        if self._fd < 0 or len(self._waiting) > _BACKLOG:
            return
        if not self._waiting and self._loop is not None:
            self._loop.add_writer(self._fd, self._write)
        self._waiting += data

    def abort(self) -> None:
        """Close it."""
        self._lose(None)

    def _read(self) -> None:
        try:
            data = os.read(self._fd, _CHUNK)
        except BlockingIOError:
            return
        except OSError as error:
            self._lose(error)
            return
        if data:
            self._protocol.data_received(data)
        else:
            self._lose(None)

    def _write(self) -> None:
        try:
            sent = os.write(self._fd, self._waiting)
        except BlockingIOError:
            return
        except OSError as error:
            self._lose(error)
            return
        del self._waiting[:sent]
        if not self._waiting and self._loop is not None:
            self._loop.remove_writer(self._fd)

    def _lose(self, error: Exception | None) -> None:
        if self._fd < 0 or self._loop is None:
            return
        self._loop.remove_reader(self._fd)
        self._loop.remove_writer(self._fd)
        os.close(self._fd)
        self._fd = -1
        self._protocol.connection_lost(error)
