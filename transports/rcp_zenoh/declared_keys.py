"""The keys that a session has declared, each of them once.

Zenoh numbers them with 16 bits and does not use the number of an undeclared key again: after 65,535
declarations, messages on earlier keys go astray without a word. A publisher of a key that was not
declared declares it.
"""

from __future__ import annotations

import zenoh

__all__ = ["DeclaredKeys"]

_MOST = 32_768


class DeclaredKeys:
    """Declares keys when they are first used, and keeps them as long as the session."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._keys: dict[str, zenoh.KeyExpr] = {}

    def has_room(self, key: str) -> bool:
        """Return whether a key can be declared, or is already; if not, only a new session helps."""
        return key in self._keys or len(self._keys) < _MOST

    def of(self, key: str) -> zenoh.KeyExpr:
        """Return a key, declared."""
        if key not in self._keys:
            self._keys[key] = self._session.declare_keyexpr(key)
        return self._keys[key]
