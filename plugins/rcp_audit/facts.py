"""The fields of records: who acted, what was requested, what came of it. All are bounded."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import Any

import msgspec

from rcp_kernel.contract.digest import LONGEST, bounded, hashed
from rcp_kernel.contract.events import Event
from rcp_kernel.contract.identity import Principal
from rcp_kernel.contract.paths import EVERYTHING
from rcp_kernel.contract.requests import PreparedRequest
from rcp_kernel.features.approval import ID
from rcp_kernel.model import tenant_of
from rcp_kernel.sessions.command import Command, Record
from rcp_kernel.values import Encoding, parse
from rcp_kernel.wire import NO_BODY, Request

__all__ = ["ACTS", "accepted", "ended", "requested", "who_did"]

ACTS = frozenset(("write", "execute"))
_KNOWN = 1024  # cached principals
_NAME = 500  # characters of a name
_OWN_WORDS = ("estop",)
"""Events described by their own facts, not by the value of their request."""


def requested(request: Request, what: str, *, hide: bool) -> dict[str, Any]:
    """Return the fields that describe a request; without those that it does not have."""
    facts: dict[str, Any] = {"request": request.type}
    if request.id is not None:
        facts["id"] = request.id
    if request.idempotency_key is not None:
        facts["idempotency_key"] = request.idempotency_key
    if request.dry_run:
        facts["dry_run"] = True
    # An approval id that covers many commands must stay secret.
    if request.approval and request.approval.startswith(ID):
        facts["approval"] = request.approval
    if request.type in ACTS and what not in _OWN_WORDS:
        value = _value(request, hide=hide)
        if value is not None:
            facts["value"] = value
    if request.custom:
        facts["x"] = bounded(request.custom)
    return facts


def accepted(command: Command) -> Event:
    """Return the event of a command that was accepted."""
    asker, work = command.asker, command.work
    outline = None if work is None else work.outline(work.report(over=False))
    return Event(
        what="execute",
        principal=None if asker is None else asker.principal,
        session=asker,
        request=command.request,
        hide=outline is not None,
        tenant=command.tenant,
        path=command.path,
        touches=None if outline is None else command.touches,
        outcome="accepted",
        facts={"command": command.id, **({} if outline is None else _bounded(outline))},
    )


def ended(command: Command, last: Record) -> Event:
    """Return the event of a command's outcome, with the robot's message."""
    asker, error, work = command.asker, last.error, command.work
    outline = None if work is None else work.outline(last.body)
    own = command.path.startswith("/system/")
    return Event(
        what="command",
        principal=None if asker is None else asker.principal,
        session=asker,
        tenant=command.tenant,
        path=command.path,
        touches=command.touches if own else None,
        outcome="ok" if error is None else error["code"],
        facts={
            "by": command.principal if asker is None else None,
            "status": last.status,
            "message": last.message,
            "command": command.id,
            "id": command.request_id,
            "origin": None if error is None else error.get("origin"),
            "value": None if own or last.body is NO_BODY else bounded(last.body),
            **({} if outline is None else _bounded(outline)),
            "x": bounded(command.custom) if command.custom else None,
        },
    )


def _bounded(outline: Mapping[str, Any]) -> dict[str, Any]:
    return {name: bounded(fact) for name, fact in outline.items()}


def _value(request: Request, *, hide: bool) -> Any:
    """Return the recorded form of a request's body; None if there is none."""
    body = bytes(request.body)
    if body and not hide and isinstance(request, PreparedRequest):
        return request.recorded
    if hide or len(body) > LONGEST:
        return hashed(body)
    if not body:
        return None
    try:
        json = request.encoding is Encoding.JSON
        value = bounded(msgspec.json.decode(body) if json else parse(body, request.encoding))
    except Exception:  # a body that cannot be decoded is replaced by its hash
        return hashed(body)
    return value if isinstance(value, msgspec.Raw) else hashed(body)


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
