"""A plugin's own table in the gateway's store."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rcp_store.store import Store

__all__ = ["PluginStore"]


class PluginStore:
    """Keyed values that survive a restart if the gateway has a store."""

    def __init__(self, store: Store, table: str) -> None:
        self._store = store
        self._table = table

    @property
    def keeps(self) -> bool:
        """Whether values survive; if not, expensive preparation can be skipped."""
        return self._store.keeps

    def put(self, key: str, value: Any | None) -> None:
        """Store a value that MessagePack can encode; None deletes the key. Returns at once."""
        self._store.put(self._table, key, value)

    def load(self, *, unreadable: Any = None) -> dict[str, Any]:
        """Return the values of earlier runs. Blocks: use it only at the start.

        An unreadable value is replaced by `unreadable`; with None it is omitted.
        """
        return self._store.load(self._table, unreadable=unreadable)

    def settled(self, callback: Callable[[], object]) -> None:
        """Call back on the event loop once everything put so far is committed; at once without a store."""
        self._store.settled(callback)
