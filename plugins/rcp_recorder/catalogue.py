"""The recordings in the folder: changed by the writer's thread, read by any."""

from __future__ import annotations

import shutil
import struct
from pathlib import Path

import msgspec
import structlog
from mcap.exceptions import McapError

from rcp_recorder.kept import PIN, Kept, read
from rcp_recorder.repair import DAMAGED, repair
from rcp_recordings.names import ACTIVE

__all__ = ["Catalogue", "NoSpace"]

log = structlog.get_logger("rcp.recorder")
_UNREADABLE = (
    OSError, McapError, ValueError, KeyError, struct.error, OverflowError, MemoryError
)  # fmt: skip
"""Errors of a file that is damaged, or not one of ours."""


class NoSpace(OSError):
    """Nothing more may be written."""


class Catalogue:
    """Knows the files, and keeps them within their space."""

    def __init__(self, folder: Path, *, keep: float, free: float) -> None:
        self.folder = folder
        self._keep = keep
        self._free = free
        self.files: dict[str, Kept] = {}
        """Complete files by name; replaced as a whole."""
        self.repaired = 0
        self.damaged = 0
        """Files with damage before their end, which were put aside."""
        self.deleted = 0

    def open(self) -> None:
        """Complete what an earlier run left unfinished, and look at what there is.

        :raises OSError: the folder cannot be written.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        for path in sorted(self.folder.glob(f"*{ACTIVE}")):
            if (kept := repair(path)) is not None:
                self.repaired += 1
                log.info("recording_recovered", file=kept.name)
        self.damaged = sum(1 for _ in self.folder.glob(f"*{ACTIVE}{DAMAGED}"))
        found = (self._look(path) for path in sorted(self.folder.glob("*.mcap")))
        self.files = {kept.file: kept for kept in found if kept is not None}

    def add(self, path: Path) -> None:
        """Take in a file that is now complete."""
        if (kept := self._look(path)) is not None:
            self.files = {**self.files, kept.file: kept}

    def pin(self, file: str, *, pinned: bool) -> None:
        """Keep a file, or no longer; the mark is a file beside it."""
        kept = self.files.get(file)
        if kept is None:
            return
        mark = self.folder / f"{file}{PIN}"
        if pinned:
            mark.touch()
        else:
            mark.unlink(missing_ok=True)
        self.files = {**self.files, file: msgspec.structs.replace(kept, pinned=pinned)}

    def make_room(self, active: int) -> None:
        """Delete the oldest files until all, with `active` bytes of open ones, fit.

        :raises NoSpace: they do not, or the disk is full.
        """
        used = active + sum(kept.bytes for kept in self.files.values())
        loose = sorted((k for k in self.files.values() if not k.pinned), key=lambda k: k.order)
        files = dict(self.files)
        for kept in loose:
            if used <= self._keep:
                break
            (self.folder / kept.file).unlink(missing_ok=True)
            del files[kept.file]
            used -= kept.bytes
            self.deleted += 1
        if len(files) != len(self.files):
            self.files = files
        if used - active > self._keep:
            raise NoSpace("pinned recordings take all of keep_mb: unpin or move some")
        if shutil.disk_usage(self.folder).free < self._free:
            raise NoSpace(f"less than free_mb is free on the disk of {self.folder.name}")

    def _look(self, path: Path) -> Kept | None:
        try:
            return read(path)
        except _UNREADABLE as error:
            log.warning("recording_unreadable", file=path.name, error=str(error))
            return None
