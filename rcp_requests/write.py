"""`write`: checks the value, its age and the e-stop, sends the value, and arms the dead-man."""

from __future__ import annotations

from functools import partial
from time import perf_counter
from typing import Any

from rcp_kernel.clock import iso, now
from rcp_kernel.contract.fence import permit
from rcp_kernel.contract.internal_errors import attribute_error
from rcp_kernel.contract.requests import PreparedRequest
from rcp_kernel.errors import EstopActive, RcpError
from rcp_kernel.features import Call
from rcp_kernel.features.observer import CommandEvents
from rcp_kernel.model import Operation
from rcp_kernel.safety.deadman import REPLY_GRACE, Deadman
from rcp_kernel.safety.safe_value import safe_value
from rcp_kernel.sessions.long_value import LongValue
from rcp_kernel.sessions.session import Answer, Session
from rcp_kernel.spi import Backend
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Sample
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Body, Reply, Request
from rcp_protocol.structure import LONG
from rcp_requests.admission import Admission, Resolver
from rcp_requests.atomic_write import AtomicWriteHandler, DryRun
from rcp_requests.inflight import InFlight
from rcp_requests.keyed_write import KeyedWrites
from rcp_requests.outcomes import is_unchanged
from rcp_requests.replies import ReplyGate
from rcp_requests.request_events import RequestEvents
from rcp_scheduling.turns import Turns

__all__ = ["DryRun", "WriteHandler", "dry_run_reply"]


class WriteHandler:
    """The handler of `write`."""

    def __init__(
        self,
        resolver: Resolver,
        admission: Admission,
        inflight: InFlight,
        deadman: Deadman,
        *,
        events: CommandEvents,
        dry_run: DryRun,
        keyed: KeyedWrites,
        replies: ReplyGate,
        request_events: RequestEvents,
        turns: Turns,
        atomic: AtomicWriteHandler,
    ) -> None:
        self._resolver = resolver
        self._admission = admission
        self._inflight = inflight
        self._deadman = deadman
        self._events = events
        self._dry_run = dry_run
        self._keyed = keyed
        self._replies = replies
        self._request_events = request_events
        self._turns = turns
        self._atomic = atomic

    def write(self, session: Session, request: Request, answer: Answer) -> Reply | None:
        """Start a write; a repetition with the same idempotency key waits for the first outcome."""
        if request.path is None:
            return self._atomic.write(session, request, answer)
        entry = self._resolver.resolve(session, request.path, Operation.WRITE)
        value = request.decode_body(entry.value_type, entry.label)
        keyed = request.idempotency_key is not None
        first = self._keyed.find(session, request, entry.path) if keyed else None
        if first is not None:
            reply_to = self._replies.when_stored(answer, request, entry)
            timeout = self._inflight.deadline(request, entry)
            self._keyed.repeat(first, session, request, entry.path, timeout, reply_to)
            return None
        call = Call(session, request, entry, value)
        self._admission.admit(call)
        window = entry.resource.valid_for
        if request.valid_for is not None:
            window = self._deadman.window(entry, request)
        self._admission.admit_late(call)
        if request.dry_run:
            facts = {"valid_for": window, **self._dry_run(call)}
            return dry_run_reply(request, entry, {"write": value, **facts})
        if entry.owner.has_gateways:  # the dead-man is the robot's own
            window = None
        reply_to = self._replies.when_stored(answer, request, entry)
        if keyed:
            reply_to = self._keyed.note(session, request, entry.path, reply_to)
        noted = self._request_events.written(session, request, entry, reply_to)
        try:
            self._inflight.answer_later(
                session,
                request,
                noted,
                self._apply(call, window, entry.unit.stops),
                partial(_written, request, entry),
                self._inflight.deadline(request, entry),
                entry.path,
            )
        except RcpError:
            self._keyed.forget(session, request, entry.path)
            raise
        return None

    def stops(self, session: Session, request: Request) -> bool:
        """Return whether a request brings an actuator to rest, so that no rate limit may refuse it."""
        if request.type != "write" or len(request.body) > LONG:
            return False
        if request.path is None:
            return self._atomic.stops(session, request)
        try:
            entry = self._resolver.resolve(session, request.path, Operation.WRITE)
            if entry.resource.safe is None:
                return False
            return request.decode_body(entry.value_type, entry.label) == safe_value(entry)
        except RcpError:
            return False

    async def _apply(self, call: Call, window: float | None, stops: int) -> Sample:
        request, entry, value = call.request, call.entry, call.value
        if request.idempotency_key is not None:
            await self._keyed.committed()
        permit(entry.unit, stops)
        task = self._deadman.begin_write(entry)
        try:
            if entry.path in self._deadman.cancelling:
                await self._deadman.wait_cancelled(entry)
            backend = self._admission.confirm(call)
            if entry.barred and entry.unit.stops != stops:
                self._events.refused(entry, value)
                text = "an e-stop was latched and reset since this was sent"
                raise EstopActive(text, path=entry.path)
            sample = await self._send(backend, entry, value, window)
        except BaseException:
            # Report an e-stop or a loss of control as the cause, whatever the outcome of the write.
            self._admission.check_control(call)
            raise
        finally:
            self._deadman.end_write(entry, task)
            del task  # avoids a reference cycle through the traceback of its error
        if isinstance(request, PreparedRequest):
            owner = call.session.principal.identity
            await self._turns.finish(owner, sample.encode_in_steps())
        return sample

    async def _send(
        self, backend: Backend, entry: Entry, value: Any, window: float | None
    ) -> Sample:
        deadman, events = self._deadman, self._events
        started = perf_counter()
        superseded = deadman.begin(entry)
        # The effect of an unanswered write is unknown.
        timer = None if window is None else deadman.arm(entry, window + REPLY_GRACE)
        try:
            actual = await backend.write(entry.name, value)
        except BaseException as error:
            if is_unchanged(error):
                events.refused(entry, value)
            if superseded or (timer is not None and not is_unchanged(error)):
                deadman.arm(entry, 0)
            else:
                deadman.disarm(entry, timer)
            if isinstance(error, RcpError):  # raised as it is: a variable would form a cycle
                error.origin = error.origin or entry.owner.name
            elif isinstance(error, Exception):
                raise attribute_error(error, entry.owner.name, entry.path, sent=True) from error
            raise
        entry.owner.latency = perf_counter() - started
        actual = value if actual is None else actual
        events.took(entry, value, actual)
        if timer is not None:
            deadman.disarm(entry, timer)
        if window is not None and value != safe_value(entry):
            deadman.arm(entry, window)
        return entry.publish(actual, None)


def _written(request: Request, entry: Entry, sample: Sample) -> Reply:
    body: Body = sample
    if isinstance(request, PreparedRequest):  # a newer sample would drop the encodings of this one
        body = LongValue(sample.value, sample.encoded(Encoding.JSON))
    return Reply(
        type="write",
        id=request.id,
        path=entry.path,
        status="completed",
        body=body,
        message=f"{entry.path} written.",
        seq=sample.seq,
        timestamp=iso(now()),
    )


def dry_run_reply(request: Request, entry: Entry, what: dict[str, Any]) -> Reply:
    """Return the reply to a dry run."""
    return Reply(
        type=request.type,
        id=request.id,
        path=entry.path,
        body={key: item for key, item in what.items() if item is not None},
        message=f"Dry run: {entry.path} would accept this. Nothing was changed.",
        dry_run=True,
        timestamp=iso(now()),
        custom=request.custom,
    )
