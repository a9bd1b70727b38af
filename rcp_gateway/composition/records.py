"""The store, the journal of commands, and the listeners to events."""

from __future__ import annotations

from dataclasses import dataclass

from rcp_gateway.composition.base import Base
from rcp_kernel.contract.events import EventBus
from rcp_kernel.safety.safety_events import SafetyEvents
from rcp_requests.journal import CommandJournal
from rcp_requests.replies import ReplyGate
from rcp_requests.request_events import RequestEvents
from rcp_store.store import Store

__all__ = ["Records", "compose_records"]


@dataclass(frozen=True, slots=True)
class Records:
    """What is told and kept of all that happens."""

    store: Store
    events: EventBus
    safety_events: SafetyEvents
    request_events: RequestEvents
    replies: ReplyGate
    journal: CommandJournal


def compose_records(base: Base, store: Store) -> Records:
    """Create them; nobody listens yet."""
    events = EventBus()
    replies = ReplyGate(base.settings, base.loop)
    return Records(
        store=store,
        events=events,
        safety_events=SafetyEvents(events),
        request_events=RequestEvents(events, replies),
        replies=replies,
        journal=CommandJournal(store, base.settings, base.counts, replies, base.clock),
    )
