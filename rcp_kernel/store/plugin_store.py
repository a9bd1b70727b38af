"""A table of an adapter's own in the gateway's store."""

from __future__ import annotations

from typing import Any

from rcp_kernel.store.store import Store

__all__ = ["PluginStore"]


class PluginStore:
    """Keyed values that survive the process where the gateway has a store."""

    def __init__(self, store: Store, table: str) -> None:
        self._store = store
        self._table = table

    @property
    def keeps(self) -> bool:
        """Whether anything survives; what is dear to prepare need not be put where nothing does."""
        return self._store.keeps

    def put(self, key: str, value: Any | None) -> None:
        """Keep a value that MessagePack takes under a key; None deletes. Returns at once."""
        self._store.put(self._table, key, value)

    def load(self) -> dict[str, Any]:
        """Return what earlier runs kept. Blocks: for the start only."""
        return self._store.load(self._table)
