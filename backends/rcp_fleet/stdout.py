"""What Zenoh writes on standard output: its only account of what its router refuses.

It has neither an event nor a callback nor a counter for that, and its writer has no other target
than the file descriptor. So this process reads its own standard output while it is a router with
rules, and passes on what nobody takes.
"""

from __future__ import annotations

import fcntl
import os
import sys
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress

import structlog

__all__ = ["reading"]

log = structlog.get_logger("rcp.fleet")

_STDOUT = 1
_ROOM = 1_048_576  # bytes: while the pipe is full, Zenoh's threads wait
_LONGEST = 65_536  # bytes of a line that is held until it ends
_PATIENCE = 1.0  # s for what was written before the end

Take = Callable[[bytes], bool]
"""Gets a line, in a thread of its own; returns whether it is not to be written."""


class _Reader:
    """The pipe in place of standard output, and the thread that reads it."""

    def __init__(self) -> None:
        self.takers: list[Take] = []
        self._output = os.dup(_STDOUT)
        self._end, write = os.pipe()
        with suppress(OSError):
            fcntl.fcntl(write, fcntl.F_SETPIPE_SZ, _ROOM)
        _flush()
        os.dup2(write, _STDOUT)
        os.close(write)
        self._thread = threading.Thread(target=self._read, name="zenoh output", daemon=True)
        self._thread.start()

    def restore(self) -> None:
        """Give standard output back; the thread ends when the last process that has it does."""
        _flush()
        os.dup2(self._output, _STDOUT)
        self._thread.join(_PATIENCE)

    def _read(self) -> None:
        rest = b""
        while data := os.read(self._end, _LONGEST):
            *lines, rest = (rest + data).split(b"\n")
            for line in lines:
                taken = [_offered(take, line) for take in list(self.takers)]  # each gets it
                if not any(taken):
                    self._pass(line + b"\n")
            if len(rest) > _LONGEST:
                self._pass(rest)
                rest = b""
        self._pass(rest)
        os.close(self._end)
        os.close(self._output)

    def _pass(self, data: bytes) -> None:
        with suppress(OSError):  # nobody reads it
            while data:
                data = data[os.write(self._output, data) :]


def _offered(take: Take, line: bytes) -> bool:
    try:
        return take(line)
    except Exception:  # nobody would read on, and whatever writes would wait for ever
        log.exception("output_line_failed")
        return False


def _flush() -> None:
    with suppress(ValueError, OSError):  # it is closed
        sys.stdout.flush()


_reader: _Reader | None = None


@contextmanager
def reading(take: Take) -> Generator[None]:
    """Give a function each line that this process writes on standard output while entered."""
    global _reader  # noqa: PLW0603 - there is one standard output
    if _reader is None:
        _reader = _Reader()
    reader = _reader
    reader.takers.append(take)
    try:
        yield
    finally:
        if len(reader.takers) == 1:
            _reader = None
            reader.restore()
        reader.takers.remove(take)
