"""What comes of a trigger: it notifies, raises alarms, records incidents and sends its command."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any, Literal

import msgspec
import structlog

from rcp_kernel.clock import iso
from rcp_kernel.contract.paths import ESTOP
from rcp_kernel.errors import RcpError, TokenExpired
from rcp_kernel.features import FeatureHost
from rcp_kernel.features.incidents import INCIDENTS
from rcp_kernel.values import Encoding, dump, to_plain
from rcp_kernel.wire import Reply, Request
from rcp_triggers.alarms import Alarms
from rcp_triggers.messages import Firing
from rcp_triggers.notice import Notice, NoticeType
from rcp_triggers.outbox import Outbox, stored
from rcp_triggers.rights import TRANSPORT, TriggerRights
from rcp_triggers.spec import Do, command_for
from rcp_triggers.trigger import OnRobot, StoredState, Transition, Trigger

__all__ = ["FIRINGS", "Actions", "command_request"]

log = structlog.get_logger("rcp.triggers")
FIRINGS = "/system/firings"
_TRIGGERS = "/system/triggers"


class Actions:
    """Carries out what triggers want; everything is on record."""

    def __init__(
        self,
        host: FeatureHost,
        rights: TriggerRights,
        outbox: Outbox,
        alarms: Alarms,
        changed: Callable[[], None],
    ) -> None:
        self._host = host
        self._rights = rights
        self._outbox = outbox
        self._alarms = alarms
        self._changed = changed
        self._store = host.store("state")
        self.counts = {"fired": 0, "limited": 0, "suppressed": 0, "command_failed": 0}

    def load(self) -> dict[str, StoredState]:
        """Return what earlier runs kept, by trigger and robot."""
        found: dict[str, StoredState] = {}
        for key, row in self._store.load().items():
            try:
                found[key] = msgspec.convert(row, StoredState)
            except msgspec.ValidationError as error:
                log.warning("trigger_state_unreadable", key=key, error=str(error))
                self._store.put(key, None)
        return found

    def drop(self, key: str) -> None:
        """Delete the stored state of a trigger on a robot."""
        self._store.put(key, None)

    def forget(self, trigger: Trigger) -> None:
        """Delete the stored state of a removed trigger."""
        for place in trigger.robots:
            self.drop(f"{trigger.key} {place.key}")
        self._alarms.removed(trigger.key)

    def apply(self, transition: Transition) -> None:
        """Carry out the outcome of an evaluation."""
        trigger, robot, outcome, values = transition
        match outcome:
            case "fire":
                self._fire(trigger, robot, _plain(values))
            case "clear":
                self._clear(trigger, robot, _plain(values))
            case "suppress":
                robot.kept.active, robot.kept.told = True, False
                self._suppress(robot, "suppressed")
        robot.moved(self._host.clock.now())
        self._keep(trigger, robot)
        self._changed()

    def announce(
        self, trigger: Trigger, what: Literal["stopped", "resumed"], detail: str | None
    ) -> None:
        """Report that a trigger stopped or resumed, also to the targets of its messages."""
        told = [
            self._firing(trigger, robot, what, detail=detail) for robot in trigger.robots.values()
        ]
        for firing in told:
            self._tell(trigger, firing)
        type_: NoticeType = "trigger.stopped" if what == "stopped" else "trigger.resumed"
        for firing in told[:1]:  # one message, however many robots
            notice = _notice(msgspec.structs.replace(firing, robot=trigger.spec.robot))
            for target in trigger.spec.notify:
                self._outbox.add(target, type_, notice)

    def unfinished(self, trigger: Trigger, robot: OnRobot) -> None:
        """Tell of a command for whose end nobody waited; it may have been carried out, or not sent."""
        id_ = robot.kept.command
        if id_ is None:
            return
        firing = msgspec.structs.replace(self._firing(trigger, robot, "fired"), id=id_)
        detail = (
            "the gateway was restarted, or the trigger changed, before the command had ended. It is "
            "not sent again: see what the robot does"
        )
        self._ended(trigger, robot, firing, "unknown", detail)

    # -- firing --------------------------------------------------------------------------------

    def _fire(self, trigger: Trigger, robot: OnRobot, values: dict[str, Any]) -> None:
        kept = robot.kept
        kept.active, kept.fired = True, self._host.clock.now()
        if not robot.budget.take(self._host.loop.time()):
            kept.told = False
            self._suppress(robot, "limited")
            if not robot.limited:
                robot.limited = True
                detail = (
                    "it fires more often than `per_minute` allows; until that ends it is silent"
                )
                self._tell(trigger, self._firing(trigger, robot, "limited", detail=detail))
            return
        robot.limited = False
        kept.told, kept.firings = True, kept.firings + 1
        self.counts["fired"] += 1
        firing = self._firing(trigger, robot, "fired", values=values)
        if trigger.spec.alarm:
            with _apart(trigger, "alarm"):
                kept.alarm = self._alarms.fired(trigger.key, firing)
                firing = msgspec.structs.replace(firing, alarm=kept.alarm)
        for target in trigger.spec.notify:
            with _apart(trigger, "notify"):
                self._outbox.add(target, "trigger.fired", _notice(firing))
        if trigger.spec.incident:
            with _apart(trigger, "incident"):
                firing = self._record(firing)
        with _apart(trigger, "record"):
            self._tell(trigger, firing)
        if trigger.spec.execute is not None:
            self._command(trigger, robot, firing, trigger.spec.execute)

    def _clear(self, trigger: Trigger, robot: OnRobot, values: dict[str, Any]) -> None:
        kept = robot.kept
        told, kept.active, kept.told = kept.told, False, False
        self._alarms.cleared(trigger.key, robot.place.key)
        if not told:
            return
        firing = self._firing(trigger, robot, "cleared", values=values)
        if trigger.spec.alarm:
            firing = msgspec.structs.replace(firing, alarm=kept.alarm)
        if trigger.spec.notify_cleared:
            for target in trigger.spec.notify:
                self._outbox.add(target, "trigger.cleared", _notice(firing))
        self._tell(trigger, firing)

    def _suppress(self, robot: OnRobot, why: str) -> None:
        robot.suppressed += 1
        self.counts[why] += 1

    def _record(self, firing: Firing) -> Firing:
        incidents = self._host.service(INCIDENTS)
        reason = f"trigger {firing.trigger}: {firing.message}"
        if incidents is not None and incidents.record(firing.robot, reason):
            return firing
        return msgspec.structs.replace(firing, detail="nothing of the robot is in the black box")

    # -- commands ------------------------------------------------------------------------------

    def _command(self, trigger: Trigger, robot: OnRobot, firing: Firing, do: Do) -> None:
        if robot.command is not None and not robot.command.done() and do.path != ESTOP:
            self._ended(trigger, robot, firing, "busy", "its previous command is still running")
            return
        robot.kept.command = firing.id
        work = self._run(trigger, robot, firing, do)
        robot.command = self._host.loop.create_task(work, name=f"trigger {trigger.name}")

    async def _run(self, trigger: Trigger, robot: OnRobot, firing: Firing, do: Do) -> None:
        """Send a command with the rights that its maker has now, and wait for its end.

        Not before the firing is in the store: after a crash the command is not sent again. An e-stop
        waits for nothing.
        """
        if do.path != ESTOP:
            await stored(self._store, self._host.loop)
        try:
            reply = await self.send(trigger, robot, do, key=firing.id)
        except RcpError as error:
            self._ended(trigger, robot, firing, error.code, answer=error.message)
            return
        except Exception as error:
            log.exception("trigger_command_failed", trigger=trigger.name)
            self._ended(trigger, robot, firing, "internal", type(error).__name__)
            return
        if reply.error is None:
            self._ended(trigger, robot, firing, reply.status, answer=reply.message)
        else:
            code, message = reply.error["code"], reply.error["message"]
            self._ended(trigger, robot, firing, code, answer=message)

    async def send(
        self, trigger: Trigger, robot: OnRobot, do: Do, *, key: str | None = None
    ) -> Reply:
        """Send a command in the name of a trigger's maker; without a key it is a dry run.

        :raises RcpError: its maker has no rights any more, or the command has no path.
        """
        delegation, maker, loop = self._host.delegation, trigger.maker, self._host.loop
        assert maker is not None
        principal = delegation.renewed(maker)
        if principal is None:
            raise TokenExpired(f"the credentials of {maker.name} are no longer valid")
        session = delegation.session(principal, robot.place.tenant, TRANSPORT)
        request = command_request(do, robot, key)
        final: asyncio.Future[Reply] = loop.create_future()

        def answer(reply: Reply) -> None:
            if reply.final and not final.done():
                final.set_result(reply)

        delegation.send(session, request, answer)
        return await final

    def _ended(
        self,
        trigger: Trigger,
        robot: OnRobot,
        firing: Firing,
        outcome: str,
        detail: str | None = None,
        *,
        answer: str | None = None,
    ) -> None:
        """Tell of the end of a command; of an `answer`, which says what its maker may know, to nobody else."""
        robot.outcome, robot.detail, robot.answer = outcome, detail, answer
        if robot.kept.command == firing.id:
            robot.kept.command = None
            self._keep(trigger, robot)
        if outcome != "completed":
            self.counts["command_failed"] += 1
            log.warning(
                "trigger_command", trigger=trigger.name, outcome=outcome, detail=detail or answer
            )
        told = msgspec.structs.replace(
            firing,
            what="command",
            time=iso(self._host.clock.now()),
            values={},
            outcome=outcome,
            detail=detail,
        )
        self._tell(trigger, told)
        self._changed()

    # -- records -------------------------------------------------------------------------------

    def _firing(
        self,
        trigger: Trigger,
        robot: OnRobot,
        what: Any,
        *,
        values: dict[str, Any] | None = None,
        detail: str | None = None,
    ) -> Firing:
        spec, place = trigger.spec, robot.place
        paths = self._rights.paths(trigger.conditions.all, place)
        if spec.execute is not None and not spec.execute.path.startswith("/system/"):
            paths = (*paths, command_for(spec.execute, place)[0])
        return Firing(
            id=f"fi-{secrets.token_hex(8)}",
            time=iso(self._host.clock.now()),
            trigger=trigger.name,
            tenant=place.tenant,
            robot=place.key,
            what=what,
            severity=spec.severity,
            message=spec.text,
            condition=spec.when,
            values=values or {},
            detail=detail,
            by=None if trigger.maker is None else trigger.maker.name,
            paths=tuple(dict.fromkeys(paths)),
        )

    def _tell(self, trigger: Trigger, firing: Firing) -> None:
        self._host.publish(FIRINGS, firing)
        self._host.note(
            "trigger",
            principal=trigger.maker,
            tenant=firing.tenant,
            path=_TRIGGERS,
            touches=firing.paths,
            outcome=firing.outcome or firing.what,
            trigger=firing.trigger,
            firing=firing.id,
            robot_path=firing.robot,
            condition=firing.condition,
            message=firing.detail or firing.message,
            alarm=firing.alarm,
            targets=list(trigger.spec.notify) or None if firing.what == "fired" else None,
        )

    def _keep(self, trigger: Trigger, robot: OnRobot) -> None:
        self._store.put(f"{trigger.key} {robot.place.key}", to_plain(robot.kept))


@contextmanager
def _apart(trigger: Trigger, part: str) -> Generator[None]:
    """Keep a failure of one part of a firing from the others: the command may be a stop."""
    try:
        yield
    except Exception:
        log.exception("trigger_part_failed", trigger=trigger.name, part=part)


def command_request(do: Do, robot: OnRobot, key: str | None) -> Request:
    """Return the request of a command; without a key it is a dry run.

    :raises RcpError: it has no valid path for the robot.
    """
    path, value = command_for(do, robot.place)
    body = msgspec.Raw(dump(value, Encoding.JSON)) if value is not None else msgspec.Raw()
    return Request(type="execute", path=path, body=body, idempotency_key=key, dry_run=key is None)


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """Return values short enough for a message."""
    return {name: value if len(repr(value)) <= 500 else "…" for name, value in values.items()}


def _notice(firing: Firing) -> Notice:
    return Notice(
        firing=firing.id,
        trigger=firing.trigger,
        tenant=firing.tenant,
        robot=firing.robot,
        severity=firing.severity,
        message=firing.message,
        condition=firing.condition,
        values=firing.values,
        alarm=firing.alarm,
        by=firing.by,
        detail=firing.detail if firing.what == "stopped" else None,
    )
