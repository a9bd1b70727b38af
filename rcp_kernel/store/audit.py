"""The record: who did what, decided how, and what came of it; one chained row each.

A record is made and sealed on the event loop, in order; the store's thread writes it. What it
holds is bounded: a long value is told by its length and SHA-256.
"""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Callable, Generator, Iterable
from functools import partial
from typing import Any, Protocol

import msgspec

from rcp_kernel.clock import iso, now
from rcp_kernel.config.file import AuditConfig
from rcp_kernel.contract.identity import Principal
from rcp_kernel.contract.prepared import Prepared
from rcp_kernel.model import tenant_of
from rcp_kernel.store.chain import GENESIS, Head, link, written
from rcp_kernel.store.denial_throttle import DenialThrottle
from rcp_kernel.store.store import Store
from rcp_kernel.store.touches import EVERYTHING, bounded_touches
from rcp_kernel.values import Encoding, dump, parse
from rcp_kernel.wire import Request, encode_body

__all__ = ["FULL", "Acting", "Audit", "bounded", "decoded", "hashed", "hashing", "value_of"]

_PIECE = 262_144  # bytes that are hashed in one step
_VALUE = 4096  # bytes of a value that are written out
_TEXT = 500  # characters of a message
FULL = 5000  # records that may wait before commands and writes are refused, and refusals counted
_MOST = 20_000  # records that may wait for a store that cannot write; then they are only counted
_encode = msgspec.json.encode


class Acting(Protocol):
    """The session that something was done in."""

    @property
    def id(self) -> str:
        """Its id, of which a record has the beginning."""
        ...

    @property
    def tenant(self) -> str | None:
        """The tenant in which it acts."""
        ...

    @property
    def transport(self) -> str | None:
        """How its client is connected."""
        ...


class Audit:
    """Writes one record for each happening."""

    def __init__(self, store: Store, loop: asyncio.AbstractEventLoop, config: AuditConfig) -> None:
        self._store = store
        last = store.rows(1)
        self.head: Head = (last[0][0], last[0][1]) if last else (0, GENESIS)
        """The last record made; not necessarily committed yet."""
        self._flood = DenialThrottle(loop, config.denials, self._sum_up)
        self.on_record: list[Callable[[dict[str, Any]], object]] = []
        """Called with each record once it is committed."""

    def note(
        self,
        what: str,
        *,
        principal: Principal | None,
        tenant: str | None = None,
        path: str | None = None,
        touches: Iterable[str] | None = None,
        outcome: str = "ok",
        session: Acting | None = None,
        **facts: Any,
    ) -> bool:
        """Record a happening; returns at once. Facts that are None are left out.

        It belongs to its tenant and path. What is about several paths names them in `touches`, and
        is for those who may see all of them, in all of their tenants.

        Returns whether it has a record of its own: refusals past the bound are only counted.
        """
        acting = _tenant(principal, tenant, path, session)
        owners = () if acting is None else (acting,)
        if touches is not None:
            named = bounded_touches(touches)
            owners = _owners(acting, named)
            facts["touches"] = list(named)
        who = _who(principal, owners, session)
        waiting = self._store.waiting
        refusal = what == "denial"
        if refusal or waiting > _MOST:
            key = f"{facts.get('transport')}" if principal is None else f"={principal.name}"
            broken = refusal and self._store.trouble is not None
            full = broken or waiting > (FULL if refusal else _MOST)
            if not self._flood.passes(key, who, path, outcome, full=full):
                return False
        self._write(what, {**who, "path": path, **facts, "outcome": outcome})
        return True

    def _sum_up(self, facts: dict[str, Any]) -> None:
        self._write("denials", facts)

    def _write(self, what: str, facts: dict[str, Any]) -> None:
        seq = self.head[0] + 1
        record = {"seq": seq, "time": iso(now()), "what": what}
        for key, value in facts.items():
            if value is not None:
                record[key] = value[:_TEXT] if isinstance(value, str) else value
        try:
            data = _encode(record)
        except (TypeError, ValueError, OverflowError, RecursionError):
            data = _encode({**record, **{k: bounded(v) for k, v in facts.items()}})
        digest = link(self.head[1], data)
        self.head = (seq, digest)
        self._store.append((seq, digest, data))
        for told in self.on_record:
            self._store.settled(partial(told, msgspec.json.decode(data)))

    def past(self, last: int) -> list[dict[str, Any]]:
        """Return the last records of earlier runs. Blocks: for the start only."""
        found = [decoded(data) for _, _, data in self._store.rows(last)]
        return [record for record in found if record is not None]

    def start(self, **facts: Any) -> None:
        """Record that a gateway began, and the head that the one before it left behind."""
        left = self._store.left
        self.note("start", principal=None, head=left and written(left), **facts)

    def state(self, *, head: bool) -> dict[str, Any]:
        """Describe the record for `/system/status`; its head is not for everybody."""
        store = self._store
        trouble = store.trouble or (store.damage and f"store damaged: {store.damage}")
        state = {"state": "degraded" if trouble else "ok", "kept": store.keeps}
        facts = {"waiting": store.waiting or None, "detail": trouble}
        if head and store.head is not None:
            facts["head"] = written(store.head)
        return state | {key: value for key, value in facts.items() if value is not None}

    def close(self) -> None:
        """Sum up what was only counted."""
        self._flood.close()


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


def _owners(acting: str | None, touches: Iterable[str]) -> tuple[str, ...]:
    """Return the tenants whose a record is that is about several paths."""
    tenants = {acting, *(tenant_of(path) for path in touches if path != EVERYTHING)}
    return tuple(sorted(filter(None, tenants)))


def _who(
    principal: Principal | None, owners: tuple[str, ...], session: Acting | None
) -> dict[str, Any]:
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


def decoded(data: bytes) -> dict[str, Any] | None:
    """Return a record as it is stored; None if somebody made something else of it."""
    try:
        return msgspec.json.decode(data, type=dict[str, Any])
    except (msgspec.DecodeError, UnicodeDecodeError):
        return None


def bounded(value: Any) -> Any:
    """Return a value as it is told in a record: as JSON, or if long by its length and hash."""
    try:
        data = encode_body(value, Encoding.JSON)
    except Exception:  # whatever cannot be written must not keep the rest out of the record
        return {"unwritable": type(value).__name__}
    return _told(data, data)


def value_of(request: Request) -> Any:
    """Return a request's body as it is told in a record; None if there is none."""
    body = bytes(request.body)
    if not body:
        return None
    if isinstance(request, Prepared):
        return request.told
    if len(body) > _VALUE:
        return hashed(body)
    try:
        return _told(dump(parse(body, request.encoding), Encoding.JSON), body)
    except Exception:  # a body that is no text of its encoding is told by its hash
        return hashed(body)


def _told(data: bytes, sent: bytes) -> Any:
    return msgspec.Raw(data) if len(data) <= _VALUE else hashed(sent)


def hashed(data: bytes) -> dict[str, Any]:
    """Return what tells of bytes without holding them: their length and hash."""
    return {"length": len(data), "sha256": hashlib.sha256(data).hexdigest()}


def hashing(data: bytes) -> Generator[None, None, dict[str, Any]]:
    """Do as `hashed` does, in steps."""
    digest, whole = hashlib.sha256(), memoryview(data)
    for start in range(0, len(data), _PIECE):
        digest.update(whole[start : start + _PIECE])
        yield
    return {"length": len(data), "sha256": digest.hexdigest()}
