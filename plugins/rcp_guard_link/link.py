"""The gateway's side of the guard: arming, heartbeat, and handling of stops by the guard.

The heartbeat is sent from the event loop, so it stops whenever the loop is blocked. A backend is
armed from before the first command that may move it until it is measured at rest, and while an
e-stop is latched. See `rcp_guard` for the other side.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Container, Iterable, Sequence
from contextlib import suppress
from typing import Any

import msgspec
import structlog
from prometheus_client.core import Metric

from rcp_guard_link.arming import GuardArming
from rcp_kernel.access.acl import Rights
from rcp_kernel.contract.metrics import counter, gauge
from rcp_kernel.features import FeatureHost, StatusPart
from rcp_kernel.features.robots import SupervisedBackend
from rcp_kernel.tree.entry import Owner

__all__ = ["GuardLink"]

log = structlog.get_logger("rcp.guard")
_LINGER = 1.0  # s that a backend stays armed after its last command: it takes time to brake
_UNKNOWN = 30.0  # s that it stays armed if its state of motion is unknown
_SETTLE = 10.0  # s that a backend has to verify its watchdogs before their lack is a warning
_HOLD = 10.0  # s that a robot is commanded to rest after a stop by the guard


class GuardLink:
    """Arms and feeds the guard, and says in the status what stops each robot without the gateway."""

    def __init__(self, arming: GuardArming, host: FeatureHost) -> None:
        self._arming = arming
        self._process = arming.process
        self._on = arming.on
        self._host = host
        self._backends = host.robots.backends
        self._control = host.control
        self._loop = host.loop
        arming.process.on_report.append(self._on_report)
        self._plans: dict[str, dict[str, Any]] = {}
        self._seen: list[tuple[str, int]] = []
        self._senders: dict[str, tuple[str, str]] = {}
        self._ready: dict[SupervisedBackend, float] = {}
        self._warned: set[tuple[str, str | None]] = set()
        self._holds: set[asyncio.Task[None]] = set()
        self._timer: asyncio.TimerHandle | None = None
        self.lag = 0.0
        """The most that the event loop was late, s."""
        self.stops = 0
        """Number of times the guard has stopped robots."""

    # -- the heartbeat ---------------------------------------------------------------------------

    def start(self) -> None:
        """Begin the heartbeat."""
        self._next()

    async def close(self) -> None:
        """End the heartbeat with a goodbye: the robots were brought to rest, nothing is sent."""
        if self._timer is not None:
            self._timer.cancel()
        self._arming.expected = float("inf")
        for task in self._holds:
            task.cancel()
        await self._process.close()

    def _next(self) -> None:
        self._arming.expected = self._loop.time() + self._arming.period
        self._timer = self._loop.call_at(self._arming.expected, self._beat)

    def _beat(self) -> None:
        self._arming.look_for_freeze()
        late = self._loop.time() - self._arming.expected
        self.lag = max(self.lag, late)
        if late > self._arming.after and self._arming.armed:
            log.error("loop_stood_still", seconds=round(late, 3), armed=sorted(self._arming.armed))
        self._next()
        try:
            self._look()
            commanded = self._commanded()
            self._arming.armed = frozenset(
                supervisor.name
                for supervisor in self._backends
                if self._may_move(supervisor, commanded)
            )
        except Exception:  # a heartbeat that fails would have the robots stopped
            log.exception("guard_link_failed")
        self._process.beat(self._arming.armed)

    def _look(self) -> None:
        """Update changed plans, and warn of robots that nothing would stop."""
        seen = self._counts()
        if self._on and seen != self._seen:
            self._seen = seen
            self._arming.moved = {
                supervisor: at
                for supervisor, at in self._arming.moved.items()
                if supervisor in self._backends
            }
            self._ready = {
                supervisor: at
                for supervisor, at in self._ready.items()
                if supervisor in self._backends
            }
            self._replace(dict(self._plans_now()))
        for supervisor in self._backends:
            if supervisor not in self._ready:
                if supervisor.backend is not None:
                    self._ready[supervisor] = self._loop.time()
            elif self._loop.time() - self._ready[supervisor] > _SETTLE:
                self._warn(supervisor)

    def _counts(self) -> list[tuple[str, int]]:
        """Return how often the plans of each backend have changed."""
        return [(supervisor.name, supervisor.plans_changed) for supervisor in self._backends]

    def _replace(self, plans: dict[str, dict[str, Any]]) -> None:
        held = self._plans
        if plans == held:
            return
        same = {name for name, plan in plans.items() if held.get(name) == plan}
        self._senders = {name: report for name, report in self._senders.items() if name in same}
        self._plans = plans
        self._process.replace_plans(plans)

    def _plans_now(self) -> Iterable[tuple[str, dict[str, Any]]]:
        for supervisor in self._backends:
            for name, plan in supervisor.plans.items():
                try:
                    plain = json.loads(json.dumps(msgspec.structs.asdict(plan)))
                except (TypeError, ValueError) as error:
                    supervisor.fault(f"the stop plan '{name}' is not plain data: {error}")
                    continue
                yield f"{supervisor.name}/{name}", {"group": supervisor.name, **plain}

    def _may_move(self, supervisor: SupervisedBackend, commanded: Container[Owner]) -> bool:
        if any(unit.latch is not None for unit in supervisor.units):
            return True
        moved = self._arming.moved.get(supervisor)
        if moved is None:
            return False
        now = self._loop.time()
        if supervisor in commanded:
            self._arming.moved[supervisor] = now
            return True
        if now - moved > _LINGER and self._rests(supervisor, now - moved):
            del self._arming.moved[supervisor]
            return False
        return True

    def _commanded(self) -> set[Owner]:
        """Return the backends with a value in force or a motion under way, in one walk for all."""
        if not self._arming.moved:
            return set()
        entries, control = self._host.robots.entries, self._control
        found = {entries[path].owner for path in control.in_force if path in entries}
        for command in control.running():
            entry = command.entry
            if entry is not None and entry.barred:
                found.add(entry.owner)
        return found

    def _rests(self, supervisor: SupervisedBackend, since: float) -> bool:
        """Return whether a backend is at rest: as measured, or else as far as can be known."""
        backend, state = supervisor.backend, None
        if backend is not None:
            with suppress(Exception):
                state = backend.motion(None)
        if state is not None and state.at_rest is not None:
            return state.at_rest
        if any(self._control.is_in_force(entry) for entry in supervisor.entries.values()):
            return False
        measures_nothing = backend is not None and state is None
        return measures_nothing or since > _UNKNOWN

    # -- messages from the guard -----------------------------------------------------------------

    def _on_report(self, message: dict[str, Any]) -> None:
        match message:
            case {"event": "sender", "plan": str(plan), "state": str(state), "detail": str(detail)}:
                self._senders[plan] = state, detail
                if state in ("failed", "missing"):
                    backend = self._plans.get(plan, {}).get("group")
                    log.warning("guard_sender", backend=backend, plan=plan, reason=detail)
            case {"event": "stopped", "groups": [*groups], "reason": str(reason)}:
                self.stops += 1
                for supervisor in self._backends:
                    if supervisor.name in groups and supervisor.plans:
                        log.error("guard_stopped_robot", backend=supervisor.name, reason=reason)
                        self._end_commands(supervisor, reason)
            case {"event": "released", "reason": str(reason)}:
                log.warning("guard_released_robots", reason=reason)
            case {"event": "ended"}:
                self._senders.clear()
            case _:
                pass

    def _end_commands(self, backend: SupervisedBackend, reason: str) -> None:
        """End the commands of a backend stopped by the guard: nothing may resume by itself."""
        if self._host.closing:
            return
        self._host.note("guard", principal=None, tenant=backend.tenant, robots=[backend.name])
        hold = self._control.end_stopped(backend, f"the guard stopped the robot: {reason}")
        if hold is not None:
            self._holds.add(hold)
            hold.add_done_callback(self._holds.discard)
            self._loop.call_later(_HOLD, hold.cancel)

    # -- the status ------------------------------------------------------------------------------

    @property
    def state(self) -> str:
        """Return the state: `off`, `idle` (no plans), `starting`, `ready`, `degraded`."""
        if not self._on:
            return "off"
        if self._counts() != self._seen:
            return "starting"  # the guard is about to have other plans
        if not self._plans:
            return "idle"
        if not self._process.running:
            return "degraded" if self._process.restarts else "starting"
        states = {self._senders.get(name, ("opening", ""))[0] for name in self._plans}
        if states & {"failed", "missing", "waiting"}:
            return "degraded"
        return "starting" if "opening" in states else "ready"

    def status(self, rights: Rights | None) -> StatusPart:
        """Write the part of `/system/status` about the backends that a principal sees as a whole."""
        sees = self._host.visibility.sees_backend
        shown = [
            one for one in self._backends if rights is None or sees(rights, one.tenant, one.name)
        ]
        names = {supervisor.name for supervisor in shown}
        plans: list[dict[str, Any]] = []
        for name, plan in self._plans.items():
            if plan["group"] in names:
                state, detail = self._senders.get(name, ("opening", ""))
                own = {"backend": plan["group"], "name": name.partition("/")[2]}
                sender = {"sender": plan["sender"], "state": state, "detail": detail or None}
                plans.append(own | sender)
        facts = {
            "state": self.state,
            "armed": not names.isdisjoint(self._arming.armed),
            "stops": self.stops,
            "plans": plans,
            "watchdogs": [
                {"backend": supervisor.name, **msgspec.to_builtins(watchdog)}
                for supervisor in shown
                for watchdog in _watchdogs(supervisor)
            ],
        }
        return StatusPart({"guard": facts})

    def metrics(self) -> Iterable[Metric]:
        """Return the families of `/metrics`."""
        yield counter(
            "rcp_guard_stops", "How often the guard has stopped robots.", (), [([], self.stops)]
        )
        for name, text, value in (
            (
                "rcp_event_loop_lag_max_seconds",
                "The most that the event loop was late.",
                self.lag,
            ),
            (
                "rcp_guard_ready",
                "Whether the guard is ready to send every plan, or has none.",
                self.state in ("ready", "idle"),
            ),
        ):
            yield gauge(name, text, (), [([], float(value))])

    def _warn(self, supervisor: SupervisedBackend) -> None:
        if (supervisor.plans and self._on) or supervisor.has_gateways:
            return
        verified = [
            one for one in _watchdogs(supervisor) if one.verified and one.within is not None
        ]
        for unit in supervisor.units:
            key = supervisor.name, unit.robot
            moves = any(entry.moves for entry in unit.own.values())
            stopped = any(one.robot in (None, unit.robot) for one in verified)
            if moves and not stopped and key not in self._warned:
                self._warned.add(key)
                named = {} if unit.robot_segment is None else {"robot": unit.robot_segment}
                log.warning(
                    "robot_without_watchdog",
                    backend=supervisor.name,
                    **named,
                    detail="no known watchdog or guard plan stops it if the gateway freezes or "
                    "is killed",
                )


def _watchdogs(supervisor: SupervisedBackend) -> Sequence[Any]:
    backend = supervisor.backend
    if backend is None:
        return ()
    try:
        return backend.watchdogs()
    except Exception as error:
        supervisor.fault(f"watchdogs: {error}")
        return ()
