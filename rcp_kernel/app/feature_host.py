"""What each feature receives of the gateway."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from typing import Any

from rcp_kernel.access.acl import Rights
from rcp_kernel.access.visibility import Visibility
from rcp_kernel.contract.identity import Principal
from rcp_kernel.contract.turns import Turns, Work
from rcp_kernel.features.resource import ViewChanges
from rcp_kernel.features.robots import Robots
from rcp_kernel.sessions.session import Session
from rcp_kernel.store.audit import Audit
from rcp_kernel.store.plugin_store import PluginStore
from rcp_kernel.store.store import Store
from rcp_kernel.wire import Request

__all__ = ["GatewayFeatureHost", "Notices"]


class Notices:
    """Passes on notices for clients."""

    def __init__(self) -> None:
        self.on_notice: list[Callable[..., None]] = []
        """Called with the holder of the session (`Session.holder`), the code and the facts by name."""

    def tell(self, session: Session, code: str, facts: dict[str, Any]) -> None:
        """Pass one on."""
        for told in self.on_notice:
            told(session.holder, code, **facts)


class GatewayFeatureHost:
    """The `FeatureHost` of one feature."""

    def __init__(
        self,
        name: str,
        *,
        robots: Callable[[str], Robots],
        notices: Notices,
        turns: Turns,
        changes: ViewChanges,
        store: Store,
        audit: Audit,
        visibility: Visibility,
        place: Callable[[Session, Request], object],
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        self._name = name
        self.robots = robots(name)
        self._notices = notices
        self._turns = turns
        self._changes = changes
        self._store = store
        self._audit = audit
        self._visibility = visibility
        self._place = place
        self.loop = loop

    def in_steps(self, work: Work) -> None:
        """Do work in the turns of the event loop that have time for it."""
        self._turns.oblige(f"feature {self._name}", work)

    def tell(self, session: Session, code: str, **facts: Any) -> None:
        """Send a notice to whoever acts for a session."""
        self._notices.tell(session, code, facts)

    def changed(self, path: str) -> None:
        """Have the view's subscribers get it again."""
        self._changes.tell(path)

    def store(self, table: str) -> PluginStore:
        """Return a table that is named after the feature."""
        return PluginStore(self._store, f"{self._name}.{table}")

    def note(
        self,
        what: str,
        *,
        principal: Principal | None,
        session: Session | None = None,
        tenant: str | None = None,
        path: str | None = None,
        touches: Iterable[str] | None = None,
        outcome: str = "ok",
        **facts: Any,
    ) -> None:
        """Write a record to the audit log."""
        self._audit.note(
            what,
            principal=principal,
            session=session,
            tenant=tenant,
            path=path,
            touches=touches,
            outcome=outcome,
            **facts,
        )

    def sees_all(self, rights: Rights, paths: Iterable[str]) -> bool:
        """Tell whether somebody may see each of some paths."""
        return self._visibility.sees_all(rights, paths)

    def check_place(self, session: Session, request: Request) -> None:
        """Refuse a request that its session has no place for."""
        self._place(session, request)
