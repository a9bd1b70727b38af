"""Keys that make a repeat harmless: what was sent before under a key is never run again."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from typing import Any

from rcp_kernel.errors import DuplicateRequest
from rcp_kernel.sessions import Session
from rcp_kernel.wire import Request

__all__ = ["Keys"]

_KEPT = 20_000


class Keys:
    """The first outcome of each key, by principal."""

    def __init__(self) -> None:
        self._known: OrderedDict[tuple[str, str], tuple[bytes, Any]] = OrderedDict()

    def find(self, session: Session, request: Request, path: str) -> Any:
        """Return the first outcome of the request's key, or None.

        :raises DuplicateRequest: the key was used for something else.
        """
        if request.idempotency_key is None:
            return None
        found = self._known.get((session.principal.name, request.idempotency_key))
        if found is None:
            return None
        if found[0] != _digest(request, path):
            raise DuplicateRequest("the idempotency key was used for another request", path=path)
        return found[1]

    def note(self, session: Session, request: Request, path: str, outcome: Any) -> None:
        """Remember the outcome of a request that has a key."""
        if request.idempotency_key is None:
            return
        key = (session.principal.name, request.idempotency_key)
        self._known[key] = (_digest(request, path), outcome)
        while len(self._known) > _KEPT:
            self._known.popitem(last=False)

    def forget(self, session: Session, request: Request) -> None:
        """Let the key go: the request was refused before it could have done anything."""
        if request.idempotency_key is not None:
            self._known.pop((session.principal.name, request.idempotency_key), None)


def _digest(request: Request, path: str) -> bytes:
    text = b"\0".join((request.type.encode(), path.encode(), bytes(request.body)))
    return hashlib.sha256(text).digest()
