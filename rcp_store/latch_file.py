"""A second copy of the latched e-stops: a small file beside the store that outlives its database.

It is JSON with a version and a checksum, replaced atomically: written, synced to disk, renamed,
and the folder synced. The replaced file is reused for the next version, so latches can be stored
even when the disk is full.
"""

from __future__ import annotations

import errno
import hashlib
import os
from pathlib import Path
from typing import Any

import msgspec

from rcp_protocol.clock import now

__all__ = [
    "GATEWAY",
    "LATCHES",
    "LatchFile",
    "encode_latches",
    "latch_row",
    "latches_beside",
    "union",
]

LATCHES = "latches"
"""The table of the store that the file duplicates."""
GATEWAY = "*"
"""The key of the gateway-wide latch."""
_VERSION = 1
_SPACE = 65536  # minimum size of the file and its spare, in bytes
Rows = dict[str, dict[str, Any]]


class _Row(msgspec.Struct):
    """The stored form of a latch."""

    by: str
    reason: str | None
    since: int
    freed: list[str]


class _Content(msgspec.Struct, forbid_unknown_fields=True):
    version: int
    sha256: str
    latches: Rows


def latches_beside(path: Path) -> Path:
    """Return the path of the second copy of a store's latches."""
    return path.with_name(path.name + ".latches")


def latch_row(by: str, reason: str) -> dict[str, Any]:
    """Return the stored form of a new latch."""
    return {"by": by, "reason": reason, "since": now(), "freed": []}


def encode_latches(rows: Rows) -> bytes:
    """Encode the content of the file."""
    content = _Content(_VERSION, _checksum(rows), rows)
    return msgspec.json.encode(content)


def union(kept: dict[str, Any], beside: Rows) -> Rows:
    """Merge the latches of both copies; a robot counts as reset only if both copies agree.

    An invalid row of the database counts as a latch from which no robot was reset.
    """
    merged: Rows = dict(beside)
    for key, value in kept.items():
        row = _checked(value)
        other = beside.get(key)
        if other is None:
            merged[key] = row
        else:
            freed = _freed(row) & _freed(_checked(other))
            merged[key] = {**other, **row, "freed": sorted(freed)}
    return merged


def _checked(value: Any) -> dict[str, Any]:
    """Return a stored row; empty if it is invalid."""
    try:
        return msgspec.to_builtins(msgspec.convert(value, _Row))
    except msgspec.ValidationError:
        return {}


def _freed(row: dict[str, Any]) -> set[str]:
    return set(row.get("freed", ()))


def _checksum(rows: Rows) -> str:
    return hashlib.sha256(msgspec.json.encode(rows, order="deterministic")).hexdigest()


class LatchFile:
    """The latch file of one store. Calls block; use it from one thread at a time."""

    def __init__(self, path: Path) -> None:
        self.path = latches_beside(path)
        self._spare = self.path.with_name(self.path.name + ".spare")
        self._swap = self.path.with_name(self.path.name + ".swap")

    def read(self) -> Rows | None:
        """Return the latches, or None if there is no file.

        :raises ValueError: the file is damaged.
        :raises OSError: it cannot be read.
        """
        try:
            data = self.path.read_bytes()
        except FileNotFoundError:
            return None
        try:
            content = msgspec.json.decode(data, type=_Content)
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise ValueError(f"it cannot be read ({error})") from None
        if content.version != _VERSION:
            raise ValueError(f"its version {content.version} is not supported by this gateway")
        if content.sha256 != _checksum(content.latches):
            raise ValueError("its checksum is wrong")
        return content.latches

    def write(self, data: bytes) -> None:
        """Replace the file; return once it would survive a power failure.

        :raises OSError: it cannot be written.
        """
        self._reclaim()
        self._fill(self._spare, data)
        try:
            self._swap.unlink(missing_ok=True)
            self._swap.hardlink_to(self.path)
        except OSError:  # no file yet, or no hard links on this file system
            self._spare.replace(self.path)
            self._reserve()
        else:
            self._spare.replace(self.path)
            self._swap.replace(self._spare)
        _flush_folder(self.path.parent)

    def _reclaim(self) -> None:
        """Take the spare back from a write that was killed on the way: a full disk has no other."""
        if self._swap.exists() and not self._spare.exists() and not self._is_current(self._swap):
            self._swap.replace(self._spare)

    def _is_current(self, file: Path) -> bool:
        """Return whether it is another name of the file itself, which is never written in place."""
        return self.path.exists() and file.samefile(self.path)

    def put_aside(self, stamp: str) -> Path:
        """Rename a damaged file, to keep it for inspection; return its new path."""
        aside = self.path.with_name(f"{self.path.name}.damaged-{stamp}")
        return self.path.rename(aside)

    def _reserve(self) -> None:
        try:
            self._fill(self._spare, b"")
        except OSError as error:
            if error.errno != errno.ENOSPC:  # otherwise the next write reports it
                raise

    @staticmethod
    def _fill(path: Path, data: bytes) -> None:
        """Write in place, padded with spaces: allocated blocks are available on a full disk too."""
        place = os.open(path, os.O_CREAT | os.O_WRONLY, 0o600)
        try:
            size = max(os.fstat(place).st_size, -(-len(data) // _SPACE) * _SPACE, _SPACE)
            rest = memoryview(data.ljust(size))
            while rest:
                rest = rest[os.write(place, rest) :]
            os.fsync(place)
        finally:
            os.close(place)


def _flush_folder(folder: Path) -> None:
    if os.name == "nt":  # names are synced with the file
        return
    place = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(place)
    finally:
        os.close(place)
