"""The interface of the store, and a store that keeps nothing."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rcp_store.chain import Head, Row

__all__ = ["Store"]


class Store:
    """The store of a gateway without `[store] path`: it keeps nothing. Base class of the other."""

    keeps = False
    """Whether values survive; if not, expensive preparation can be skipped."""
    damage: str | None = None
    """Why the interim database is used instead of the configured one; None if it is not."""
    lost = False
    """Whether something could not be written at the end."""
    trouble: str | None = None
    """Why writing fails; None if it works."""
    waiting = 0
    """Number of audit rows not committed yet."""
    left: Head | None = None
    """The head of the audit that the previous run stored beside the database."""
    head: Head | None = None
    """The last audit row committed in this run."""

    @property
    def path(self) -> Path | None:
        """The database in use: the interim one if the configured one is damaged."""
        return None

    def put(self, table: str, key: str, value: Any | None) -> None:
        """Store a value that MessagePack can encode; None deletes the key. Returns at once."""

    def load(self, table: str, *, unreadable: Any = None) -> dict[str, Any]:
        """Return what earlier runs stored in a table. Blocks: use it only at the start.

        An unreadable row gets the value `unreadable`; with None it is omitted.
        """
        return {}

    def append(self, row: Row) -> None:
        """Add an audit row. Returns at once."""

    def prune(self, before: int) -> None:
        """Delete the audit rows before a number. Returns at once."""

    def rows(self, last: int) -> list[Row]:
        """Return the last audit rows of earlier runs. Blocks: use it only at the start."""
        return []

    @property
    def idle(self) -> bool:
        """Whether everything is committed."""
        return True

    def settled(self, callback: Callable[[], object]) -> None:
        """Call back on the event loop once everything put so far is committed."""
        callback()

    def look(self, work: Callable[[sqlite3.Connection], Any], then: Callable[[Any], None]) -> None:
        """Run a query on the store's thread; `then` gets the result on the event loop."""

    def close(self) -> None:
        """Write the rest, then stop."""
