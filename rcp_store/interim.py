"""The interim database that takes new records while the store is damaged and left unchanged."""

from __future__ import annotations

from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from rcp_store.chain import Head, seal, written
from rcp_store.damage import find_damage, known_head
from rcp_store.file import HeadFile, Kept, create

__all__ = ["SUFFIXES", "open_beside", "stamp"]

SUFFIXES = ("", "-wal", "-shm", "-journal", ".head")
"""Name suffixes of the files of a database and its head."""


def stamp() -> str:
    """Return the current time in the form used in file names."""
    return datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")


def open_beside(path: Path, interim: Path, damage: str) -> None:
    """Create the interim database of a damaged store; its chain continues from the known head.

    One from an earlier start is reused, unless it is damaged as well: then it is moved aside.

    :raises OSError: it cannot be created.
    :raises sqlite3.Error: likewise.
    """
    head = known_head(path)
    if interim.exists():
        if find_damage(interim) is None:
            return
        head = max(head, known_head(interim))
        _put_aside(interim)
    for suffix in SUFFIXES:  # left by an interrupted start
        interim.with_name(interim.name + suffix).unlink(missing_ok=True)
    facts = {"head": written(head), "message": f"store damaged: {damage}"}
    gap = seal(head, "gap", facts)
    with closing(HeadFile(interim)) as file:  # first: without one, it counts as damaged
        file.open(gap[:2])
    create(interim, [gap], _anchor(head))


def _anchor(head: Head) -> list[Kept]:
    """Return the rows that let the chain begin after a head in another file."""
    if head[0] == 0:
        return []
    value = msgspec.msgpack.encode({"seq": head[0], "hash": head[1]})
    return [("audit", "anchor", value)]


def _put_aside(interim: Path) -> None:
    name = f"{interim.name}.damaged-{stamp()}"
    for suffix in SUFFIXES:
        file = interim.with_name(interim.name + suffix)
        if file.exists():
            file.rename(file.with_name(name + suffix))
