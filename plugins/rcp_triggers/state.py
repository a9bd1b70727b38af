"""What `/system/status` and `/metrics` tell of triggers; nothing in it names a robot or a person."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

from prometheus_client.core import Metric

from rcp_kernel.contract.metrics import counter, gauge
from rcp_kernel.features import StatusPart
from rcp_triggers.alarms import Alarms
from rcp_triggers.firing import Actions
from rcp_triggers.outbox import Outbox
from rcp_triggers.triggers import Triggers

__all__ = ["metrics", "status"]


def status(triggers: Triggers, alarms: Alarms, outbox: Outbox, *, names: bool) -> StatusPart:
    """Describe triggers, alarms and deliveries; degraded while a target fails.

    `names` says whether targets are told by name.
    """
    open_ = Counter(alarm.state for alarm in alarms if alarm.state != "closed")
    targets: list[dict[str, Any]] = []
    lost = failing = 0
    for name, queue in sorted(outbox.queues.items()):
        gone = sum(count for result, count in queue.counts.items() if result != "delivered")
        lost, failing = lost + gone, failing + (queue.error is not None)
        facts = {
            "target": name,
            "waiting": len(queue.waiting),
            "error": queue.error,
            "lost": gone or None,
        }
        targets.append({key: value for key, value in facts.items() if value is not None})
    told = {
        "triggers": len(triggers.known),
        "robots": {state: count for state, count in triggers.counts().items() if count},
        "alarms": dict(open_),
        "waiting": sum(len(queue.waiting) for queue in outbox.queues.values()),
        "lost": lost,
        "failing": failing,
    }
    if names and targets:
        told["targets"] = targets
    return StatusPart({"triggers": told}, degraded=failing > 0)


def metrics(
    triggers: Triggers, alarms: Alarms, outbox: Outbox, actions: Actions
) -> Iterable[Metric]:
    """Return the metric families."""
    states = [([state], float(count)) for state, count in triggers.counts().items()]
    yield gauge("rcp_trigger_robots", "Triggers on robots, by state.", ("state",), states)
    counts = [([result], float(count)) for result, count in actions.counts.items()]
    yield counter("rcp_trigger_firings", "Firings of triggers, by result.", ("result",), counts)
    open_ = Counter(alarm.state for alarm in alarms)
    rows = [([state], float(open_[state])) for state in ("active", "acknowledged", "cleared")]
    yield gauge("rcp_alarms", "Open alarms, by state.", ("state",), rows)
    queues = sorted(outbox.queues.items())
    waiting = [([name], float(len(queue.waiting))) for name, queue in queues]
    yield gauge("rcp_trigger_outbox", "Notifications that wait.", ("target",), waiting)
    ended = [
        ([name, result], float(count))
        for name, queue in queues
        for result, count in queue.counts.items()
    ]
    yield counter(
        "rcp_trigger_notifications", "Notifications, by end.", ("target", "result"), ended
    )
    failed = [([name], float(queue.attempts)) for name, queue in queues]
    yield counter(
        "rcp_trigger_failed_attempts", "Attempts to deliver that failed.", ("target",), failed
    )
