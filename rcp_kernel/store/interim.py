"""Where the record goes on while a store is damaged: a database beside it, which is left as it is."""

from __future__ import annotations

from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from rcp_kernel.store.chain import Head, seal, written
from rcp_kernel.store.damage import find_damage, known_head
from rcp_kernel.store.file import HeadFile, Kept, create

__all__ = ["SUFFIXES", "open_beside", "stamp"]

SUFFIXES = ("", "-wal", "-shm", "-journal", ".head")
"""What the files of a database and its head are called, by what is added to its name."""


def stamp() -> str:
    """Return the present time as it is put into the names of files."""
    return datetime.now(UTC).strftime("%Y%m%dT%H%M%S.%fZ")


def open_beside(path: Path, interim: Path, damage: str) -> None:
    """Have a database in which the record of a damaged store goes on after what is known of it.

    One that an earlier start made is used again, unless it is damaged as well: it is put aside.

    :raises OSError: there can be none.
    :raises sqlite3.Error: likewise.
    """
    head = known_head(path)
    if interim.exists():
        if find_damage(interim) is None:
            return
        head = max(head, known_head(interim))
        _put_aside(interim)
    for suffix in SUFFIXES:  # of a start that was cut off
        interim.with_name(interim.name + suffix).unlink(missing_ok=True)
    facts = {"head": written(head), "message": f"store damaged: {damage}"}
    gap = seal(head, "gap", facts)
    with closing(HeadFile(interim)) as file:  # first: a database without one counts as damaged
        file.open(gap[:2])
    create(interim, [gap], _anchor(head))


def _anchor(head: Head) -> list[Kept]:
    """Have the chain begin after a head that is in another file."""
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
