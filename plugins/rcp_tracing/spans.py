"""Spans of what clients ask of robots, children of the client's own span."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from opentelemetry import trace as otel
from opentelemetry.context import Context
from opentelemetry.trace import NonRecordingSpan, Span, SpanContext, SpanKind, TraceFlags

from rcp_kernel.contract.events import Event
from rcp_kernel.model import Kind
from rcp_kernel.sessions.command import Command, Record
from rcp_protocol.trace import Trace, trace_of

__all__ = ["Spans", "Tracer"]

_STARTED = ("accepted", "pending")
_GOOD = ("ok", "completed")
_KINDS = frozenset({*Kind, "system"})
_EVENTS = ("write", "estop", "denial")


class Tracer(NamedTuple):
    """What makes spans."""

    make: otel.Tracer
    name: Callable[[Trace | None], None]
    """Chooses the ids of the span that is made next."""


class Spans:
    """Makes spans of finished commands and of events."""

    def __init__(self) -> None:
        self.tracer: Tracer | None = None
        """None unless the feature runs."""

    def on_command(self, command: Command, record: Record) -> None:
        """Make the span of a command that has ended, and within it that of the robot."""
        if self.tracer is None or command.finished is None:
            return
        parent, own = trace_of(command.custom), command.trace
        if parent is not None and not parent.sampled:
            return
        span = self._span(
            _name("execute", command.path),
            SpanKind.SERVER,
            parent,
            own,
            command.created,
            {
                "rcp.path": command.path,
                "rcp.command": command.id,
                "rcp.principal": command.principal,
                "rcp.tenant": command.tenant,
                "rcp.status": record.status,
            },
        )
        for step in command.history:
            span.add_event(step.status, timestamp=step.time)
        if command.sent and command.entry is not None:
            begun = [step.time for step in command.history if step.status in _STARTED]
            robot = self._span(
                _name("robot", command.path),
                SpanKind.CLIENT,
                own,
                None,
                begun[-1] if begun else command.created,
                {"rcp.path": command.path},
            )
            _end(robot, record.time, record.status, record.error)
        _end(span, record.time, record.status, record.error)

    def on_event(self, event: Event) -> None:
        """Make the span of a traced write or refusal, and of every e-stop; all are moments."""
        request = event.request
        if self.tracer is None or event.what not in _EVENTS:
            return
        parent = None if request is None else trace_of(request.custom)
        if parent is None and event.what != "estop":
            return
        if parent is not None and not parent.sampled:
            return
        moment = time.time_ns()
        facts = {
            "rcp.path": event.path,
            "rcp.principal": None if event.principal is None else event.principal.name,
            "rcp.transport": None if event.session is None else event.session.transport,
            "rcp.outcome": event.outcome,
        }
        kind = event.what if request is None or event.what == "estop" else request.type
        failed = event.what == "denial" or event.outcome not in _GOOD
        name = _name(kind, None if failed or event.what == "estop" else event.path)
        span = self._span(name, SpanKind.SERVER, parent, None, moment, facts)
        _end(span, moment, "failed" if failed else "completed", None)

    def _span(
        self,
        name: str,
        kind: SpanKind,
        parent: Trace | None,
        own: Trace | None,
        began: int,
        facts: Mapping[str, Any],
    ) -> Span:
        assert self.tracer is not None
        self.tracer.name(own)
        try:
            return self.tracer.make.start_span(
                name,
                context=_context(parent),
                kind=kind,
                attributes={key: fact for key, fact in facts.items() if fact is not None},
                start_time=began,
            )
        finally:
            self.tracer.name(None)


def _name(kind: str, path: str | None) -> str:
    """Return one of few names: that of the resource, not of its robot, and no path that may be made up."""
    parts = [] if path is None else path.strip("/").split("/")
    if parts[:1] == ["tenant"]:
        del parts[:2]
    while parts and parts[0] not in _KINDS:
        del parts[0]
    return f"{kind} {'/'.join(parts)}" if parts else kind


def _context(parent: Trace | None) -> Context:
    """Return a parent elsewhere as the SDK has it; without one, a span begins its trace."""
    empty = Context()
    if parent is None:
        return empty
    flags = TraceFlags(TraceFlags.SAMPLED if parent.sampled else TraceFlags.DEFAULT)
    context = SpanContext(
        int(parent.id, 16), int(parent.span, 16), is_remote=True, trace_flags=flags
    )
    return otel.set_span_in_context(NonRecordingSpan(context), empty)


def _end(span: Span, moment: int, status: str, error: Mapping[str, Any] | None) -> None:
    if status not in _GOOD:
        code = str((error or {}).get("code") or status)
        span.set_attribute("error.type", code)
        span.set_status(
            otel.Status(otel.StatusCode.ERROR, str((error or {}).get("message") or code))
        )
    span.end(end_time=moment)
