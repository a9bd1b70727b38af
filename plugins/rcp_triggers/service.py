"""`/system/triggers`: what each reader sees of it, and requests."""

from __future__ import annotations

from collections.abc import Coroutine, Iterable, Iterator, Mapping
from typing import Any

from rcp_conditions import ConditionsMissing
from rcp_kernel.clock import iso
from rcp_kernel.contract.identity import Principal
from rcp_kernel.errors import (
    ConfigError,
    Forbidden,
    InvalidValue,
    ModeForbids,
    NotImplementedByRobot,
    QueueFull,
    RcpError,
    UnknownPath,
)
from rcp_kernel.features import FeatureHost
from rcp_kernel.features.choice import chosen
from rcp_kernel.features.incidents import INCIDENTS
from rcp_kernel.model import Operation
from rcp_kernel.sessions.session import Session
from rcp_kernel.values import to_plain
from rcp_triggers.config import Target
from rcp_triggers.firing import Actions
from rcp_triggers.messages import (
    NewTrigger,
    TestResult,
    TriggerReply,
    TriggerRequest,
)
from rcp_triggers.place import Place
from rcp_triggers.rights import TriggerRights
from rcp_triggers.spec import Conditions, Spec
from rcp_triggers.trigger import OnRobot, Trigger
from rcp_triggers.triggers import Triggers

__all__ = ["TRIGGERS", "TriggerService"]

TRIGGERS = "/system/triggers"
_LASTING = ("key", "token", "certificate", "none")
"""Proofs that are as good after a restart."""


class TriggerService:
    """Makes, removes and tests triggers, and shows them to whoever may read what they are about."""

    def __init__(
        self,
        triggers: Triggers,
        rights: TriggerRights,
        actions: Actions,
        host: FeatureHost,
        targets: Mapping[str, Target],
        most: int,
    ) -> None:
        self._triggers = triggers
        self._rights = rights
        self._actions = actions
        self._host = host
        self.targets = targets
        self.most = most

    # -- seeing --------------------------------------------------------------------------------

    def view(self, session: Session) -> Iterator[dict[str, Any] | None]:
        """List triggers with the robots that a session may read, by name."""
        for _, trigger in sorted(self._triggers.known.items()):
            robots = self._seen(session, trigger)
            if robots is not None:
                yield to_plain(trigger.state(robots, session.principal))
            yield None

    def _seen(self, session: Session, trigger: Trigger) -> list[OnRobot] | None:
        """Return the robots on which a session may see a trigger; None if it may not see it."""
        rights, judge = session.rights, self._rights
        held = rights.places(TRIGGERS, Operation.READ)
        facts = [to_plain(trigger.spec), trigger.stopped]
        seen = [
            robot
            for place, robot in trigger.robots.items()
            if ("*" in held or place.tenant in held)
            and judge.sees(rights, place.tenant, judge.paths(trigger.conditions.all, place), facts)
        ]
        if seen:
            return seen
        tenant = trigger.conditions.robots.tenant
        return [] if not trigger.robots and ("*" in held or tenant in held) else None

    # -- requests ------------------------------------------------------------------------------

    def execute(self, session: Session, wanted: TriggerRequest, *, dry_run: bool) -> Any:
        """Add, remove or test.

        :raises RcpError: it is refused.
        """
        chosen(wanted, TRIGGERS)
        if wanted.add is not None:
            return self._add(session, wanted.add, dry_run=dry_run)
        if wanted.remove is not None:
            return self._remove(session, wanted.remove, dry_run=dry_run)
        return self._test(session, wanted.test or "")

    def _add(self, session: Session, wanted: NewTrigger, *, dry_run: bool) -> TriggerReply:
        try:
            conditions = Conditions(wanted)
        except ConditionsMissing as error:
            raise NotImplementedByRobot(
                "this gateway does not evaluate conditions", path=TRIGGERS, remedy=error.remedy
            ) from None
        except (ConfigError, RcpError) as error:
            raise InvalidValue(str(error), path=TRIGGERS) from None
        tenant = conditions.robots.tenant
        if tenant == "*" or not self._rights.in_tenant(
            session.rights, tenant, Operation.EXECUTE, TRIGGERS
        ):
            raise Forbidden(
                f"{session.principal.name} may not make triggers there",
                path=TRIGGERS,
                remedy="Name a robot of your own tenant: /tenant/<tenant>/<robot>.",
            )
        self._check_room(session, tenant, wanted.name)
        self._check_actions(wanted, tenant)
        self._check_robots(session, wanted, conditions)
        if not dry_run:
            trigger = self._triggers.make(wanted.name, tenant, wanted, session.principal)
            self._note(session, trigger, "added")
        return TriggerReply(did="added", trigger=wanted.name, ends=_end_of(session.principal))

    def _check_room(self, session: Session, tenant: str, name: str) -> None:
        known = self._triggers.known
        configured = known.get(name)
        seen = configured is not None and self._seen(session, configured) is not None
        if seen or f"{tenant}/{name}" in known:
            raise ModeForbids(
                f"there is a trigger '{name}' already",
                path=TRIGGERS,
                remedy="Choose another name, or remove it first.",
            )
        own = (t for t in known.values() if not t.configured and t.maker is not None)
        identity = session.principal.identity
        if sum(t.maker is not None and t.maker.identity == identity for t in own) >= self.most:
            raise QueueFull(
                f"{session.principal.name} has {self.most} triggers",
                path=TRIGGERS,
                remedy="Remove one first.",
            )

    def _check_actions(self, spec: Spec, tenant: str) -> None:
        for name in spec.notify:
            target = self.targets.get(name)
            if target is None or ("*" not in target.tenants and tenant not in target.tenants):
                raise InvalidValue(
                    f"there is no target '{name}' for {tenant}",
                    path=TRIGGERS,
                    remedy="Use a name from [features.triggers.targets] of the gateway.",
                )
        if spec.incident and self._host.service(INCIDENTS) is None:
            raise NotImplementedByRobot(
                "there is no black box to write",
                path=TRIGGERS,
                remedy="Have [features.recorder.black_box] configured, or leave `incident` out.",
            )

    def _check_robots(self, session: Session, spec: Spec, conditions: Conditions) -> None:
        """Refuse what fits none of the robots that it names."""
        refused: RcpError | None = None
        for place in self._places(session, conditions):
            try:
                self._rights.check_reads(session, conditions.all, place)
                if spec.execute is not None:
                    self._rights.check_command(session, spec.execute, place)
            except RcpError as error:
                refused = refused or error
            else:
                return
        raise refused or UnknownPath(
            f"no robot is at {spec.robot}",
            path=TRIGGERS,
            remedy="Read /system/robots for their paths.",
        )

    def _places(self, session: Session, conditions: Conditions) -> Iterable[Place]:
        sees = self._host.visibility.sees_robot
        for place in self._triggers.places:
            if conditions.robots.matches(place) and sees(session.rights, place.key, place.tenant):
                yield place

    def _find(self, session: Session, name: str) -> Trigger:
        """Return a trigger by its name, that of the session's own tenant first."""
        known = self._triggers.known
        keys = [f"{session.tenant}/{name}", name]
        keys += [key for key, trigger in known.items() if trigger.name == name]
        for key in keys:
            trigger = known.get(key)
            if trigger is not None and self._seen(session, trigger) is not None:
                return trigger
        raise UnknownPath(
            f"there is no trigger '{name[:64]}'", path=TRIGGERS, remedy=f"Read {TRIGGERS}."
        )

    def _remove(self, session: Session, name: str, *, dry_run: bool) -> TriggerReply:
        trigger = self._find(session, name)
        tenant = trigger.conditions.robots.tenant
        if trigger.configured:
            raise Forbidden(
                f"'{name}' is in the configuration of the gateway",
                path=TRIGGERS,
                remedy=f"Have [features.triggers.rules.{name}] removed, and the file reread.",
            )
        if not self._rights.in_tenant(session.rights, tenant, Operation.EXECUTE, TRIGGERS):
            raise Forbidden(f"{session.principal.name} may not remove it", path=TRIGGERS)
        if not dry_run:
            self._note(session, trigger, "removed")
            self._triggers.remove(trigger)
        return TriggerReply(did="removed", trigger=trigger.name)

    def _test(self, session: Session, name: str) -> Coroutine[Any, Any, TriggerReply]:
        trigger = self._find(session, name)
        own = trigger.is_of(session.principal)
        return self._tested(trigger, self._seen(session, trigger) or [], own=own)

    async def _tested(self, trigger: Trigger, robots: list[OnRobot], *, own: bool) -> TriggerReply:
        results = [await self._result(trigger, robot, own=own) for robot in robots]
        return TriggerReply(did="tested", trigger=trigger.name, robots=results)

    async def _result(self, trigger: Trigger, robot: OnRobot, *, own: bool) -> TestResult:
        spec, watch = trigger.spec, robot.watch
        if trigger.stopped is None:
            watch.look()
        would = [f"notify {name}" for name in spec.notify]
        would += ["raise an alarm"] * spec.alarm + ["record an incident"] * spec.incident
        refused = trigger.stopped
        if spec.execute is not None:
            would.append(f"execute {spec.execute.path}")
            refused = refused or await self._refusal(trigger, robot, own=own)
        return TestResult(
            robot=robot.place.key,
            condition=watch.condition,
            unknown=watch.unknown(),
            values=watch.values(),
            would=would,
            refused=refused,
        )

    async def _refusal(self, trigger: Trigger, robot: OnRobot, *, own: bool) -> str | None:
        """Dry-run the command with the rights of the trigger's maker, who alone gets the words."""
        assert trigger.spec.execute is not None
        try:
            reply = await self._actions.send(trigger, robot, trigger.spec.execute)
        except RcpError as error:
            return error.message if own else error.code
        return None if reply.error is None else str(reply.error["message" if own else "code"])

    def _note(self, session: Session, trigger: Trigger, outcome: str) -> None:
        paths = [
            path
            for place in trigger.robots
            for path in self._rights.paths(trigger.conditions.all, place)
        ]
        self._host.note(
            "trigger",
            principal=session.principal,
            session=session,
            tenant=trigger.conditions.robots.tenant,
            path=TRIGGERS,
            touches=list(dict.fromkeys(paths)),
            outcome=outcome,
            trigger=trigger.name,
            condition=trigger.spec.when,
        )


def _end_of(maker: Principal) -> str | None:
    """Return when a trigger ends with the credentials of its maker; None: not by itself."""
    when: list[str] = []
    if maker.expires is not None:
        when.append(f"at {iso(maker.expires)}")
    if maker.via is not None or maker.proof not in _LASTING:
        when.append("when the gateway restarts")
    if maker.login is not None:
        when.append("when its maker logs out or the login is not used for a while")
    if not when:
        return None
    remedy = "use an API key" if maker.login is None else "send an API key instead of the cookie"
    return (
        f"It stops {' or '.join(when)}, as the credentials of {maker.name} end then: "
        f"{remedy} for one that lasts."
    )
