"""Verification of a store's whole audit log, also while its gateway writes to it."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

from rcp_kernel.errors import ConfigError
from rcp_store.chain import Head, Row
from rcp_store.file import FAULTS, ROWS, anchor_of, head_beside, open_read_only
from rcpd.verification import Verdict, verify

__all__ = ["examined", "rows_of"]


def examined(path: Path, heads: tuple[Head, ...] = ()) -> Verdict:
    """Verify the record of a store.

    :raises ConfigError: it cannot be read.
    """
    beside = head_beside(path)  # before the database, to which a running gateway adds records
    with closing(open_read_only(path)) as base:
        base.execute("BEGIN")
        try:
            known = heads if beside is None else (*heads, beside)
            return verify(rows_of(base), anchor_of(base), known)
        except FAULTS as error:
            raise ConfigError(f"the store '{path}' cannot be read: {error}") from None


def rows_of(base: sqlite3.Connection) -> Iterator[Row]:
    """Yield the records, oldest first.

    :raises sqlite3.Error: one cannot be read.
    """
    for seq, digest, data in base.execute(f"{ROWS} ORDER BY seq"):
        # A corrupt file may contain any type in any column.
        if not (isinstance(seq, int) and isinstance(digest, bytes) and isinstance(data, bytes)):
            raise sqlite3.DatabaseError("a row of the audit table is malformed")
        yield seq, digest, data
