"""The record: who did what, decided how, and what came of it."""

from __future__ import annotations

from typing import Any

from rcp_kernel.identity import Principal
from rcp_kernel.sessions import Session
from rcp_kernel.store import Store

__all__ = ["Audit"]


class Audit:
    """Writes one record for each happening."""

    def __init__(self, store: Store) -> None:
        self._store = store

    def note(
        self,
        what: str,
        *,
        principal: Principal | None,
        tenant: str | None = None,
        path: str | None = None,
        outcome: str = "ok",
        session: Session | None = None,
        **facts: Any,
    ) -> None:
        """Record a happening; returns at once."""
