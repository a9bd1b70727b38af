"""Writes recordings on a thread of its own; the event loop only hands messages over."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path

import structlog

from rcp_kernel.clock import iso
from rcp_recorder.catalogue import Catalogue
from rcp_recorder.channels import Message, Stream
from rcp_recorder.config import RecorderConfig
from rcp_recorder.mcap_file import OpenFile
from rcp_recorder.turns import take_turns
from rcp_recordings.names import ACTIVE

__all__ = ["MB", "OVERHEAD", "Writer"]

log = structlog.get_logger("rcp.recorder")
MB = 1e6
_POLL = 0.1  # s between looks at the queue
_FLUSH = 0.5  # s that a message waits in memory at most
_RETRY = 10.0  # s until writing is tried again
_BACK = 1_000_000_000  # ns by which a clock was set back, not only adjusted
OVERHEAD = 200  # bytes of memory of a message besides its data


class Writer:
    """Takes messages from the event loop; all else happens on its thread.

    Numbers are written by one side only, and read by both.
    """

    def __init__(
        self,
        config: RecorderConfig,
        changed: Callable[[], None],
        open_file: Callable[[Path, Stream, float], OpenFile],
    ) -> None:
        self._config = config
        self._folder = Path(config.folder)
        self._changed = changed
        self._open_file = open_file
        self.catalogue = Catalogue(self._folder, keep=config.keep_mb * MB, free=config.free_mb * MB)
        self._queue: deque[tuple[Stream, Sequence[Message]]] = deque()
        self._jobs: deque[Callable[[], None]] = deque()
        self._limit = int(config.queue_mb * MB)
        self._added = 0
        self._taken = 0
        self.dropped = 0
        """Messages for which the queue had no room."""
        self.lost = 0
        """Messages that could not be written."""
        self.set_back = 0
        """How often the clock was set back."""
        self.set_back_at: str | None = None
        self.trouble: str | None = None
        """Why nothing is recorded; None while it is."""
        self.open: dict[Stream, OpenFile] = {}
        """Files being written; replaced as a whole."""
        self._retry = 0.0
        self._ready = False
        self._closing = threading.Event()
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._run, name="rcp-recorder", daemon=True)

    # -- the event loop ------------------------------------------------------------------------

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self) -> None:
        """Write what is left, complete all files, end the thread; blocks."""
        self._closing.set()
        self._wake.set()
        self._thread.join()

    def add(self, stream: Stream, message: Message) -> None:
        """Hand a message over, or drop it if too many wait."""
        size = len(message[4]) + OVERHEAD
        if self._added - self._taken + size > self._limit:
            self.dropped += 1
            return
        self._added += size
        self._queue.append((stream, (message,)))

    def add_all(self, stream: Stream, messages: Sequence[Message], size: int) -> None:
        """Hand over messages that are in memory already, so that the queue's limit is none."""
        self._added += size
        self._queue.append((stream, messages))

    def end(self, stream: Stream) -> None:
        """Complete the file of a stream, after all its messages."""
        self._queue.append((stream, ()))
        self._wake.set()

    def pin(self, file: str, *, pinned: bool) -> None:
        """Pin or unpin a file."""
        self._jobs.append(lambda: self.catalogue.pin(file, pinned=pinned))
        self._wake.set()

    @property
    def waiting(self) -> int:
        """Bytes that wait to be written."""
        return self._added - self._taken

    # -- its thread ----------------------------------------------------------------------------

    def _run(self) -> None:
        while True:
            closing = self._closing.is_set()
            try:
                self._work(time.monotonic())
            except Exception as error:
                self._fail(error)
            if closing and not self._queue:
                self._finish_all()
                return
            self._wake.wait(_POLL)
            self._wake.clear()

    def _work(self, now: float) -> None:
        if not self._ready:
            if now < self._retry and not self._closing.is_set():
                self._discard()
                return
            self._prepare()
        while self._jobs:
            self._jobs.popleft()()
            self._changed()
        self._drain(now)
        self._tend(now)

    def _prepare(self) -> None:
        """Begin, or begin again after a failure."""
        self.catalogue.open()
        self.catalogue.make_room(0)
        if self.trouble is not None:
            log.info("recording_resumed")
        self._ready, self.trouble = True, None
        self._changed()

    def _drain(self, now: float) -> None:
        count = 0
        for _ in range(len(self._queue)):  # what comes meanwhile waits for the flush
            stream, messages = self._queue.popleft()
            if not messages:
                self._finish(stream)
            for number, message in enumerate(messages):
                try:
                    self._write(stream, message, now)
                except Exception:
                    self._lose(messages[number:])
                    raise
                self._taken += len(message.data) + OVERHEAD
                count += 1
                take_turns(count)

    def _lose(self, messages: Sequence[Message]) -> None:
        self._taken += sum(len(message.data) + OVERHEAD for message in messages)
        self.lost += len(messages)

    def _write(self, stream: Stream, message: Message, now: float) -> None:
        file = self.open.get(stream)
        if file is not None and file.messages and message.log_time < file.end - _BACK:
            self._note_clock(file.end, message.log_time)
            self._finish(stream)
            file = None
        if file is None:
            file = self._create(stream, message, now)
        file.add(message)

    def _note_clock(self, before: int, after: int) -> None:
        """Tell that the clock was set back; each file is in order."""
        self.set_back += 1
        self.set_back_at = iso(before)
        log.warning("recording_clock_set_back", before=iso(before), after=iso(after))
        self._changed()

    def _create(self, stream: Stream, message: Message, now: float) -> OpenFile:
        moment = "".join(c for c in iso(message.log_time)[:26] if c.isalnum())
        stem, number = f"{stream.name}.{stream.tenant}.{moment}", 0
        while True:
            name = f"{stem}.{number}.mcap" if number else f"{stem}.mcap"
            path = self._folder / name
            if not path.exists() and not path.with_name(name + ACTIVE).exists():
                break
            number += 1
        file = self._open_file(Path(f"{path}{ACTIVE}"), stream, now)
        self.open = {**self.open, stream: file}
        self._changed()
        return file

    def _tend(self, now: float) -> None:
        """Flush, roll and make room."""
        flushed = False
        for stream, file in list(self.open.items()):
            if now - file.flushed >= _FLUSH:
                begun = file.progress is None
                file.flush(now)
                flushed = True
                if begun:
                    self._changed()
            old = now - file.opened >= self._config.roll_seconds
            if old or file.size >= self._config.roll_mb * MB:
                self._finish(stream)
        if flushed:
            self.catalogue.make_room(sum(file.size for file in self.open.values()))

    def _finish(self, stream: Stream) -> None:
        file = self.open.get(stream)
        if file is None:
            return
        self.catalogue.add(file.finish())
        self.open = {each: open_ for each, open_ in self.open.items() if each is not stream}
        self._changed()

    def _finish_all(self) -> None:
        for stream in list(self.open):
            try:
                self._finish(stream)
            except Exception as error:  # it is completed at the next start
                log.error("recording_unfinished", error=str(error))
                self.open[stream].abandon()

    def _fail(self, error: Exception) -> None:
        """Stop until the retry: everything written so far stays."""
        expected = isinstance(error, OSError)
        told = str(error) if expected else f"{type(error).__name__}: see the log of the gateway"
        if self.trouble is None:
            log.error("recording_stopped", error=told, exc_info=None if expected else error)
        self.trouble = told
        for file in self.open.values():
            file.abandon()
        self.open = {}
        self._ready = False
        self._retry = time.monotonic() + _RETRY
        self._discard()
        self._changed()

    def _discard(self) -> None:
        while self._queue:
            self._lose(self._queue.popleft()[1])
