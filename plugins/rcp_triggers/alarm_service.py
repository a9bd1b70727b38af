"""`/system/alarms` and `/system/firings`: what each reader sees of them, and acknowledgements."""

from __future__ import annotations

from typing import Any

from rcp_kernel.errors import Forbidden, UnknownPath
from rcp_kernel.model import Operation
from rcp_kernel.sessions.session import Session
from rcp_kernel.values import to_plain
from rcp_triggers.alarms import ALARMS, Alarms
from rcp_triggers.firing import FIRINGS
from rcp_triggers.messages import AlarmRequest, AlarmState, Firing
from rcp_triggers.rights import TriggerRights

__all__ = ["AlarmService", "firing_shown"]


class AlarmService:
    """Lists alarms, and takes acknowledgements."""

    def __init__(self, alarms: Alarms, rights: TriggerRights) -> None:
        self._alarms = alarms
        self._rights = rights

    def view(self, session: Session) -> list[dict[str, Any]]:
        """List alarms, newest first."""
        every = reversed([*self._alarms])
        return [to_plain(alarm) for alarm in every if self._sees(session, alarm)]

    def execute(self, session: Session, wanted: AlarmRequest, *, dry_run: bool) -> AlarmState:
        """Acknowledge an alarm.

        :raises RcpError: it is refused.
        """
        alarm = self._alarms.known.get(wanted.acknowledge)
        if alarm is None or not self._sees(session, alarm):
            raise UnknownPath(
                f"there is no alarm '{wanted.acknowledge[:64]}'",
                path=ALARMS,
                remedy=f"Read {ALARMS}.",
            )
        if not self._rights.in_tenant(session.rights, alarm.tenant, Operation.EXECUTE, ALARMS):
            raise Forbidden(
                f"{session.principal.name} may not acknowledge alarms of {alarm.tenant}",
                path=ALARMS,
            )
        self._alarms.check_open(alarm)
        if not dry_run:
            self._alarms.acknowledge(session, alarm, wanted.comment)
        return alarm

    def _sees(self, session: Session, alarm: AlarmState) -> bool:
        rights, judge = session.rights, self._rights
        return judge.in_tenant(rights, alarm.tenant, Operation.READ, ALARMS) and judge.sees(
            rights, alarm.tenant, alarm.paths, alarm.message
        )


def firing_shown(rights: TriggerRights, session: Session, firing: Firing) -> Firing | None:
    """Return a firing to whoever may read what it is about."""
    own = session.rights
    if not rights.in_tenant(own, firing.tenant, Operation.READ, FIRINGS):
        return None
    facts = [firing.message, firing.condition, firing.detail]
    return firing if rights.sees(own, firing.tenant, firing.paths, facts) else None
