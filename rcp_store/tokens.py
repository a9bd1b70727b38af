"""API keys created and revoked at run time: a table of hashes in the store.

`rcpd token` writes the table from its own process; the feature `tokens` watches it for changes.
"""

from __future__ import annotations

import hashlib
import os
import secrets
import sqlite3
from contextlib import suppress
from pathlib import Path

import msgspec

from rcp_protocol.clock import now
from rcp_protocol.errors import ConfigError
from rcp_store.modes import check_store_modes

__all__ = ["PREFIX", "Token", "TokenFile", "make_table"]

PREFIX = "rcp_"
"""Prefix of every key created here, for scanners that search for leaked keys."""
_SCHEMA = """
CREATE TABLE IF NOT EXISTS tokens (
    id TEXT PRIMARY KEY, name TEXT NOT NULL, hash TEXT NOT NULL UNIQUE, grants BLOB NOT NULL,
    created INTEGER NOT NULL, expires INTEGER, revoked INTEGER, changed INTEGER NOT NULL
);
CREATE INDEX IF NOT EXISTS tokens_changed ON tokens (changed);
"""
Grants = tuple[tuple[str, tuple[str, ...]], ...]
"""Roles by tenant, in order; `*` is every tenant."""
_NEXT = "(SELECT coalesce(max(changed), 0) + 1 FROM tokens)"
_BUSY = 5.0  # s to wait for another process
_FORGET = 90 * 86_400 * 1_000_000_000  # ns after which revoked keys are deleted


class Token(msgspec.Struct, frozen=True):
    """One key, without the key."""

    id: str
    name: str
    hash: str
    grants: Grants
    created: int
    expires: int | None
    revoked: int | None

    def state(self, moment: int) -> str:
        """Return `good`, `expired` or `revoked`."""
        if self.revoked is not None:
            return "revoked"
        return "expired" if self.expires is not None and self.expires <= moment else "good"


def make_table(base: sqlite3.Connection) -> None:
    """Create the table of keys in a database.

    :raises sqlite3.Error: it cannot be created.
    """
    base.executescript(_SCHEMA)


class TokenFile:
    """The table, for one thread. Blocks."""

    def __init__(self, path: Path, *, there: bool = False) -> None:
        """Open or create it; with `there`, only open it: the store has been there, and may be lost.

        :raises ConfigError: that cannot be done, or others may write it.
        """
        self.warning = check_store_modes(path)
        """A warning for the operator if others can read the file."""
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            if not there:
                with suppress(FileExistsError):  # readable only by the owner
                    os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
            place = f"{path.absolute().as_uri()}?mode=rw"
            self._base = sqlite3.connect(place, timeout=_BUSY, uri=True)
            self._base.execute("PRAGMA journal_mode=WAL")
            make_table(self._base)
        except (OSError, sqlite3.Error) as error:
            raise ConfigError(f"the store '{path}' cannot be opened: {error}") from None

    def close(self) -> None:
        """Close the database."""
        self._base.close()

    def create(self, name: str, grants: Grants, expires: int | None) -> tuple[Token, str]:
        """Create a key; return its stored form, and the key itself, which is not stored."""
        key = PREFIX + secrets.token_urlsafe(32)
        id_ = "t-" + secrets.token_hex(4)
        digest = hashlib.sha256(key.encode()).hexdigest()  # as `sha256` in `[[keys]]`
        token = Token(id_, name, digest, grants, now(), expires, None)
        with self._base:
            # First: the number must grow, whatever is deleted, or a gateway sees no change.
            self._base.execute(
                f"INSERT INTO tokens VALUES (?, ?, ?, ?, ?, ?, NULL, {_NEXT})",  # noqa: S608 - a constant
                (id_, name, token.hash, msgspec.msgpack.encode(grants), token.created, expires),
            )
            # Not those that have expired: by a clock that is ahead, all seem to have.
            self._base.execute("DELETE FROM tokens WHERE revoked < ?", (token.created - _FORGET,))
        return token, key

    def revoke(self, named: str) -> list[Token]:
        """Revoke a key by id, or all keys of a name; return those that were still valid."""
        gone = [t for t in self.every() if t.revoked is None and named in (t.id, t.name)]
        with self._base:
            self._base.executemany(
                f"UPDATE tokens SET revoked = ?, changed = {_NEXT} WHERE id = ?",  # noqa: S608 - a constant
                [(now(), token.id) for token in gone],
            )
        return gone

    def every(self) -> list[Token]:
        """List all keys, oldest first."""
        rows = self._base.execute(
            "SELECT id, name, hash, grants, created, expires, revoked FROM tokens ORDER BY created"
        )
        return [
            Token(id_, name, hash_, msgspec.msgpack.decode(grants, type=Grants), *times)
            for id_, name, hash_, grants, *times in rows
        ]

    def version(self) -> int:
        """Return a number that grows with every change."""
        return self._base.execute("SELECT coalesce(max(changed), 0) FROM tokens").fetchone()[0]
