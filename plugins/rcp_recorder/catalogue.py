"""The recordings in the folder: changed by the writer's thread, read by any."""

from __future__ import annotations

import contextlib
import shutil
from pathlib import Path

import msgspec
import structlog
from mcap.exceptions import McapError
from mcap.reader import SeekingReader

from rcp_recorder.channels import KIND, PATH, SAMPLE
from rcp_recorder.mcap_file import ACTIVE, FACTS, RECOVERY
from rcp_recorder.repair import repair

__all__ = ["INCIDENT", "Catalogue", "Kept", "NoSpace"]

log = structlog.get_logger("rcp.recorder")
_PIN = ".pin"
INCIDENT = "incident"


class NoSpace(OSError):
    """Nothing more may be written."""


class Kept(msgspec.Struct, frozen=True, kw_only=True):
    """A complete file."""

    file: str
    name: str
    tenant: str
    start: int
    end: int
    bytes: int
    messages: int
    samples: frozenset[str]
    """Resources with samples."""
    others: frozenset[str]
    """Resources with nothing but commands and events."""
    recovered: bool
    pinned: bool
    reason: str | None = None
    robot: str | None = None

    @property
    def order(self) -> tuple[bool, int]:
        """By what files leave: incidents after all others, the oldest first."""
        return self.name == INCIDENT, self.end


class Catalogue:
    """Knows the files, and keeps them within their space."""

    def __init__(self, folder: Path, *, keep: float, free: float) -> None:
        self.folder = folder
        self._keep = keep
        self._free = free
        self.files: dict[str, Kept] = {}
        """Complete files by name; replaced as a whole."""
        self.repaired = 0
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
        mark = self.folder / f"{file}{_PIN}"
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
            return _read(path)
        except (OSError, McapError, ValueError, KeyError) as error:
            log.warning("recording_unreadable", file=path.name, error=str(error))
            return None


def _read(path: Path) -> Kept | None:
    with path.open("rb") as file:
        reader = SeekingReader(file)
        summary = reader.get_summary()
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    facts = metadata.get(FACTS)
    if summary is None or summary.statistics is None or facts is None:
        return None  # not one of ours
    paths: dict[bool, set[str]] = {True: set(), False: set()}
    for channel in summary.channels.values():
        with contextlib.suppress(KeyError):
            paths[channel.metadata[KIND] == SAMPLE].add(channel.metadata[PATH])
    numbers = summary.statistics
    return Kept(
        file=path.name,
        name=facts["recording"],
        tenant=facts["tenant"],
        start=numbers.message_start_time,
        end=numbers.message_end_time,
        bytes=path.stat().st_size,
        messages=numbers.message_count,
        samples=frozenset(paths[True]),
        others=frozenset(paths[False]),
        recovered=RECOVERY in metadata,
        pinned=path.with_name(f"{path.name}{_PIN}").exists(),
        reason=facts.get("reason"),
        robot=facts.get("robot"),
    )
