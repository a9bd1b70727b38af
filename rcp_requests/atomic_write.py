"""A `write` of several paths of one robot as one: all are written, or none.

Each of them passes every check of a write of its own, before the robot receives anything.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from time import perf_counter
from typing import Any, NamedTuple

import msgspec
import structlog
from msgspec import Raw

from rcp_kernel.clock import iso, now
from rcp_kernel.contract.fence import permit
from rcp_kernel.contract.internal_errors import attribute_error
from rcp_kernel.errors import (
    BadRequest,
    EstopActive,
    RcpError,
)
from rcp_kernel.features import Call
from rcp_kernel.features.observer import CommandEvents
from rcp_kernel.model import Operation
from rcp_kernel.safety.deadman import REPLY_GRACE, Deadman
from rcp_kernel.safety.safe_value import is_safe
from rcp_kernel.sessions.session import Answer, Session
from rcp_kernel.spi import Backend
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Sample
from rcp_kernel.wire import Reply, Request
from rcp_requests.admission import Admission, Resolver
from rcp_requests.atomic_group import check_group, values_by_path
from rcp_requests.inflight import InFlight
from rcp_requests.keyed_write import KeyedWrites
from rcp_requests.outcomes import is_unchanged
from rcp_requests.replies import ReplyGate
from rcp_requests.request_events import RequestEvents

__all__ = ["AtomicWriteHandler", "DryRun"]

log = structlog.get_logger("rcp.requests")

DryRun = Callable[[Call], Mapping[str, Any]]
"""Returns the features' part of the reply to a dry run."""


class _Item(NamedTuple):
    """One path with its value, and the request that it would be alone."""

    entry: Entry
    request: Request
    value: Any


class _Admitted(NamedTuple):
    """An admitted write of several paths."""

    calls: tuple[Call, ...]
    limited: tuple[Entry, ...]
    """Those that are valid for a time only."""
    window: float
    """That time in s: one for all, the shortest."""
    stops: int
    """Number of stops of the robot when it was admitted."""

    @property
    def entries(self) -> list[Entry]:
        """The targets."""
        return [call.entry for call in self.calls]


class AtomicWriteHandler:
    """The handler of a `write` without a path, whose body maps paths to values."""

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

    def write(self, session: Session, request: Request, answer: Answer) -> Reply | None:
        """Start a write; a repetition with the same idempotency key waits for the first outcome."""
        items = self._items(session, request)
        entries = [item.entry for item in items]
        check_group(entries)
        place = f"/tenant/{entries[0].tenant}"
        timeout = min(self._inflight.deadline(request, entry) for entry in entries)
        keyed = request.idempotency_key is not None
        first = self._keyed.find(session, request, place) if keyed else None
        if first is not None:
            reply_to = self._replies.when_stored(answer, request)
            self._keyed.repeat(first, session, request, None, timeout, reply_to)
            return None
        admitted = self._admit(session, request, items)
        if request.dry_run:
            return self._dry_run_reply(request, admitted)
        reply_to = self._replies.when_stored(answer, request)
        if keyed:
            reply_to = self._keyed.note(session, request, place, reply_to)
        noted = self._request_events.written_together(session, admitted.calls, reply_to)
        try:
            self._inflight.answer_later(
                session,
                request,
                noted,
                self._apply(admitted),
                lambda samples: _written(request, samples),
                timeout,
                None,
            )
        except RcpError:
            self._keyed.forget(session, request, place)
            raise
        return None

    def stops(self, session: Session, request: Request) -> bool:
        """Return whether all values bring an actuator to rest, so that no rate limit may refuse."""
        try:
            parts = values_by_path(request).items()
            items = (self._item(session, request, path, body) for path, body in parts)
            return all(is_safe(item.entry, item.value) for item in items)
        except RcpError:
            return False

    def _items(self, session: Session, request: Request) -> list[_Item]:
        """Resolve and decode all paths and values, and charge them.

        :raises RcpError: of the first that is wrong, with all of them in `details.faults`.
        """
        faults: list[RcpError] = []
        items: dict[str, _Item] = {}
        parts = values_by_path(request)
        for path, body in parts.items():
            try:
                item = self._item(session, request, path, body)
                if item.entry.path in items:
                    raise BadRequest(f"{item.entry.path} is written twice", path=item.entry.path)
                items[item.entry.path] = item
            except RcpError as error:
                faults.append(_at(error, path))
        rests = not faults and all(is_safe(i.entry, i.value) for i in items.values())
        _charge(session, len(parts) - 1, rests=rests)  # the router has charged the first
        _raise(faults)
        return list(items.values())

    def _item(self, session: Session, request: Request, path: str, body: Raw) -> _Item:
        entry = self._resolver.resolve(session, path, Operation.WRITE)
        alone = msgspec.structs.replace(request, path=entry.path, body=body)
        try:
            return _Item(entry, alone, alone.decode_body(entry.value_type, entry.label))
        except RcpError as error:
            raise _at(error, entry.path) from None

    def _admit(self, session: Session, request: Request, items: list[_Item]) -> _Admitted:
        """Admit all of them.

        :raises RcpError: of the first that is refused, with all of them in `details.faults`.
        """
        together = tuple((item.entry, item.value) for item in items)
        calls = tuple(Call(session, i.request, i.entry, i.value, together) for i in items)
        faults: list[RcpError] = []
        for call in calls:
            try:
                self._admission.admit(call)
            except RcpError as error:
                faults.append(_at(error, call.entry.path))
        _raise(faults)
        windows = self._windows(request, calls)
        try:
            self._admission.admit_late_all(calls)
        except RcpError as error:
            _raise([error])
        least = min(windows.values(), default=0.0)
        limited = tuple(call.entry for call in calls if call.entry.path in windows)
        if calls[0].entry.owner.has_gateways and not request.dry_run:  # it has the dead-man too
            limited = ()
        return _Admitted(calls, limited, least, calls[0].entry.unit.stops)

    def _windows(self, request: Request, calls: Sequence[Call]) -> dict[str, float]:
        """Return how long those with a dead-man are valid: `valid_for` concerns only them.

        :raises BadRequest: `valid_for` was given, and none has a safe value.
        """
        entries = [call.entry for call in calls]
        if request.valid_for is not None:
            safe = [entry for entry in entries if entry.resource.safe is not None]
            entries = safe or entries[:1]
        windows = {entry.path: self._deadman.window(entry, request) for entry in entries}
        return {path: window for path, window in windows.items() if window is not None}

    def _dry_run_reply(self, request: Request, admitted: _Admitted) -> Reply:
        return Reply(
            type="write",
            id=request.id,
            body=[
                _present(
                    {
                        "path": call.entry.path,
                        "write": call.value,
                        "valid_for": admitted.window if call.entry in admitted.limited else None,
                        **self._dry_run(call),
                    }
                )
                for call in admitted.calls
            ],
            message=f"Dry run: {len(admitted.calls)} paths would accept this. Nothing was changed.",
            dry_run=True,
            timestamp=iso(now()),
            custom=request.custom,
        )

    async def _apply(self, admitted: _Admitted) -> list[Sample]:
        entries = admitted.entries
        unit = entries[0].unit
        if admitted.calls[0].request.idempotency_key is not None:
            await self._keyed.committed()
        permit(unit, admitted.stops)
        task = self._deadman.begin_write(entries[0])
        for entry in entries[1:]:
            self._deadman.begin_write(entry)
        try:
            for entry in entries:
                if entry.path in self._deadman.cancelling:
                    await self._deadman.wait_cancelled(entry)
            backend = self._confirm(admitted)
            return await self._send(backend, admitted)
        except BaseException:
            # Report an e-stop or a loss of control as the cause, whatever the outcome of the write.
            for call in admitted.calls:
                self._admission.check_control(call)
            raise
        finally:
            for entry in entries:
                self._deadman.end_write(entry, task)
            del task  # avoids a reference cycle through the traceback of its error

    def _confirm(self, admitted: _Admitted) -> Backend:
        """Check all of them again, in the turn of the event loop that calls the backend."""
        confirmed: list[Backend] = []
        for call in admitted.calls:
            try:
                confirmed.append(self._admission.confirm(call))
                if call.entry.barred and call.entry.unit.stops != admitted.stops:
                    text = "an e-stop was latched and reset since this was sent"
                    raise EstopActive(text, path=call.entry.path)
            except RcpError as error:
                for sent in admitted.calls[: len(confirmed)]:
                    self._events.refused(sent.entry, sent.value)
                _raise([_at(error, call.entry.path)])
        return confirmed[0]

    async def _send(self, backend: Backend, admitted: _Admitted) -> list[Sample]:
        deadman, events = self._deadman, self._events
        calls, limited, started = admitted.calls, admitted.limited, perf_counter()
        superseded = [entry for entry in admitted.entries if deadman.begin(entry)]
        # The effect of an unanswered write is unknown.
        timers = deadman.arm_together(limited, admitted.window + REPLY_GRACE) if limited else {}
        try:
            actual = await _write(backend, {c.entry.name: c.value for c in calls})
        except BaseException as error:
            unchanged = is_unchanged(error)
            if unchanged:
                for call in calls:
                    events.refused(call.entry, call.value)
            at_risk = superseded if unchanged else [*dict.fromkeys((*superseded, *limited))]
            for entry in limited:
                deadman.disarm(entry, timers.get(entry.path))
            if at_risk:
                deadman.arm_together(at_risk, 0)
            attributed = _attributed(error, admitted)
            try:
                if attributed is error:
                    raise
                raise attributed from error
            finally:
                del attributed  # a frame that refers to its error forms a reference cycle
        calls[0].entry.owner.latency = perf_counter() - started
        for call in calls:
            events.took(call.entry, call.value, actual.get(call.entry.name, call.value))
            deadman.disarm(call.entry, timers.get(call.entry.path))
        moving = [c.entry for c in calls if c.entry in limited and not is_safe(c.entry, c.value)]
        if moving:
            deadman.arm_together(moving, admitted.window)
        # All in one turn of the event loop, so that they reach each client in one flush.
        return [c.entry.publish(actual.get(c.entry.name, c.value), None) for c in calls]


async def _write(backend: Backend, values: dict[str, Any]) -> Mapping[str, Any]:
    """Send the values; one alone needs no group."""
    if len(values) > 1:
        return await backend.write_together(values)
    [(name, value)] = values.items()
    actual = await backend.write(name, value)
    return {} if actual is None else {name: actual}


def _charge(session: Session, count: int, *, rests: bool) -> None:
    """Charge a number of paths as requests.

    :raises RcpError: that is more than allowed, and they do not only bring something to rest.
    """
    account = session.account
    for _ in range(0 if account is None else count):
        assert account is not None
        try:
            taken = account.take(session.monotonic())
        except Exception:  # a fault in a feature must not refuse a stop
            log.exception("account_failed", feature=type(account).__module__)
            taken = False
        if not taken and not rests:
            raise account.refusal(session.monotonic())


def _at(error: RcpError, path: str | None) -> RcpError:
    error.path = error.path or path
    return error


def _raise(faults: list[RcpError]) -> None:
    """Raise the first fault, with all of them in its details; empties the list."""
    if not faults:
        return
    listed = [_fault(fault) for fault in faults]
    first = faults[0]
    first.details = {**(first.details or {}), "faults": listed}
    faults.clear()
    try:
        raise first
    finally:
        del first  # a frame that refers to its error forms a reference cycle


def _fault(error: RcpError) -> dict[str, Any]:
    return _present(
        {
            "path": error.path,
            "code": error.code,
            "message": error.message,
            "remedy": error.remedy,
            "details": error.details,
        }
    )


def _attributed(error: BaseException, admitted: _Admitted) -> BaseException:
    """Return a backend's error with the path of its item, and the backend as its origin."""
    owner = admitted.calls[0].entry.owner
    if isinstance(error, RcpError):
        named = {call.entry.name: call.entry.path for call in admitted.calls}
        error.path = named.get(error.path or "", error.path)
        error.origin = error.origin or owner.name
        if error.path is not None:
            error.details = {**(error.details or {}), "faults": [_fault(error)]}
        return error
    if isinstance(error, Exception):
        return attribute_error(error, owner.name, admitted.calls[0].entry.path, sent=True)
    return error


def _present(facts: dict[str, Any]) -> dict[str, Any]:
    return {key: fact for key, fact in facts.items() if fact is not None}


def _written(request: Request, samples: Iterable[Sample]) -> Reply:
    body = [
        {"path": sample.entry.path, "status": "completed", "body": sample.value, "seq": sample.seq}
        for sample in samples
    ]
    return Reply(
        type="write",
        id=request.id,
        status="completed",
        body=body,
        message=f"{len(body)} paths written as one.",
        timestamp=iso(now()),
    )
