"""Commands, events and notices as messages: short, and without what readers must not know of."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

import msgspec

from rcp_kernel.contract.digest import LONGEST, bounded, hashed
from rcp_kernel.contract.events import Event
from rcp_kernel.errors import RcpError
from rcp_kernel.values import ANY
from rcp_kernel.wire import Request
from rcp_recorder.taps import Taps
from rcp_recordings.names import MessageKind

__all__ = ["described", "shortened", "value_of", "write"]

_TEXT = 500  # characters of a message
_NAMED = re.compile(r"/tenant/[\w./-]*\w")
_WHAT = {"what", "outcome", "status", "state", "did", "reset", "time", "principal"}
_WHERE = {"path", "command", "robot", "scope", "lease"}
_ALWAYS = _WHAT | _WHERE
"""What never mentions another resource."""


def described(event: Event) -> dict[str, Any]:
    """Return what an event, and why, and who did it."""
    facts: dict[str, Any] = {"what": event.what, "outcome": event.outcome}
    if event.principal is not None:
        facts["principal"] = event.principal.name[:_TEXT]
    for key in ("message", "reason"):
        if isinstance(text := event.facts.get(key), str):
            facts[key] = text[:_TEXT]
    return facts


def shortened(text: str) -> str:
    """Return a text that is short enough for a message."""
    return text[:_TEXT]


def value_of(request: Request) -> Any:
    """Return the value of a write, or its hash if it is long."""
    if len(request.body) > LONGEST:
        return hashed(bytes(request.body))
    try:
        return bounded(request.decode_body(ANY))
    except RcpError:
        return None


def write(
    taps: Taps,
    kind: MessageKind,
    path: str | None,
    tenant: str,
    now: int,
    facts: dict[str, Any],
    touches: Iterable[str] = (),
) -> None:
    """Record facts; only those that mention nothing else, if the rest is about what is not recorded."""
    rest = {key: value for key, value in facts.items() if key not in _ALWAYS}
    mentioned = _NAMED.findall(msgspec.json.encode(rest).decode())
    if any(named not in taps for named in (*mentioned, *touches)):
        facts = {key: value for key, value in facts.items() if key in _ALWAYS}
    taps.note(kind, path, tenant, now, msgspec.json.encode(facts))
