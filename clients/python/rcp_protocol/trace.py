"""W3C trace context in envelopes: the fields `x-traceparent` and `x-tracestate`.

Every wire carries fields `x-…`, and the gateway keeps them with commands and audit records.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextvars import ContextVar
from typing import Any, NamedTuple

from rcp_protocol.plain import is_map

__all__ = ["TRACEPARENT", "TRACESTATE", "Trace", "carried", "current_trace", "trace_of", "traced"]

TRACEPARENT, TRACESTATE = "x-traceparent", "x-tracestate"
_FORM = re.compile(
    r"(?!ff)[0-9a-f]{2}-((?!0{32})[0-9a-f]{32})-((?!0{16})[0-9a-f]{16})-([0-9a-f]{2})(-.*)?"
)
"""https://www.w3.org/TR/trace-context/: version, trace, parent, flags."""
_COMMAND = re.compile(r"cmd-([0-9a-f]{16})")
_SAMPLED = 1


class Trace(NamedTuple):
    """A place in a trace: what is done there has it as its parent."""

    id: str
    """32 hexadecimal digits."""
    span: str
    """16 hexadecimal digits."""
    sampled: bool = True

    @property
    def parent(self) -> str:
        """The text of `traceparent`."""
        return f"00-{self.id}-{self.span}-{_SAMPLED if self.sampled else 0:02d}"


current_trace: ContextVar[Trace | None] = ContextVar("rcp_trace", default=None)
"""What a client of this library sends with writes and commands, unless they have a trace of their own."""


def trace_of(custom: Mapping[str, Any] | None) -> Trace | None:
    """Return the trace in fields of an envelope; None without a valid one."""
    text = None if custom is None else custom.get(TRACEPARENT)
    found = _FORM.fullmatch(text) if isinstance(text, str) else None
    if found is None:
        return None
    return Trace(found[1], found[2], bool(int(found[3], 16) & _SAMPLED))


def carried(carrier: object) -> dict[str, Any] | None:
    """Return the fields for an envelope from a carrier of another protocol: `traceparent`, `tracestate`."""
    if not is_map(carrier):
        return None
    names = {"traceparent": TRACEPARENT, "tracestate": TRACESTATE}
    found = {
        field: carrier[name] for name, field in names.items() if isinstance(carrier.get(name), str)
    }
    return found if trace_of(found) is not None else None


def traced(custom: Mapping[str, Any] | None, command: str | None) -> Trace | None:
    """Return the place in a trace at which a request or command is carried out.

    The id of a command is that of its span. One that came without a trace begins its own, whose id
    is that of the command, twice.
    """
    trace = trace_of(custom)
    found = None if command is None else _COMMAND.fullmatch(command)
    if found is None:
        return trace
    return Trace(found[1] * 2, found[1]) if trace is None else trace._replace(span=found[1])
