"""What goes on record by itself, and why nobody is told of it before it is there.

A reply to a write, a command or a refusal leaves when its record is committed. The robot never
waits for that; a store that writes adds a moment, one that cannot holds a reply back until its
request's deadline and then says so.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.identity import Principal
from rcp_kernel.contract.peer import Peer
from rcp_kernel.errors import DeadlineExceeded, QueueFull, RcpError
from rcp_kernel.model import tenant_of
from rcp_kernel.safety.safety import safe_value
from rcp_kernel.sessions.session import Answer, Session
from rcp_kernel.store.audit import FULL, Audit, bounded, hashed, value_of
from rcp_kernel.store.store import Store
from rcp_kernel.tree.entry import Entry
from rcp_kernel.wire import NO_BODY, Reply, Request, failure

if TYPE_CHECKING:
    from rcp_kernel.requests.commands import CommandObserver
    from rcp_kernel.safety.estop import EstopRequest
    from rcp_kernel.sessions.command import Command
    from rcp_kernel.tree.entry import StopGroup

__all__ = ["ACTS", "DENIALS", "AuditWriter"]

ACTS = frozenset(("write", "execute"))
DENIALS = frozenset(
    (
        "unauthenticated",
        "token_expired",
        "forbidden",
        "unknown_path",  # what is hidden answers like what is not there
        "approval_required",
        "lease_required",
        "lease_held",
        "lease_lost",
        "estop_active",
        "mode_forbids",
        "precondition_failed",
        "stale_command",
        "out_of_range",
        "rate_limited",
    )
)
"""Codes that go on record whatever the request was; a write or an execute does with any code."""
ID = "a-"  # what the ids of approvals begin with; a pass for many commands is nobody's business
_LOOK = 0.25  # s between looks for replies whose deadline passes
_LONGEST = 5.0  # s that a reply is held back at most
_ESTOP = 0.25  # s for that of an e-stop, which is told in any case


class _Held:
    """A reply that waits for its record."""

    __slots__ = ("answer", "anyway", "reply", "until")

    def __init__(self, reply: Reply, answer: Answer, until: float, *, anyway: bool) -> None:
        self.reply: Reply | None = reply
        self.answer = answer
        self.until = until
        self.anyway = anyway

    def release(self) -> None:
        reply, self.reply = self.reply, None
        if reply is not None:
            self.answer(reply)

    def give_up(self) -> None:
        """Answer without a record, and say so; what is not final is left out."""
        reply = self.reply
        if reply is None:
            return
        if self.anyway:
            reply.message = f"{reply.message or ''} The audit record is not written yet.".lstrip()
            self.release()
            return
        self.reply = None
        if reply.final:
            said = _unrecorded(reply)
            said.custom = reply.custom
            self.answer(said)


class AuditWriter:
    """Makes the records of requests, and holds replies back until these are committed."""

    def __init__(
        self, audit: Audit, store: Store, settings: Settings, loop: asyncio.AbstractEventLoop
    ) -> None:
        self._audit = audit
        self._store = store
        self._settings = settings
        self._loop = loop
        self._held: deque[_Held] = deque()
        self._watching = False

    def check(self) -> None:
        """Refuse what would have to go on record while that cannot be written.

        :raises QueueFull: the store has trouble, or too many records wait.
        """
        store = self._store
        if store.trouble is not None or store.waiting > FULL:
            raise QueueFull(
                f"cannot write the audit log ({store.trouble or 'the disk is slow'}); commands "
                "and writes are refused until this works again",
                remedy="Ask the operator to free disk space for `[store] path`, or to unlock "
                "the file.",
                retry_after=1.0,
            )

    # -- records -------------------------------------------------------------------------------

    def refused(
        self, session: Session, request: Request, reply: Reply, answer: Answer, *, hide: bool
    ) -> Answer:
        """Record a refusal; return what its reply goes to.

        `hide` leaves of the value its hash: it belongs to other paths than the request's.
        """
        error = reply.error or {}
        noted = self._audit.note(
            "denial",
            principal=session.principal,
            session=session,
            path=reply.path,
            outcome=error.get("code", "internal"),
            message=reply.message,
            **_facts(request, hide=hide),
        )
        return self.held(answer, request) if noted else answer

    def unwelcome(self, session: Session, reply: Reply, answer: Answer) -> Answer:
        """Record that a `hello` was refused (never what it said); return what its reply goes to."""
        error = reply.error or {}
        if error.get("code") not in DENIALS:
            return answer
        noted = self._audit.note(
            "denial",
            principal=session.principal,
            session=session,
            outcome=error["code"],
            message=reply.message,
            request="hello",
        )
        return self._until(answer, self._settings.limits.deadline) if noted else answer

    def stranger(
        self, transport: str, peer: Peer, error: RcpError, principal: Principal | None = None
    ) -> None:
        """Record that somebody proved nothing, or wanted in where they do not act."""
        self._audit.note(
            "denial",
            principal=principal,
            transport=transport,
            address=peer.address,
            outcome=error.code,
            message=error.message,
        )

    def written(self, session: Session, request: Request, entry: Entry, answer: Answer) -> Answer:
        """Return what records the outcome of a write, then passes it on."""
        held = self.held(answer, request, entry)

        def done(reply: Reply) -> None:
            error = reply.error
            code = "ok" if error is None else error["code"]
            self._audit.note(
                "denial" if code in DENIALS else "write",
                principal=session.principal,
                session=session,
                tenant=entry.tenant,
                path=entry.path,
                outcome=code,
                message=reply.message,
                **_facts(request),
            )
            held(reply)

        return done

    def dead_man(self, entry: Entry, outcome: str) -> None:
        """Record that a command lapsed, or that the robot took the safe value."""
        self._audit.note(
            "deadman",
            principal=None,
            tenant=entry.tenant,
            path=entry.path,
            outcome=outcome,
            value=None if outcome == "lapsed" else bounded(safe_value(entry)),
        )

    def stop_step(self, unit: StopGroup, step: str, detail: str | None) -> None:
        """Record that a robot under an e-stop was confirmed at rest, or that it moves again."""
        self._audit.note(
            "stop",
            principal=None,
            tenant=unit.tenant,
            path="/system/estop",
            robot=unit.name,
            outcome=step,
            message=detail,
        )

    def recovered(self, unit: StopGroup, command: str, done: str) -> None:
        """Record what was done with a robot whose command had been lost with its link."""
        self._audit.note(
            "recovery",
            principal=None,
            tenant=unit.tenant,
            path=command,
            robot=unit.name,
            message=done,
        )

    def started(self, session: Session, request: Request, command: Command) -> None:
        """Record that a command was accepted."""
        work = command.work
        outline = None if work is None else work.outline(work.report(over=False))
        self._audit.note(
            "execute",
            principal=session.principal,
            session=session,
            tenant=command.tenant,
            path=command.path,
            outcome="accepted",
            command=command.id,
            touches=None if outline is None else command.touches,
            **_bounded(outline),
            **_facts(request, hide=outline is not None),
        )

    def estop(
        self,
        session: Session,
        request: Request,
        asked: EstopRequest,
        keys: dict[str, str | None],
        robots: list[StopGroup],
    ) -> None:
        """Record an e-stop or its reset: in each tenant what is latched there, and its robots."""
        facts = _facts(request)
        facts["value"] = None  # it is told in words of its own
        tenants = dict.fromkeys([*keys.values(), *(robot.tenant for robot in robots)])
        for tenant in tenants:
            self._audit.note(
                "estop",
                principal=session.principal,
                tenant=tenant,
                path="/system/estop",
                session=session,
                reset=asked.reset,
                scope=asked.scope,
                latches=sorted(key for key, of in keys.items() if of in (None, tenant)),
                robots=[robot.name for robot in robots if robot.tenant == tenant],
                reason=asked.reason,
                **facts,
            )

    def looked(
        self, session: Session, request: Request, path: str, told: Any, touches: list[str]
    ) -> None:
        """Record what was read for a session; of what shows each reader its own, not the value."""
        facts = _facts(request)
        if "*" not in path and not path.startswith("/system/"):
            facts["value"] = told
        self._audit.note(
            "read",
            principal=session.principal,
            session=session,
            tenant=tenant_of(path),
            path=path,
            touches=touches,
            **facts,
        )

    def ended(self, command: Command) -> None:
        """Record what became of a command, and what the robot said."""
        last, asker = command.history[-1], command.asker
        error, work = last.error, command.work
        outline = None if work is None else work.outline(last.body)
        self._audit.note(
            "command",
            principal=None if asker is None else asker.principal,
            session=asker,
            tenant=command.tenant,
            path=command.path,
            outcome="ok" if error is None else error["code"],
            by=command.principal if asker is None else None,
            status=last.status,
            message=last.message,
            command=command.id,
            id=command.request_id,
            origin=None if error is None else error.get("origin"),
            value=None if command.is_system or last.body is NO_BODY else bounded(last.body),
            touches=command.touches if command.is_system else None,
            **_bounded(outline),
            x=bounded(command.custom) if command.custom else None,
        )

    async def committed(self) -> None:
        """Wait until all that was put so far is committed."""
        store = self._store
        if not store.idle:
            done = self._loop.create_future()
            store.settled(lambda: done.done() or done.set_result(None))
            await done

    # -- replies -------------------------------------------------------------------------------

    def held(self, answer: Answer, request: Request, entry: Entry | None = None) -> Answer:
        """Return what holds replies back until all records made so far are committed."""
        limit = request.deadline or self._settings.limits.deadline
        if entry is not None:
            limit = min(limit, entry.resource.timeout or limit)
        return self._until(answer, limit)

    def follower(self, answer: Answer) -> Answer:
        """Return what holds the replies back that a further follower of a command gets."""
        return self._until(answer, self._settings.limits.deadline)

    def _until(self, answer: Answer, limit: float) -> Answer:
        if not self._store.keeps:
            return answer
        until = self._loop.time() + limit
        return lambda reply: self._hold(reply, answer, until)

    def hold_estop(self, answer: Answer) -> Answer:
        """Return what holds an e-stop's reply back for a moment; it is told in any case."""
        if not self._store.keeps:
            return answer
        return lambda reply: self._hold(reply, answer, self._loop.time() + _ESTOP, anyway=True)

    def _hold(self, reply: Reply, answer: Answer, until: float, *, anyway: bool = False) -> None:
        if self._store.idle:
            answer(reply)
            return
        moment = self._loop.time()
        until = min(max(until, moment + _LOOK), moment + _LONGEST)
        held = _Held(reply, answer, until, anyway=anyway)
        self._held.append(held)
        self._store.settled(held.release)
        if not self._watching:
            self._watching = True
            self._loop.call_later(_LOOK, self._look)

    def _look(self) -> None:
        moment = self._loop.time() + _LOOK
        kept = [held for held in self._held if held.reply is not None]
        for held in kept:
            if held.until < moment:
                held.give_up()
        self._held = deque(held for held in kept if held.reply is not None)
        self._watching = bool(self._held)
        if self._watching:
            self._loop.call_later(_LOOK, self._look)


class Recorded:
    """A keeper of commands whose end goes on record."""

    def __init__(self, recording: AuditWriter, keeper: CommandObserver) -> None:
        self._recording = recording
        self._keeper = keeper

    def save(self, command: Command) -> None:
        """Note the command's present state, and its end on record."""
        self._keeper.save(command)
        if command.final:
            self._recording.ended(command)

    def forget(self, command: Command) -> None:
        """Let go of a command that is not remembered any more."""
        self._keeper.forget(command)


def _bounded(outline: Mapping[str, Any] | None) -> dict[str, Any]:
    return {} if outline is None else {name: bounded(fact) for name, fact in outline.items()}


def _facts(request: Request, *, hide: bool = False) -> dict[str, Any]:
    acts, approval = request.type in ACTS, request.approval
    return {
        "request": request.type,
        "id": request.id,
        "idempotency_key": request.idempotency_key,
        "dry_run": request.dry_run or None,
        "approval": approval if approval and approval.startswith(ID) else None,
        "value": _value(request, hide=hide) if acts else None,
        "x": bounded(request.custom) if request.custom else None,
    }


def _value(request: Request, *, hide: bool) -> Any:
    return hashed(bytes(request.body)) if hide else value_of(request)


def _unrecorded(reply: Reply) -> Reply:
    error = reply.error
    outcome = reply.status if error is None else error["code"]
    told: RcpError = DeadlineExceeded(
        "its audit record could not be written in time, so it cannot be confirmed",
        remedy="Check the state of the robot and /system/status before you send it again.",
        details={"outcome": outcome},
    )
    return failure(told, reply.type, reply.id, reply.path, command=reply.command)
