"""The recordings in the folder: changed by the writer's thread, read by any."""

from __future__ import annotations

import shutil
import struct
from functools import partial
from pathlib import Path
from typing import NamedTuple

import msgspec
import structlog
from mcap.exceptions import McapError

from rcp_recorder.kept import INCIDENT, PIN, Kept, read
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


class Damaged(NamedTuple):
    """A file with damage before its end."""

    bytes: int
    order: tuple[bool, int]
    """As that of `Kept`."""


class Catalogue:
    """Knows the files, and keeps them within their space."""

    def __init__(self, folder: Path, *, keep: float, free: float) -> None:
        self.folder = folder
        self._keep = keep
        self._free = free
        self.files: dict[str, Kept] = {}
        """Complete files by name; replaced as a whole."""
        self.repaired = 0
        self.damaged: dict[str, Damaged] = {}
        """Files that were put aside, or wait for room for what can be read of them; replaced as a whole."""
        self.deleted = 0
        self.damaged_deleted = 0
        self._wait: dict[str, int] = {}
        """Bytes of room that damaged files wait for."""

    def open(self) -> None:
        """Complete what an earlier run left unfinished, and look at what there is.

        :raises OSError: the folder cannot be written.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        found = (self._look(path) for path in sorted(self.folder.glob("*.mcap")))
        self.files = {kept.file: kept for kept in found if kept is not None}
        self.damaged = dict(map(_damaged, self.folder.glob(f"*{ACTIVE}{DAMAGED}")))
        for path in sorted(self.folder.glob(f"*{ACTIVE}")):
            self._repair(path)
        self.damaged = {**self.damaged, **dict(map(_damaged, self.folder.glob(f"*{ACTIVE}")))}

    def _repair(self, path: Path) -> None:
        wanted = self._wait.get(path.name)
        if wanted is not None and not self._has_room(wanted):
            return  # as before: it need not be read again
        self._wait.pop(path.name, None)
        if (kept := repair(path, partial(self._make_room_for, path.name))) is not None:
            self.repaired += 1
            log.info("recording_recovered", file=kept.name)
            self.add(kept)
        aside = path.with_name(f"{path.name}{DAMAGED}")
        if aside.exists():
            self.damaged = {**self.damaged, **dict([_damaged(aside)])}

    def _make_room_for(self, file: str, size: int) -> bool:
        """Make room for what can be read of a damaged file; return whether there is."""
        if not self._has_room(size):
            self._wait[file] = size
            return False
        self._delete(self._unfinished() + size)
        return True

    def _has_room(self, size: int) -> bool:
        """Return whether so much fits, once the oldest files are deleted."""
        pinned = sum(kept.bytes for kept in self.files.values() if kept.pinned)
        more = self._unfinished() + size
        leaves = max(0.0, self._used() + more - self._keep)
        free = shutil.disk_usage(self.folder).free + leaves - size
        return pinned + more <= self._keep and free >= self._free

    def _unfinished(self) -> int:
        return sum(path.stat().st_size for path in self.folder.glob(f"*{ACTIVE}"))

    def _used(self) -> int:
        kept = sum(kept.bytes for kept in self.files.values())
        return kept + sum(damaged.bytes for damaged in self.damaged.values())

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
        if self._delete(active) > self._keep:
            raise NoSpace("pinned recordings take all of keep_mb: unpin or move some")
        if shutil.disk_usage(self.folder).free < self._free:
            raise NoSpace(f"less than free_mb is free on the disk of {self.folder.name}")

    def _delete(self, more: int) -> int:
        """Delete the oldest files until all fit, with some bytes more; return what is used without these."""
        if self.damaged:  # some may have been moved away
            there = {n: each for n, each in self.damaged.items() if (self.folder / n).exists()}
            self.damaged = there
        used = self._used() + more
        if used <= self._keep:
            return used - more
        files, damaged = dict(self.files), dict(self.damaged)
        loose = [(kept.order, name) for name, kept in files.items() if not kept.pinned]
        for _, name in sorted([*loose, *((each.order, name) for name, each in damaged.items())]):
            if used <= self._keep:
                break
            (self.folder / name).unlink(missing_ok=True)
            if name in files:
                used -= files.pop(name).bytes
                self.deleted += 1
            else:
                used -= damaged.pop(name).bytes
                self.damaged_deleted += 1
                log.warning("damaged_recording_deleted", file=name)
        self.files, self.damaged = files, damaged
        return used - more

    def _look(self, path: Path) -> Kept | None:
        try:
            return read(path)
        except _UNREADABLE as error:
            log.warning("recording_unreadable", file=path.name, error=str(error))
            return None


def _damaged(path: Path) -> tuple[str, Damaged]:
    found = path.stat()
    return path.name, Damaged(
        found.st_size, (path.name.startswith(f"{INCIDENT}."), found.st_mtime_ns)
    )
