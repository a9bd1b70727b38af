"""Records: who acted, what was requested, what came of it; sealed, and published when they are stored.

Records are bounded: a long value is replaced by its length and SHA-256.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import lru_cache, partial
from math import isfinite
from typing import Any

import msgspec

from rcp_audit.throttle import DenialThrottle
from rcp_kernel.contract.digest import LONGEST, bounded, hashed
from rcp_kernel.contract.events import ActingSession, Event
from rcp_kernel.contract.identity import Principal
from rcp_kernel.contract.paths import EVERYTHING, bounded_touches
from rcp_kernel.contract.requests import PreparedRequest
from rcp_kernel.features import FeatureHost
from rcp_kernel.features.approval import ID
from rcp_kernel.model import tenant_of
from rcp_kernel.sessions.command import Command, Record
from rcp_kernel.values import Encoding, parse
from rcp_kernel.wire import FINAL, NO_BODY, Request

__all__ = ["ACTS", "FULL", "PATH", "Records", "describe", "who_did"]

PATH = "/system/audit"
FULL = 5000
"""Pending records above which commands and writes are refused, and refusals only counted."""
ACTS = frozenset(("write", "execute"))
_MOST = 20_000  # pending records above which events are only counted
_TEXT = 500  # characters of a message
_KNOWN = 1024  # cached principals
_SESSIONS = 1024  # of which, and of whose paths, the first fields are cached
_Known = tuple[Principal | None, str | None, dict[str, Any]]
_NAME = 500  # characters of a name
_OWN_WORDS = ("estop",)
"""Events described by their own facts, not by the value of their request."""


class _Sealed(msgspec.Struct, frozen=True, gc=False):
    """A sealed record, decoded on demand: a `Native` value."""

    data: bytes

    def decode(self) -> dict[str, Any]:
        """Return the record."""
        return msgspec.json.decode(self.data)


class Records:
    """Makes records of events and commands, and adds them to the ledger."""

    def __init__(self, host: FeatureHost, denials: int) -> None:
        """`denials`: refusals a second of one principal that have records of their own."""
        self._publish: Callable[[Any], object] = partial(host.publish, PATH)
        self._ledger = host.ledger
        self._store = host.ledger.store
        self._known: dict[tuple[str | None, str | None, str], _Known] = {}
        self.throttle = DenialThrottle(host.loop, denials, partial(self.write, "denials"))

    def begin(self, host: FeatureHost) -> None:
        """Find the resource that records are published at, now that the gateway has its tree."""
        entry = host.robots.entries.get(PATH)
        if entry is not None:
            self._publish = partial(entry.publish, timestamp=None)

    def note(self, what: str, event: Event, **more: Any) -> bool:
        """Record an event, unless it is only counted; return whether it is recorded."""
        touches = None if event.touches is None else bounded_touches(event.touches)
        who = self._who(event.principal, event.session, event.tenant, event.path, touches)
        # A flood of refusals gets one common record.
        if what == "denial" or self._store.waiting > _MOST:
            transport = event.facts.get("transport")
            if not self._passes(what, event.principal, transport, who, event.path, event.outcome):
                return False
        facts = who
        if event.path is not None:
            facts["path"] = event.path[:_TEXT]
        if more:
            facts |= more
        if event.request is not None:
            describe(facts, event.request, event.what, hide=event.hide)
        for key, value in event.facts.items():
            if value is not None:
                facts[key] = value[:_TEXT] if isinstance(value, str) and key != "value" else value
        value = facts.get("value")
        if value is not None and type(value) is not msgspec.Raw:
            facts["value"] = bounded(value)
        if touches is not None:
            facts["touches"] = list(touches)
        facts["outcome"] = event.outcome
        self.write(what, facts)
        return True

    def follow(self, command: Command, step: Record) -> None:
        """Record that a command was accepted, and its outcome with the robot's message.

        Nearly all records are of commands: no `Event` is made for them.
        """
        accepted, error = step.status == "accepted", step.error
        if not accepted and step.status not in FINAL:
            return
        requester, work, path = command.requester, command.work, command.path
        own = path.startswith("/system/")
        outline = None
        if work is not None:
            outline = work.outline(work.report(over=False) if accepted else step.body)
        several = outline is not None if accepted else own
        touches = bounded_touches(command.touches) if several else None
        principal = None if requester is None else requester.principal
        facts = self._who(principal, requester, command.tenant, path, touches)
        what = "execute" if accepted else "command"
        outcome = "accepted" if accepted else "ok" if error is None else error["code"]
        if self._store.waiting > _MOST and not self._passes(
            what, principal, None, facts, path, outcome
        ):
            return
        facts["path"] = path[:_TEXT]
        if accepted:
            if command.request is not None:
                describe(facts, command.request, what, hide=outline is not None)
            facts["command"] = command.id
        else:
            _conclude(facts, command, step, own=own)
        if outline is not None:
            facts |= {name: bounded(fact) for name, fact in outline.items()}
        if touches is not None:
            facts["touches"] = list(touches)
        facts["outcome"] = outcome
        self.write(what, facts)

    def _who(
        self,
        principal: Principal | None,
        session: ActingSession | None,
        tenant: str | None,
        path: str | None,
        touches: Iterable[str] | None,
    ) -> dict[str, Any]:
        """Return what `who_did` does, which is the same for all records of a session at one path."""
        if session is None or touches is not None or (path is not None and len(path) > _TEXT):
            return who_did(principal, session, tenant, path, touches)
        key = (path, tenant, session.id)
        known = self._known.get(key)
        # A `hello` gives a session another principal, and perhaps another tenant.
        if known is None or known[0] is not principal or known[1] != session.tenant:
            if len(self._known) >= _SESSIONS:
                self._known.clear()
            who = who_did(principal, session, tenant, path, None)
            known = self._known[key] = principal, session.tenant, who
        return {**known[2]}

    def _passes(
        self,
        what: str,
        principal: Principal | None,
        transport: Any,
        who: dict[str, Any],
        path: str | None,
        outcome: str,
    ) -> bool:
        """Return whether a refusal, or an event beyond the limit, gets its own record."""
        ledger, refusal = self._ledger, what == "denial"
        waiting = ledger.waiting
        key = f"{transport}" if principal is None else f"={principal.name}"
        broken = refusal and ledger.trouble is not None
        full = broken or waiting > (FULL if refusal else _MOST)
        return self.throttle.passes(key, dict(who), path, outcome, full=full)

    def write(self, what: str, facts: dict[str, Any]) -> None:
        """Seal a record; it is published when it is stored."""
        try:
            data = self._ledger.add(what, facts)
        except (TypeError, ValueError, OverflowError, RecursionError):
            data = self._ledger.add(what, {k: v and bounded(v) for k, v in facts.items()})
        if self._store.keeps:
            self._ledger.settled(partial(self._publish, _Sealed(data)))
        else:
            self._publish(_Sealed(data))


def describe(facts: dict[str, Any], request: Request, what: str, *, hide: bool) -> None:
    """Add the fields that describe a request; without those that it does not have."""
    facts["request"] = request.type
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


def _conclude(facts: dict[str, Any], command: Command, last: Record, *, own: bool) -> None:
    """Add the fields of a command's outcome."""
    error, body = last.error, last.body
    if command.requester is None:
        facts["by"] = command.principal[:_TEXT]
    facts["status"] = last.status
    if last.message is not None:
        facts["message"] = last.message[:_TEXT]
    facts["command"] = command.id
    if command.request_id is not None:
        facts["id"] = command.request_id[:_TEXT]
    if error is not None and (origin := error.get("origin")) is not None:
        facts["origin"] = origin[:_TEXT]
    if not own and body is not NO_BODY:
        plain = type(body) is float and isfinite(body)
        facts["value"] = body if plain else bounded(body)
    if command.custom:
        facts["x"] = bounded(command.custom)


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
        value = msgspec.json.decode(body) if json else parse(body, request.encoding)
        if type(value) is float and isfinite(value):
            return value
        value = bounded(value)
    except Exception:  # a body that cannot be decoded is replaced by its hash
        return hashed(body)
    return value if isinstance(value, msgspec.Raw) else hashed(body)


def who_did(
    principal: Principal | None,
    session: ActingSession | None,
    tenant: str | None,
    path: str | None,
    touches: Iterable[str] | None,
) -> dict[str, Any]:
    """Return the principal, tenants and session of an event; its tenants include those in `touches`."""
    acting = tenant or (tenant_of(path) if path is not None and path[:1] == "/" else None)
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
