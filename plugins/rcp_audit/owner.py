"""Whose a record is: the tenants that it belongs to, and who did what it tells."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rcp_kernel.contract.events import Acting, Event
from rcp_kernel.contract.identity import Principal
from rcp_kernel.model import tenant_of
from rcp_kernel.store.touches import EVERYTHING

__all__ = ["owners_of", "who_did"]


def owners_of(event: Event, touches: Iterable[str] | None) -> tuple[str, ...]:
    """Return the tenants of an event: with `touches`, those of all that it is about."""
    acting = _tenant(event.principal, event.tenant, event.path, event.session)
    if touches is None:
        return () if acting is None else (acting,)
    tenants = {acting, *(tenant_of(path) for path in touches if path != EVERYTHING)}
    return tuple(sorted(filter(None, tenants)))


def _tenant(
    principal: Principal | None, tenant: str | None, path: str | None, session: Acting | None
) -> str | None:
    """Return whose record it is: never that of a tenant in which the principal does not act."""
    acting = tenant or (tenant_of(path) if path is not None and path[:1] == "/" else None)
    if principal is None or "*" in principal.tenants:
        return acting
    if acting in principal.tenants:
        return acting
    own = session.tenant if session is not None else None
    return own or (principal.tenants[0] if len(principal.tenants) == 1 else None)


def who_did(event: Event, owners: tuple[str, ...]) -> dict[str, Any]:
    """Return who did it, in which tenants and session."""
    principal, session = event.principal, event.session
    facts: dict[str, Any] = {}
    if principal is not None:
        roles = [r for t, held in principal.grants if t in ("*", *owners) for r in held]
        facts |= {"principal": principal.name, "roles": roles, "proof": principal.proof}
    if len(owners) == 1:
        facts["tenant"] = owners[0]
    elif owners:
        facts["tenants"] = list(owners)
    if session is not None:
        facts |= {"session": session.id[:8], "transport": session.transport}
    return facts
