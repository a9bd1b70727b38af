"""The trace that a write or command belongs to: that of OpenTelemetry, if the program uses it."""

from __future__ import annotations

import os
import sys
from typing import Any

from rcp_protocol.trace import TRACEPARENT, TRACESTATE, current_trace

__all__ = ["with_trace"]

_ACTS = ("write", "execute")
_VARIABLE = "TRACEPARENT"
"""In which a shell passes a trace to programs, by convention."""


def with_trace(envelope: dict[str, Any]) -> dict[str, Any]:
    """Add the current trace to a write or command that has none."""
    if envelope.get("type") == "batch" and isinstance(parts := envelope.get("body"), list):
        several: list[Any] = parts  # pyright: ignore[reportUnknownVariableType]
        each = [with_trace(part) if isinstance(part, dict) else part for part in several]
        return {**envelope, "body": each}
    if envelope.get("type") not in _ACTS or TRACEPARENT in envelope:
        return envelope
    if (trace := current_trace.get()) is not None:
        return {**envelope, TRACEPARENT: trace.parent}
    fields = _of_opentelemetry() if "opentelemetry.trace" in sys.modules else {}
    if not fields and _VARIABLE in os.environ:
        fields = {TRACEPARENT: os.environ[_VARIABLE]}
    return {**envelope, **fields} if fields else envelope


def _of_opentelemetry() -> dict[str, str]:
    from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

    carrier: dict[str, str] = {}
    TraceContextTextMapPropagator().inject(carrier)
    names = {"traceparent": TRACEPARENT, "tracestate": TRACESTATE}
    return {names[name]: value for name, value in carrier.items() if name in names}
