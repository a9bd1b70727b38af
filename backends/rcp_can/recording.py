"""Record frames to candump, ASC or BLF files in a worker thread that never blocks the bus."""

from __future__ import annotations

import asyncio
import queue
import threading
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rcp_can.messages import LogFile
from rcp_kernel.errors import DeviceRejected

if TYPE_CHECKING:
    import can

__all__ = ["Recording"]

_SUFFIX = {"candump": ".log", "asc": ".asc", "blf": ".blf"}
_FLUSH = 1000  # frames handed to the thread at once


class Recording:
    """A file being written; create it with `start`."""

    def __init__(self, path: Path, writer: Any, channel: str) -> None:
        self.file = path.name
        self.frames = 0
        self.error: str | None = None
        self._writer, self._channel = writer, channel
        self._batch: list[can.Message] = []
        self._queue: queue.SimpleQueue[list[can.Message] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name=f"can log {path.name}", daemon=True)
        self._thread.start()
        self._flusher: asyncio.TimerHandle | None = None

    @classmethod
    async def start(cls, directory: str, bus: str, format_: str) -> Recording:
        """Open a new file named after the bus and the time.

        :raises DeviceRejected: the file cannot be written.
        """
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%f")[:-3]
        path = Path(directory) / f"{bus}-{stamp}{_SUFFIX[format_]}"
        make = asyncio.get_running_loop().run_in_executor
        try:
            return cls(path, await make(None, _open, path), bus)
        except OSError as error:
            raise DeviceRejected(
                f"{path} cannot be written: {error.strerror}",
                remedy="Set `log_directory` to a directory that the gateway can write to.",
            ) from error

    def tap(self, message: can.Message) -> None:
        """Record one frame."""
        if not message.timestamp:
            message.timestamp = time.time()
        self.frames += 1
        self._batch.append(message)
        if len(self._batch) >= _FLUSH:
            self._flush()
        elif self._flusher is None:
            self._flusher = asyncio.get_running_loop().call_later(0.1, self._flush)

    def _flush(self) -> None:
        if self._flusher is not None:
            self._flusher.cancel()
            self._flusher = None
        batch, self._batch = self._batch, []
        self._queue.put(batch)

    async def stop(self) -> None:
        """Write the remaining frames and close the file."""
        self._flush()
        self._queue.put(None)
        await asyncio.get_running_loop().run_in_executor(None, self._thread.join)
        if self.error is not None:
            raise DeviceRejected(f"the recording failed: {self.error}")

    def log_file(self) -> LogFile:
        """Return the file name and the number of frames so far."""
        return LogFile(file=self.file, frames=self.frames)

    def _run(self) -> None:
        while (batch := self._queue.get()) is not None:
            if self.error is not None:
                continue
            try:
                for message in batch:
                    message.channel = self._channel
                    self._writer.on_message_received(message)
            except Exception as error:
                self.error = str(error)
        try:
            self._writer.stop()
        except Exception as error:
            self.error = str(error)


def _open(path: Path) -> Any:
    import can

    path.parent.mkdir(parents=True, exist_ok=True)
    match path.suffix:
        case ".blf":
            return can.BLFWriter(path)
        case ".asc":
            return can.ASCWriter(path)
        case _:
            return can.CanutilsLogWriter(path)
