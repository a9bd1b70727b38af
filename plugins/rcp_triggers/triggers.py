"""All triggers: those of the configuration, and those made at run time, which the store keeps."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator, Mapping
from typing import Any

import msgspec
import structlog

from rcp_kernel.contract.identity import Principal
from rcp_kernel.errors import ConfigError, RcpError
from rcp_kernel.features import FeatureHost
from rcp_kernel.tree.entry import Entry
from rcp_kernel.values import to_plain
from rcp_triggers.authenticator import principal_of
from rcp_triggers.config import Rule
from rcp_triggers.firing import Actions
from rcp_triggers.place import Place, place_of
from rcp_triggers.rights import TriggerRights
from rcp_triggers.spec import Spec
from rcp_triggers.trigger import StoredState, Transition, Trigger
from rcp_triggers.watch import LOOK

__all__ = ["Triggers"]

log = structlog.get_logger("rcp.triggers")
_SETTLE = 0.05  # s after which new robots are looked at: their resources come one by one


class _Row(msgspec.Struct, kw_only=True):
    """A trigger made at run time, as the store keeps it."""

    name: str
    tenant: str
    spec: Spec
    maker: Principal
    made: int


class Triggers:
    """Creates triggers, gives them robots, and stops those whose makers lost their rights."""

    def __init__(
        self,
        host: FeatureHost,
        rights: TriggerRights,
        actions: Actions,
        per_minute: float,
        changed: Callable[[], None],
    ) -> None:
        self._host = host
        self._rights = rights
        self._actions = actions
        self.per_minute = per_minute
        self._changed = changed
        self._store = host.store("triggers")
        self.known: dict[str, Trigger] = {}
        """By key: the name for those of the configuration, else tenant and name."""
        self._kept: dict[str, StoredState] = {}
        self._places: dict[Place, None] = {}
        self._due: asyncio.TimerHandle | None = None
        self._look: asyncio.TimerHandle | None = None
        self._open = False
        self._sweeping = False

    # -- life ----------------------------------------------------------------------------------

    def open(self, rules: Mapping[str, Rule]) -> None:
        """Load what the store has, and begin."""
        self._kept, self._open = self._actions.load(), True
        robots = self._host.robots
        robots.follow(self._added, _ignore)
        for entry in list(robots.entries.values()):
            self._added(entry)
        for key, row in self._store.load().items():
            try:
                made = msgspec.convert(row, _Row)
                self._add(self._made(key, made))
            except (msgspec.ValidationError, ConfigError, RcpError) as error:
                log.warning("trigger_unreadable", trigger=key, error=str(error))
        self.configure(rules)
        for key in [key for key in self._kept if key.partition(" ")[0] not in self.known]:
            self._actions.drop(key)
        self._look = self._host.loop.call_later(LOOK, self._sweep)

    def close(self) -> None:
        """End all; what is made stays in the store."""
        self._open = False
        for timer in (self._due, self._look):
            if timer is not None:
                timer.cancel()
        for trigger in self.known.values():
            trigger.close()

    def configure(self, rules: Mapping[str, Rule]) -> None:
        """Apply the triggers of a configuration; one that is as before goes on."""
        for key, trigger in [*self.known.items()]:
            if trigger.configured and rules.get(key) != trigger.given:
                trigger.close()
                del self.known[key]
                if key not in rules:
                    self._actions.forget(trigger)
                else:  # what it was in goes on, as after a restart
                    self._kept |= {
                        f"{key} {place.key}": robot.kept for place, robot in trigger.robots.items()
                    }
        for name, rule in rules.items():
            if name not in self.known:
                self._add(
                    Trigger(
                        name,
                        name,
                        rule,
                        principal_of(name, rule),
                        self._host,
                        self._on_transition,
                        configured=True,
                    )
                )
        self._use()

    # -- made at run time ----------------------------------------------------------------------

    def make(self, name: str, tenant: str, spec: Spec, maker: Principal) -> Trigger:
        """Create a trigger."""
        key = f"{tenant}/{name}"
        row = _Row(name=name, tenant=tenant, spec=spec, maker=maker, made=self._host.clock.now())
        trigger = self._made(key, row)
        row.spec = trigger.spec
        self._store.put(key, to_plain(row))
        self._add(trigger)
        self._use()
        return trigger

    def remove(self, trigger: Trigger) -> None:
        """End a trigger that was made at run time."""
        trigger.close()
        del self.known[trigger.key]
        self._store.put(trigger.key, None)
        self._actions.forget(trigger)
        self._use()

    def _made(self, key: str, row: _Row) -> Trigger:
        return Trigger(
            key,
            row.name,
            row.spec,
            row.maker,
            self._host,
            self._on_transition,
            configured=False,
            made=row.made,
        )

    def _add(self, trigger: Trigger) -> None:
        self.known[trigger.key] = trigger
        exact = trigger.conditions.robots.exact
        for place in [*([exact] if exact else []), *self._places]:
            self._take_in(trigger, place)
        self._check(trigger)

    def _take_in(self, trigger: Trigger, place: Place) -> None:
        if trigger.wants(place):
            kept = self._kept.pop(f"{trigger.key} {place.key}", None) or StoredState()
            trigger.add(place, kept, self.per_minute)
            self._actions.unfinished(trigger, trigger.robots[place])

    def _use(self) -> None:
        """Keep published what the conditions need."""
        every = [one for trigger in self.known.values() for one in trigger.conditions.all]
        self._host.robots.conditions.use(every)
        self._changed()

    # -- what happens --------------------------------------------------------------------------

    def _added(self, entry: Entry) -> None:
        place = place_of(entry)
        if place is None or place in self._places:
            return
        self._places[place] = None
        if self._open and self._due is None:
            self._due = self._host.loop.call_later(_SETTLE, self._take_all_in)

    def _take_all_in(self) -> None:
        self._due = None
        for trigger in self.known.values():
            for place in self._places:
                self._take_in(trigger, place)
        self._changed()

    def _on_transition(self, transition: Transition) -> None:
        trigger = transition.trigger
        if self._open and self.known.get(trigger.key) is trigger and self._check(trigger):
            self._actions.apply(transition)

    def _sweep(self) -> None:
        """Look at what no sample announces: values that become stale, credentials that expire."""
        self._look = self._host.loop.call_later(LOOK, self._sweep)
        if not self._sweeping:  # with many robots, a sweep may take longer than `LOOK`
            self._sweeping = True
            self._host.in_steps(self._swept())

    def _swept(self) -> Generator[None]:
        moved, now = False, self._host.clock.now()
        try:
            for trigger in [*self.known.values()]:
                self._check(trigger)
                for robot in [*trigger.robots.values()]:
                    late = self._host.loop.time() - robot.watch.looked
                    if trigger.stopped is None and late >= LOOK / 2:
                        robot.watch.look()
                    moved = robot.moved(now) or moved
                    yield
        finally:
            self._sweeping = False
        if moved:
            self._changed()

    def rights_changed(self) -> None:
        """Check whether the makers of all triggers may still have them."""
        for trigger in self.known.values():
            self._check(trigger)

    def _check(self, trigger: Trigger) -> bool:
        """Stop a trigger whose maker lost a right, or go on; return whether it runs."""
        maker = trigger.maker
        if maker is None or trigger.configured:
            return True
        reason = None
        for place in trigger.robots:
            paths = self._rights.paths(trigger.conditions.all, place)
            reason = reason or self._rights.stopped(maker, place.tenant, paths)
        if (reason is None) == (trigger.stopped is None):
            return reason is None
        if reason is not None:
            trigger.stop(reason)
            log.warning("trigger_stopped", trigger=trigger.name, reason=reason)
            self._actions.announce(trigger, "stopped", reason)
        else:
            trigger.resume()
            self._actions.announce(trigger, "resumed", None)
        self._changed()
        return reason is None

    @property
    def places(self) -> list[Place]:
        """The robots that there are, or were."""
        return [*self._places]

    def counts(self) -> dict[str, int]:
        """Count triggers on robots by state."""
        found = {"clear": 0, "pending": 0, "active": 0, "unknown": 0, "stopped": 0}
        for trigger in self.known.values():
            for robot in trigger.robots.values():
                state: Any = robot.watch.machine.state
                if trigger.stopped is not None:
                    state = "stopped"
                elif robot.watch.known is None and state != "active":
                    state = "unknown"
                found[state] += 1
        return found


def _ignore(_: object) -> None:
    """Go on: a robot that is withdrawn is unknown."""
