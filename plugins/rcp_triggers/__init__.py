"""Triggers: conditions on robots that notify, raise alarms, record incidents and send commands."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager

from prometheus_client.core import Metric

from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.access.acl import Rights
from rcp_kernel.config.role import Rule as AccessRule
from rcp_kernel.features import Feature, FeatureHost, FeatureKind, StatusPart, SystemResource
from rcp_kernel.model import Operation, Resource
from rcp_kernel.sessions.session import Session
from rcp_triggers.config import TriggersConfig, check
from rcp_triggers.messages import (
    AlarmRequest,
    AlarmState,
    Firing,
    TriggerReply,
    TriggerRequest,
    TriggerState,
)

__all__ = [
    "AlarmRequest",
    "AlarmState",
    "Firing",
    "TriggerReply",
    "TriggerRequest",
    "TriggerState",
    "TriggersConfig",
    "rcp_features",
]

_LOOK = Operation.READ | Operation.SUBSCRIBE
_EXAMPLE = {
    "add": {
        "name": "battery-low",
        "robot": "/tenant/alpha/rover",
        "when": "sensor.battery.percentage < 0.2",
        "clear": "sensor.battery.percentage > 0.3",
        "for": 10,
        "alarm": True,
    }
}
_TRIGGERS = Resource(
    name="service/triggers",
    description="Conditions on robots that notify, raise alarms, record incidents and send commands.",
    value=list[TriggerState],
    input=TriggerRequest,
    output=TriggerReply,
    operations=_LOOK | Operation.EXECUTE,
    examples=(_EXAMPLE, {"test": "battery-low"}, {"remove": "battery-low"}),
    history=1,
)
_ALARMS = Resource(
    name="service/alarms",
    description="Alarms of triggers, open until they have cleared and were acknowledged.",
    value=list[AlarmState],
    input=AlarmRequest,
    output=AlarmState,
    operations=_LOOK | Operation.EXECUTE,
    examples=({"acknowledge": "al-0123456789ab", "comment": "battery swapped"},),
    history=1,
)
_FIRINGS = Resource(
    name="event/firings",
    description="What happened to triggers: they fired, cleared, stopped, or their command ended.",
    value=Firing,
    history=200,
)
_SOON = 0.1  # s that changes of a view are gathered


class _Changes:
    """Tells of a changed view, a while after the first of several changes."""

    def __init__(self, host: FeatureHost, path: str) -> None:
        self._host = host
        self._path = path
        self._due = False

    def __call__(self) -> None:
        """Note a change."""
        if not self._due:
            self._due = True
            self._host.loop.call_later(_SOON, self._tell)

    def _tell(self) -> None:
        self._due = False
        self._host.changed(self._path)


def _make(config: TriggersConfig, host: FeatureHost) -> Feature:
    from rcp_triggers.alarm_service import AlarmService, firing_shown
    from rcp_triggers.alarms import ALARMS, Alarms
    from rcp_triggers.authenticator import RuleAuthenticator
    from rcp_triggers.firing import Actions
    from rcp_triggers.outbox import Outbox
    from rcp_triggers.rights import TriggerRights
    from rcp_triggers.senders import Sender, sender_for
    from rcp_triggers.service import TRIGGERS, TriggerService
    from rcp_triggers.state import metrics, status
    from rcp_triggers.triggers import Triggers

    changed = _Changes(host, TRIGGERS)
    rights = TriggerRights(host, TRIGGERS)
    outbox = Outbox(host, keep=config.keep, queue=config.queue, changed=changed)
    alarms = Alarms(host, _Changes(host, ALARMS))
    actions = Actions(host, rights, outbox, alarms, changed)
    triggers = Triggers(host, rights, actions, config.per_minute, changed)
    service = TriggerService(triggers, rights, actions, host, config.targets, config.most)
    alarm_service = AlarmService(alarms, rights)
    authenticator = RuleAuthenticator(config.rules)
    current = config
    opening: asyncio.Task[None] | None = None  # the event loop holds tasks weakly

    def senders() -> dict[str, Sender]:
        targets = current.targets.items()
        return {name: sender_for(name, target, host.clock) for name, target in targets}

    def reconfigure(table: TriggersConfig) -> None:
        nonlocal current, opening
        current = table
        authenticator.reconfigure(table.rules)
        outbox.keep, outbox.most = table.keep, table.queue
        service.targets, service.most = table.targets, table.most
        triggers.per_minute = table.per_minute
        triggers.configure(table.rules)
        opening = host.loop.create_task(outbox.open(senders()))

    @asynccontextmanager
    async def running() -> AsyncGenerator[None]:
        outbox.load()
        alarms.load()
        triggers.open(current.rules)
        alarms.keep_only(triggers.known)
        await outbox.open(senders())
        try:
            yield
        finally:
            triggers.close()
            if opening is not None:
                await opening
            await outbox.close()

    def state(own: Rights | None) -> StatusPart:
        return status(triggers, alarms, outbox, names=own is None or "*" in own.tenants)

    def families() -> Iterable[Metric]:
        return metrics(triggers, alarms, outbox, actions)

    def shown(session: Session, firing: Firing) -> Firing | None:
        return firing_shown(rights, session, firing)

    return Feature(
        resources=(
            SystemResource(resource=_TRIGGERS, view=service.view, execute=service.execute),
            SystemResource(
                resource=_ALARMS, view=alarm_service.view, execute=alarm_service.execute
            ),
            SystemResource(resource=_FIRINGS, shows=shown),
        ),
        authenticator=authenticator,
        rights_changed=triggers.rights_changed,
        status=state,
        metrics=families,
        reconfigure=reconfigure,
        running=running,
    )


@hookimpl
def rcp_features() -> Iterable[FeatureKind]:
    """Offer triggers."""
    paths = ("/system/triggers", "/system/alarms", "/system/firings")
    look = AccessRule(("discover", "read", "subscribe"), paths)
    use = AccessRule(("execute",), paths[:2])
    return [
        FeatureKind(
            "triggers",
            TriggersConfig,
            _make,
            __doc__ or "",
            needs=("aiosmtplib", "cel", "httpx"),
            check=check,
            grants={"agent": (look,), "operator": (look, use)},
        )
    ]
