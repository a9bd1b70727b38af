"""What survives the process, as the parts of the gateway see it; and a store that keeps nothing."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rcp_kernel.store.chain import Head, Row

__all__ = ["Store"]


class Store:
    """Keeps nothing: the store of a gateway without `[store] path`, and the base of the other."""

    keeps = False
    """Whether anything survives; what is dear to prepare need not be put where nothing does."""
    damage: str | None = None
    """Why the database that is configured is left alone, and another one is written."""
    lost = False
    """Whether something could not be written before the end."""
    trouble: str | None = None
    """Why nothing can be written at present."""
    waiting = 0
    """Rows of the audit that are not committed yet."""
    left: Head | None = None
    """The head of the audit as the earlier run left it beside the database."""
    head: Head | None = None
    """The last row of the audit that this run committed."""

    @property
    def path(self) -> Path | None:
        """The database that is written; it is beside that of the configuration if that is damaged."""
        return None

    def put(self, table: str, key: str, value: Any | None) -> None:
        """Keep a value that msgpack takes under a key; None deletes. Returns at once."""

    def load(self, table: str, *, unreadable: Any = None) -> dict[str, Any]:
        """Return what earlier runs kept in a table. Blocks: for the start only.

        A row that cannot be read counts as `unreadable`; it is left out if that is None.
        """
        return {}

    def append(self, row: Row) -> None:
        """Add a row to the audit. Returns at once."""

    def prune(self, before: int) -> None:
        """Delete the audit's rows before a number. Returns at once."""

    def rows(self, last: int) -> list[Row]:
        """Return the last rows of the audit that earlier runs left. Blocks: for the start only."""
        return []

    @property
    def idle(self) -> bool:
        """Whether all that was put is committed."""
        return True

    def settled(self, callback: Callable[[], object]) -> None:
        """Call back on the event loop once all that was put before is committed."""
        callback()

    def look(self, work: Callable[[sqlite3.Connection], Any], then: Callable[[Any], None]) -> None:
        """Have the store's thread look something up; `then` gets it on the event loop."""

    def close(self) -> None:
        """Write what is left, then stop."""
