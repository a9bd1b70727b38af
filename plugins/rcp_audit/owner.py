"""The owners of a record: its tenants, and the principal who acted."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any

from rcp_kernel.contract.events import Event
from rcp_kernel.contract.identity import Principal
from rcp_kernel.contract.touches import EVERYTHING
from rcp_kernel.model import tenant_of

__all__ = ["who_did"]

_KNOWN = 1024  # cached principals
_NAME = 500  # characters of a name


def who_did(event: Event, touches: Iterable[str] | None) -> dict[str, Any]:
    """Return the principal, tenants and session of an event; its tenants include those in `touches`."""
    path, session, principal = event.path, event.session, event.principal
    acting = event.tenant or (tenant_of(path) if path is not None and path[:1] == "/" else None)
    if principal is not None:
        acting = _tenant(principal, acting, None if session is None else session.tenant)
    if touches is None:
        owners = () if acting is None else (acting,)
    else:
        tenants = {acting, *(tenant_of(path) for path in touches if path != EVERYTHING)}
        owners = tuple(sorted(filter(None, tenants)))
    facts = {} if principal is None else {**_person(principal, owners)}
    if len(owners) == 1:
        facts["tenant"] = owners[0]
    elif owners:
        facts["tenants"] = list(owners)
    if session is not None:
        facts["session"], facts["transport"] = session.id[:8], session.transport
    return facts


@lru_cache(_KNOWN)
def _tenant(principal: Principal, acting: str | None, own: str | None) -> str | None:
    """Return the tenant that owns a record: never one in which the principal has no role."""
    tenants = principal.tenants
    if "*" in tenants or acting in tenants:
        return acting
    return own or (tenants[0] if len(tenants) == 1 else None)


@lru_cache(_KNOWN)
def _person(principal: Principal, owners: tuple[str, ...]) -> dict[str, Any]:
    roles = [r for t, held in principal.grants if t in ("*", *owners) for r in held]
    who = {"principal": principal.name[:_NAME], "roles": roles, "proof": principal.proof}
    return who if principal.via is None else {**who, "via": principal.via}
