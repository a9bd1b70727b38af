"""Runs queries in processes of their own: a long answer takes neither memory nor interpreter of the gateway."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from collections.abc import AsyncGenerator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import msgspec

from rcp_kernel.errors import (
    DeviceRejected,
    InternalError,
    InvalidValue,
    NotImplementedByRobot,
    QueueFull,
)
from rcp_protocol.timeouts import timeout
from rcp_recordings.query import Query

__all__ = ["COPIES", "PAGES", "WAITING", "Queries"]

PAGES, COPIES = 2, 2
"""At once: a copy takes as long as its client reads, and keeps nobody's page waiting."""
WAITING = 16
"""More than these, of both, are refused."""
_PATIENCE = 20.0  # s that a query waits for others
_PIECE = 256 * 1024
_KEPT = ("PATH", "PYTHONPATH", "LD_LIBRARY_PATH", "LANG", "LC_ALL", "SYSTEMROOT")
"""Variables that the process gets: secrets of the gateway are none of its business."""


class Queries:
    """Answers a few queries at a time; others wait."""

    def __init__(self) -> None:
        self._pages = asyncio.Semaphore(PAGES)
        self._copies = asyncio.Semaphore(COPIES)
        self._waiting = 0
        self._threads = ThreadPoolExecutor(PAGES + COPIES, thread_name_prefix="rcp-history")
        self._running: set[subprocess.Popen[bytes]] = set()

    def close(self) -> None:
        """End all."""
        for process in list(self._running):
            process.kill()
        self._threads.shutdown(wait=False, cancel_futures=True)

    async def answer(self, query: Query, *, copy: bool = False) -> AsyncGenerator[bytes]:
        """Return the answer piece by piece; the process ends with the generator.

        A `copy` is read by its client as it comes.

        :raises QueueFull: too many are waiting, or for too long.
        :raises RcpError: it cannot be answered.
        """
        if self._waiting >= WAITING:
            raise QueueFull("too many queries of recordings are waiting", remedy="Try again later.")
        self._waiting += 1
        places = self._copies if copy else self._pages
        try:
            async with timeout(_PATIENCE):
                await places.acquire()
        except TimeoutError:
            raise QueueFull(
                "other queries of recordings take long", remedy="Try again later."
            ) from None
        finally:
            self._waiting -= 1
        loop = asyncio.get_running_loop()
        process: subprocess.Popen[bytes] | None = None
        try:
            starting = loop.run_in_executor(self._threads, self._start, query)
            try:
                process = started = await asyncio.shield(starting)
            except asyncio.CancelledError:
                starting.add_done_callback(self._end_started)
                raise
            out = started.stdout
            assert out is not None
            # Nobody waits for a thread here: a process that is killed ends what it reads.
            _check(await loop.run_in_executor(self._threads, out.readline))
            read = out.read1  # pyright: ignore[reportAttributeAccessIssue] - of a buffered reader
            while piece := await loop.run_in_executor(self._threads, read, _PIECE):
                yield piece
            if await loop.run_in_executor(self._threads, started.wait):
                raise InternalError("the recordings could not be read to the end")
        finally:
            if process is not None:
                self._end(process)
            places.release()

    def _end_started(self, started: asyncio.Future[subprocess.Popen[bytes]]) -> None:
        if not started.cancelled() and started.exception() is None:
            self._end(started.result())

    def _end(self, process: subprocess.Popen[bytes]) -> None:
        self._running.discard(process)
        if process.poll() is None:
            process.kill()
            process.wait()  # a killed process ends at once
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()

    def _start(self, query: Query) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-P", "-m", "rcp_recordings"]
        process = subprocess.Popen(  # noqa: S603 - of this module and a query that was checked
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={name: value for name, value in os.environ.items() if name in _KEPT},
        )
        self._running.add(process)
        assert process.stdin is not None
        with suppress(BrokenPipeError):
            process.stdin.write(msgspec.json.encode(query))
            process.stdin.close()
        return process


def _check(head: bytes) -> None:
    """Raise what the first line of an answer tells."""
    told = msgspec.json.decode(head) if head else {"error": "it ended without an answer"}
    if "error" not in told:
        return
    if told.get("kind") in ("ModuleNotFoundError", "ImportError"):
        raise NotImplementedByRobot(
            "this gateway does not write Parquet or Arrow",
            remedy="Run `pip install 'rcp-gateway[parquet]'` on the gateway, or choose `csv`.",
        )
    if told.get("kind") == "ValueError":
        raise InvalidValue(told["error"], remedy="Choose another format, path or time.")
    raise DeviceRejected(f"the recordings cannot be read: {told['error']}")
