"""Alarms: raised by triggers, open until they have cleared and somebody has acknowledged them."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Container, Iterator

import msgspec
import structlog

from rcp_kernel.clock import iso
from rcp_kernel.errors import ModeForbids
from rcp_kernel.features import FeatureHost
from rcp_kernel.sessions.session import Session
from rcp_kernel.values import to_plain
from rcp_triggers.messages import AlarmState, Firing

__all__ = ["ALARMS", "Alarms"]

log = structlog.get_logger("rcp.triggers")
ALARMS = "/system/alarms"
_CLOSED = 200  # alarms that are listed after they were closed
_CLEARED = 1000  # alarms that have cleared and that nobody has acknowledged
_Key = tuple[str, str]


class Alarms:
    """All alarms, oldest first; they survive a restart."""

    def __init__(self, host: FeatureHost, changed: Callable[[], None]) -> None:
        self._host = host
        self._store = host.store("alarms")
        self._changed = changed
        self.known: dict[str, AlarmState] = {}
        self._open: dict[_Key, str] = {}
        """Open ones by trigger and robot."""

    def load(self) -> None:
        """Take over those of earlier runs."""
        found: list[tuple[str, AlarmState]] = []
        for id_, row in self._store.load().items():
            try:
                found.append((row["key"], msgspec.convert(row["state"], AlarmState)))
            except (msgspec.ValidationError, KeyError, TypeError) as error:
                log.warning("alarm_unreadable", id=id_, error=str(error))
                self._store.put(id_, None)
        for key, alarm in sorted(found, key=lambda one: str(one[1].raised)):
            self.known[alarm.alarm] = alarm
            if alarm.state != "closed":
                self._open[key, alarm.robot] = alarm.alarm

    def fired(self, key: str, firing: Firing) -> str:
        """Raise an alarm, or count one that is open; return its id."""
        found = self._open.get((key, firing.robot))
        if found is None:
            alarm = AlarmState(
                alarm=f"al-{secrets.token_hex(6)}",
                trigger=firing.trigger,
                tenant=firing.tenant,
                robot=firing.robot,
                severity=firing.severity,
                message=firing.message,
                raised=firing.time,
                last=firing.time,
                paths=firing.paths,
            )
            self.known[alarm.alarm] = alarm
            self._open[key, firing.robot] = alarm.alarm
            self._let_old_go()
        else:
            alarm = self.known[found]
            alarm.count += 1
            alarm.last, alarm.cleared = firing.time, None
            if alarm.state == "cleared":
                alarm.state = "active"
        self._keep(key, alarm)
        return alarm.alarm

    def cleared(self, key: str, robot: str) -> None:
        """Note that what raised an alarm is over."""
        found = self._open.get((key, robot))
        if found is None:
            return
        alarm = self.known[found]
        alarm.cleared = iso(self._host.clock.now())
        if alarm.state == "acknowledged":
            self._close(key, alarm)
        elif alarm.state == "active":
            alarm.state = "cleared"
        self._keep(key, alarm)

    def removed(self, key: str) -> None:
        """Note that a trigger is no more: what it raised can only be acknowledged."""
        for other, robot in [*self._open]:
            if other == key:
                self.cleared(key, robot)

    def keep_only(self, keys: Container[str]) -> None:
        """Note that alarms are over whose triggers are no more."""
        for key in {key for key, _ in self._open if key not in keys}:
            self.removed(key)

    def acknowledge(self, session: Session, alarm: AlarmState, comment: str) -> None:
        """Acknowledge an alarm, for the record."""
        key = next(key for (key, _), id_ in self._open.items() if id_ == alarm.alarm)
        alarm.acknowledged = iso(self._host.clock.now())
        alarm.by, alarm.comment = session.principal.name, comment
        if alarm.state == "cleared":
            self._close(key, alarm)
        else:
            alarm.state = "acknowledged"
        self._keep(key, alarm)
        self._host.note(
            "alarm",
            principal=session.principal,
            session=session,
            tenant=alarm.tenant,
            path=ALARMS,
            touches=alarm.paths,
            outcome="acknowledged",
            alarm=alarm.alarm,
            trigger=alarm.trigger,
            reason=comment or None,
        )

    @staticmethod
    def check_open(alarm: AlarmState) -> None:
        """Refuse to acknowledge an alarm twice.

        :raises ModeForbids: somebody has acknowledged it.
        """
        if alarm.acknowledged is not None:
            raise ModeForbids(
                f"{alarm.by} has acknowledged the alarm {alarm.alarm} already",
                path=ALARMS,
                remedy="There is nothing more to do.",
            )

    def __iter__(self) -> Iterator[AlarmState]:
        return iter([*self.known.values()])

    def _close(self, key: str, alarm: AlarmState) -> None:
        alarm.state = "closed"
        self._open.pop((key, alarm.robot), None)

    def _let_old_go(self) -> None:
        old = [alarm.alarm for alarm in self if alarm.state == "closed"][:-_CLOSED]
        old += [alarm.alarm for alarm in self if alarm.state == "cleared"][:-_CLEARED]
        for id_ in old:
            del self.known[id_]
            self._store.put(id_, None)
        if old:
            self._open = {key: id_ for key, id_ in self._open.items() if id_ in self.known}

    def _keep(self, key: str, alarm: AlarmState) -> None:
        self._store.put(alarm.alarm, {"key": key, "state": to_plain(alarm)})
        self._changed()
