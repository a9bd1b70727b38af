"""A thread that looks for changes of the keys in the store."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Callable, Iterable
from contextlib import closing
from pathlib import Path

import msgspec
import structlog

from rcp_kernel.errors import ConfigError
from rcp_store.tokens import Token, TokenFile

__all__ = ["TokenWatch", "changes"]

log = structlog.get_logger("rcp.tokens")
_PERIOD = 0.5  # s between looks


class TokenWatch:
    """Tells of the keys that are there: once when made, then whenever they change."""

    def __init__(self, path: Path, on_change: Callable[[list[Token]], None]) -> None:
        """Read the table, then watch it on a thread, which calls `on_change`.

        :raises ConfigError: the store cannot be opened.
        """
        self._path = path
        self._on_change = on_change
        self._closing = threading.Event()
        with closing(TokenFile(path)) as table:
            self._version = table.version()
            self.tokens = table.every()
            """As they were when the watch began."""
        self._thread = threading.Thread(target=self._watch, name="rcp-tokens", daemon=True)

    def start(self) -> None:
        """Begin to watch."""
        self._thread.start()

    def close(self) -> None:
        """Stop."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join(timeout=10)

    def _watch(self) -> None:
        table: TokenFile | None = None
        broken = False
        while not self._closing.wait(_PERIOD):
            try:
                table = table or TokenFile(self._path, there=True)
                version = table.version()
                if version != self._version:
                    self._on_change(table.every())
                    self._version = version
                broken = False
            except (ConfigError, sqlite3.Error, msgspec.DecodeError) as error:
                if not broken:  # keep the last known keys
                    log.error("tokens_unreadable", path=str(self._path), error=str(error))
                broken = True
                if table is not None:
                    table.close()
                    table = None
        if table is not None:
            table.close()


def changes(before: Iterable[Token], after: Iterable[Token]) -> list[tuple[str, Token]]:
    """Tell which keys were `created` or `revoked` between two looks."""
    known = {token.id: token.revoked for token in before}
    found: list[tuple[str, Token]] = []
    for token in after:
        if token.id not in known:
            found.append(("created", token))
        if token.revoked is not None and known.get(token.id, token.revoked) is None:
            found.append(("revoked", token))
    return found
