"""Keys of issuers in the store, for a start at which an issuer cannot be reached."""

from __future__ import annotations

from typing import Any, NamedTuple

import msgspec
import structlog

from rcp_jwt.jwks import PublicKey, der_of, read_der
from rcp_kernel.clock import Clock
from rcp_store.plugin_store import PluginStore

__all__ = ["KeptKeys", "Recalled"]

log = structlog.get_logger("rcp.jwt")
_S = 1_000_000_000  # ns


class _Row(msgspec.Struct, frozen=True):
    fetched: int
    """In ns since the UNIX epoch."""
    keys: tuple[tuple[str | None, bytes], ...]
    """The id and the DER form of each."""


class Recalled(NamedTuple):
    """Keys that were fetched in an earlier run."""

    keys: tuple[PublicKey, ...]
    age: float
    """In s."""


class KeptKeys:
    """The last fetched keys of each source, which count as long as if the gateway had gone on running."""

    def __init__(self, clock: Clock, store: PluginStore | None) -> None:
        self._now = clock.now
        self._store = store
        self._rows: dict[str, Any] = {}

    def load(self, sources: set[str]) -> None:
        """Take over the keys of earlier runs, and delete those of other sources. Blocks."""
        self._rows = {} if self._store is None else self._store.load()
        for source in self._rows.keys() - sources:
            self._put(source, None)

    def recall(self, source: str, lifetime: float) -> Recalled | None:
        """Return the keys of a source; None if there are none, or not for `lifetime` seconds any more."""
        given = self._rows.pop(source, None)
        if given is None:
            return None
        try:
            row = msgspec.convert(given, _Row)
            keys = tuple(read_der(id_, der) for id_, der in row.keys)
        except (msgspec.ValidationError, ValueError) as error:
            log.warning("jwt_keys_unreadable", error=str(error))
            self._put(source, None)
            return None
        age = (self._now() - row.fetched) / _S
        # Keys of the future: the clock was wrong, then or now, and tells nothing of their age.
        return Recalled(keys, age) if 0 <= age < lifetime else None

    def keep(self, source: str, keys: tuple[PublicKey, ...]) -> None:
        """Store what was fetched now."""
        row = _Row(self._now(), tuple((key.id, der_of(key)) for key in keys))
        self._put(source, msgspec.to_builtins(row, builtin_types=(bytes,)))

    def _put(self, source: str, row: Any) -> None:
        if self._store is not None:
            self._store.put(source, row)
