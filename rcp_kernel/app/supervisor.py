"""One task for each backend: open, ready, degraded, backoff, close. A crash changes a state only.

    declared → opening → ready ⇄ degraded → closing → closed,  and  unavailable, failed

After `NotReady` or a crash the backend is opened again, with backoff; `ConfigError` is final.
Adapters and transports are opened after the backends were started and closed before them, in
reverse; motion is halted, with a bound, before anything closes.
"""

from __future__ import annotations

import asyncio
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from contextvars import Context, copy_context
from typing import Any, Literal

import structlog

from rcp_kernel.app.containment import ContainedBackend, call_contained, contained
from rcp_kernel.clock import iso, now
from rcp_kernel.config.file import BackendConfig
from rcp_kernel.contract.fence import permitted
from rcp_kernel.contract.shutdown import Shutdown
from rcp_kernel.errors import AdapterUnavailable, ConfigError, NotReady, PluginError, RcpError
from rcp_kernel.model import Resource, full_path
from rcp_kernel.requests.commands import Commands
from rcp_kernel.requests.journal import CommandJournal
from rcp_kernel.safety.hold import hold_resource
from rcp_kernel.safety.loss import tell_cut_off
from rcp_kernel.safety.safety_events import SafetyEvents
from rcp_kernel.safety.stop import StopController
from rcp_kernel.sessions.command import Command
from rcp_kernel.spi import (
    Anchor,
    Backend,
    BackendKind,
    BaseBackend,
    FrameTree,
    OwnLeases,
    Publication,
    RobotFacts,
    StopPlan,
)
from rcp_kernel.streams.hub import Hub
from rcp_kernel.tree.entry import BEFORE, Availability, Entry, StopGroup
from rcp_kernel.tree.latches import Latch, Latches
from rcp_kernel.tree.registry import Registry

__all__ = ["BackendSupervisor", "State"]

log = structlog.get_logger("rcp.supervisor")
State = Literal[
    "declared", "opening", "ready", "degraded", "down", "closing", "closed", "unavailable", "failed"
]
_FIRST_RETRY = 0.25  # s
_LAST_RETRY = 10.0  # s
_FAULTS = 1.0  # s between log records of one backend's bad values
_OPENS = ("declared", "opening")
_WORKING = ("ready", "degraded", "closing")
WIRE_STATE: dict[State, Availability] = {
    "declared": "starting",
    "opening": "starting",
    "ready": "ready",
    "degraded": "degraded",
}
"""The states of `/system/status`; every other one is `down` there."""


class BackendSupervisor:
    """One backend of the configuration, over all its lives. It is the `Host` of its plugin."""

    def __init__(
        self,
        config: BackendConfig,
        *,
        registry: Registry,
        hub: Hub,
        commands: Commands,
        journal: CommandJournal,
        latches: Latches,
        stops: StopController,
        events: SafetyEvents,
        shutdown: Shutdown,
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        self.config = config
        self._registry = registry
        self._hub = hub
        self._commands = commands
        self._journal = journal
        self._latches = latches
        self._stops = stops
        self._events = events
        self._shutdown = shutdown
        self._loop = loop
        self.name = config.name
        self.tenant = config.tenant
        self.robot = config.robot
        self.state: State = "declared"
        self.detail: str | None = None
        self.since = now()
        self.last_error: str | None = None
        self.latency: float | None = None
        """Seconds that the last call of the robot took."""
        self.samples = 0
        self.faults = 0
        self.refusals = Counter[str]()
        """How many were refused at the robots' side, by error code."""
        self.plans: dict[str, StopPlan] = {}
        """The mechanisms that stop its robots without the gateway, by name."""
        self.plans_changed = 0
        """Number of changes of these."""
        self._units: dict[str, StopGroup] = {}
        self._recoveries: dict[StopGroup, asyncio.Task[None]] = {}
        self._cut_off: list[Command] = []
        """Commands of an earlier gateway whose loss policy has not been reported yet."""
        self.whole = StopGroup(self, self._latches)
        self.entries: dict[str, Entry] = {}
        self.settled = asyncio.Event()
        """Set once the first attempt to open has ended, well or not."""
        self._backend: ContainedBackend | None = None
        self.backend: Backend | None = None
        """The open backend, or None while there is none that works. Every read looks at it."""
        self._on_loss = BaseBackend.on_loss
        self.has_gateways = BaseBackend.has_gateways
        """Whether each of its robots has a gateway of its own, as the last opening said."""
        self._closing = asyncio.Event()
        self._discovering = False
        self._calls: deque[tuple[Context, Callable[..., object], tuple[Any, ...]]] = deque()
        """What other threads have handed over, each under the context it was handed over in."""
        self._woken = False
        self._logged_at = 0.0
        self._note_growth()

    # -- Owner ---------------------------------------------------------------------------------

    def unit(self, robot: str | None) -> StopGroup:
        """Return a stop group: one of the backend's robots, or all of them."""
        if robot is None:
            return self.whole
        unit = self._units.get(robot)
        if unit is None:
            unit = self._units[robot] = StopGroup(self, self._latches, robot)
            unit.usable_backend = self.backend
            if self._backend is not None and unit.latch is not None:
                self._stops.resume(unit)
        return unit

    @property
    def on_loss(self) -> str:
        """The policy for a robot whose command was lost with its link."""
        return self._on_loss

    @property
    def availability(self) -> Availability:
        """Whether it can be used, in the words of the wire."""
        return WIRE_STATE.get(self.state, "down")

    @property
    def units(self) -> list[StopGroup]:
        """The robots that can be stopped one by one, and all of the backend if more than they move."""
        alone = [unit for unit in self._units.values() if unit.own]
        if not alone or any(entry.moves for entry in self.whole.own.values()):
            alone.append(self.whole)
        return alone

    def unavailable(self) -> RcpError:
        """Return the error that says why there is no backend now."""
        why = f": {self.detail}" if self.detail else ""
        return AdapterUnavailable(
            f"backend '{self.name}' is not connected ({self.state}){why}",
            origin=self.name,
            retry_after=1.0 if self.state in ("opening", "down") else None,
        )

    def state_changed(self) -> None:
        """Announce that the state of one of its robots may have changed."""
        self._registry.state_changed()

    def fault(self, detail: str) -> None:
        """Note a bad value; a stream of them is logged once a second."""
        self.faults += 1
        self.last_error = detail
        if time.monotonic() - self._logged_at > _FAULTS:
            self._logged_at = time.monotonic()
            log.warning("backend_fault", backend=self.name, detail=detail, faults=self.faults)

    # -- Host ----------------------------------------------------------------------------------

    def declare(self, *resources: Resource) -> None:
        """Put resources into the tree."""
        for resource in resources:
            entry = self._registry.declare(self, resource, tenant=self.tenant, robot=self.robot)
            self.entries[resource.name] = entry.unit.own[resource.name] = entry
            if entry.moves:
                self._offer_hold(entry.unit)
                self._find_lost(entry)
            if self.has_gateways and self.backend is not None:
                self._commands.take_up(entry, self.backend)

    def _offer_hold(self, unit: StopGroup) -> None:
        """Add the hold service to a robot that moves, unless it has its own."""
        name = _hold_name(unit.robot)
        if name in self.entries:
            return
        place = self._registry
        path = full_path(self.tenant, self.robot, name)
        if path in place.entries:  # another backend of the same robot offers it for both
            return
        entry = Entry(
            path, hold_resource(name, unit.robot), self, self.tenant, self.robot, place.clock
        )
        entry.is_hold = True
        self.entries[name] = unit.own[name] = place.insert(entry)

    def _find_lost(self, entry: Entry) -> None:
        """Note a command that an earlier gateway began and that the robot may still carry out."""
        cut_off = [c for c in self._journal.interrupted if c.path == entry.path]
        if cut_off:
            for command in cut_off:
                self._journal.interrupted.remove(command)
            self._cut_off += cut_off
            self._tell_cut_off()
            entry.unit.note_lost(entry.path, BEFORE)
            self._stop_or_recover(entry.unit)

    def _tell_cut_off(self) -> None:
        """Add the loss policy to the errors of those commands, once it is known."""
        if self.backend is None:
            return
        for command in self._cut_off:
            tell_cut_off(command, self._on_loss)
            self._journal.keep(command)
        self._cut_off.clear()

    def withdraw(self, *names: str) -> None:
        """Remove resources from the tree; their running commands end."""
        for name in names:
            entry = self.entries.pop(name, None)
            if entry is not None:
                entry.unit.own.pop(name, None)
                gone = AdapterUnavailable(f"the backend withdrew {entry.path}")
                self._commands.interrupt(entry.path, gone)
                self._registry.withdraw(entry.path)
                self._take_hold_back(entry.unit)

    def _take_hold_back(self, unit: StopGroup) -> None:
        """Withdraw the verb of a robot with nothing left that moves."""
        name = _hold_name(unit.robot)
        entry = self.entries.get(name)
        if entry is not None and entry.is_hold and not any(e.moves for e in unit.own.values()):
            self.withdraw(name)

    def publish(self, name: str, value: Any, timestamp: int | None = None) -> None:
        """Hand a value over; an undeclared name is a fault."""
        entry = self.entries.get(name)
        if entry is None:
            self.fault(f"published '{name}', which it did not declare")
            return
        entry.publish(value, timestamp)

    def publish_batch(self, batch: Sequence[Publication]) -> None:
        """Hand values over from any thread."""
        self.call_soon(self._publish_all, batch)

    def _publish_all(self, batch: Sequence[Publication]) -> None:
        for item in batch:
            self.publish(item.name, item.value, item.timestamp)

    def call_soon(self, function: Callable[..., object], *args: Any) -> None:
        """Run a function on the event loop, from any thread; many share one wake-up of the loop.

        :raises RuntimeError: the loop is closed.
        """
        self._calls.append((copy_context(), function, args))
        if not self._woken:
            self._woken = True
            gather = self._hub.flush_scheduler.gather
            try:
                self._loop.call_soon_threadsafe(gather, self._call_all)
            except RuntimeError:
                self._woken = False  # so that every later caller is told as well
                raise

    def _call_all(self) -> None:
        self._woken = False  # first: what comes from now on wakes the loop again
        for _ in range(len(self._calls)):
            context, function, args = self._calls.popleft()
            context.run(self._call, function, *args)

    def _call(self, function: Callable[..., object], *args: Any) -> None:
        try:
            call_contained(function, *args)
        except (Exception, asyncio.CancelledError, GeneratorExit) as error:  # others wait behind it
            self.fault(f"{type(error).__name__}: {error}")
            log.exception("backend_call_failed", backend=self.name)

    def report(self, detail: str | None, *, down: bool = False, robot: str | None = None) -> None:
        """Change the state of an open backend, or of one of its robots."""
        if robot is not None:
            self._report_robot(self.unit(robot), detail, down=down)
            return
        if self._backend is None or self.state not in ("ready", "degraded", "down"):
            return
        if detail is None:
            self._enter("ready", None)
        else:
            self._enter("down" if down else "degraded", detail)
            if down:
                self._interrupt_all(detail)

    def _report_robot(self, unit: StopGroup, detail: str | None, *, down: bool) -> None:
        if self.state not in ("opening", *_WORKING, "down"):
            return
        state: Availability = "ready" if detail is None else "down" if down else "degraded"
        changed = state != unit.state
        unit.state, unit.detail = state, detail
        unit.usable_backend = None if down else self.backend
        if not changed:
            return
        unit.since = now()
        level = log.info if detail is None else log.warning
        level("robot_state", backend=unit.name, state=state, detail=detail)
        if down:
            self._interrupt(unit.own.values(), f"robot '{unit.robot}'", detail or "")
        if not self._shutdown.begun:
            self._registry.state_changed()

    def link_restored(self, robot: str | None = None) -> None:
        """Stop a latched robot before anything else reaches it."""
        unit, detail = self.unit(robot), "the link has just been restored"
        if self.state == "down" and self._backend is not None:
            self._enter("degraded", detail)
        if unit.state == "down":
            self._report_robot(unit, detail, down=False)
        self._stop_or_recover(unit)

    def own_estop(
        self, robot: str, state: Mapping[str, Any] | None, *, reset: bool = False
    ) -> None:
        """Show the e-stop of a robot's own gateway; one that was reset there holds nothing here."""
        unit = self.unit(robot)
        if state is None and reset and self.is_latched(robot):
            if not self._stops.has_partners(unit):  # they were not reset
                self._latches.reset(unit.identity, unit.keys)
            self._latches.reset(unit.name, unit.keys)
            if not self.is_latched(robot):
                unit.release(now())
                self._stops.end([unit])
        else:
            self._latches.show(unit.name, state)

    def own_leases(self, robot: str, leases: OwnLeases | None) -> None:
        """Note who holds leases on a robot, by its own gateway."""
        unit = self.unit(robot)
        unit.own_leases = leases
        self._registry.leases_told(unit)

    def refused(self, error: RcpError, *, count: int = 1) -> None:
        """Report that somebody was refused at the robots' side."""
        self.refusals[error.code] += count
        log.warning("backend_refused", backend=self.name, reason=error.message, count=count)
        self._events.refused(self.name, self.tenant, error, count)

    def is_latched(self, robot: str | None = None) -> bool:
        """Tell whether an e-stop holds a robot."""
        return self.unit(robot).latch is not None

    def guard(self, name: str, plan: StopPlan | None) -> None:
        """Store a plan for the guard process."""
        self.plans.pop(name, None)
        if plan is not None:
            self.plans[name] = plan
        self.plans_changed += 1

    def describe(self, facts: RobotFacts, robot: str | None = None) -> None:
        """Note what a robot is."""
        unit = self.unit(robot)
        if unit.facts != facts:
            unit.facts = facts
            self._registry.state_changed()

    def anchor(self, anchor: Anchor | None, robot: str | None = None) -> None:
        """Note where one of a robot's frames is."""
        self.unit(robot).anchor = anchor

    def transforms(self, tree: FrameTree, robot: str | None = None) -> None:
        """Note where to look transforms up."""
        self.unit(robot).frames = tree

    def discovering(self, *, active: bool) -> None:
        """Record whether an open backend is still discovering resources."""
        self._discovering = active
        self._note_growth()

    # -- life ----------------------------------------------------------------------------------

    def fail(self, state: State, detail: str) -> None:
        """Settle a backend that cannot even be tried."""
        self._enter(state, detail)
        self.settled.set()

    async def run(self, kind: BackendKind, config: Any) -> None:
        """Keep the backend open until `close`; returns when it is closed or has failed for good."""
        wait = _FIRST_RETRY
        while not self._closing.is_set():
            started = time.monotonic()
            self._discovering = False
            for unit in self._units.values():  # what an earlier life said of them is over
                unit.state, unit.detail = "ready", None
            if self.state != "down":
                self._enter("opening", None)
            try:
                with contained():
                    await self._live(kind, config)
            except (ConfigError, PluginError) as error:
                self._set_backend(None)
                self._enter("failed", str(error))
                self._interrupt_all(str(error))
                return
            except Exception as error:
                self._down(error)
            finally:
                self.settled.set()
            if self._closing.is_set():
                break
            if time.monotonic() - started > _LAST_RETRY:
                wait = _FIRST_RETRY
            with suppress(TimeoutError):
                await asyncio.wait_for(self._closing.wait(), wait)
            wait = min(wait * 2, _LAST_RETRY)
        self._enter("closed", None)

    async def _live(self, kind: BackendKind, config: Any) -> None:
        left: list[asyncio.Task[Any]] = []
        try:
            async with kind.open(config, self) as opened:
                self._use_backend(ContainedBackend(opened))
                try:
                    await self._closing.wait()
                finally:
                    for recovery in self._recoveries.values():
                        recovery.cancel()
                    left = self._commands.detach(self.name)
                    if not self._closing.is_set():
                        self._enter("down", self.detail or "the backend stopped")
        finally:  # when nothing can reach the robots any more
            for task in left:
                task.cancel()
        self._set_backend(None)

    def _use_backend(self, backend: ContainedBackend) -> None:
        """Use an open backend: first the stops, then what its robots still carry out."""
        self._set_backend(backend)
        self._on_loss, self.has_gateways = backend.on_loss, backend.has_gateways
        self._enter("ready", None)
        self._tell_cut_off()
        for unit in self.units:
            self._stop_or_recover(unit)
        if backend.has_gateways:
            for entry in list(self.entries.values()):
                self._commands.take_up(entry, backend)
        self.settled.set()

    def _stop_or_recover(self, unit: StopGroup) -> None:
        """Stop a latched robot that is available again; otherwise settle its lost commands."""
        if self.backend is None:
            return
        if unit.latch is not None:
            if unit.latch.shown is None:  # otherwise its own gateway holds it, or has let it go
                self._stops.resume(unit)
        elif unit.lost is not None and unit not in self._recoveries:
            task = asyncio.create_task(self._recover(unit), name=f"recover {unit.name}")
            self._recoveries[unit] = task
            task.add_done_callback(lambda _: self._recoveries.pop(unit, None))

    async def _recover(self, unit: StopGroup) -> None:
        """Do with a robot what its policy says of a lost command, unless it has a new one."""
        wait = _FIRST_RETRY
        while (lost := unit.lost) is not None and (backend := self.backend) is not None:
            if unit.latch is not None:  # the stop settles it
                return
            try:
                with permitted(unit, unit.stops):
                    done = await backend.recover(unit.robot)
            except Exception as error:
                unexpected = None if isinstance(error, RcpError) else error
                text = str(error)
                log.warning(
                    "not_recovered",
                    backend=unit.name,
                    command=lost,
                    error=text,
                    exc_info=unexpected,
                )
                await asyncio.sleep(wait)
                wait = min(wait * 2, _LAST_RETRY)
            else:
                unit.lost = None
                log.warning("recovered", backend=unit.name, command=lost, done=done)
                self._events.recovered(unit, lost, done)

    def _down(self, error: Exception) -> None:
        self._set_backend(None)
        text = _sentence(error)
        self.last_error = text
        known = isinstance(error, (NotReady, RcpError, ConnectionError, TimeoutError))
        if known:
            log.warning("backend_not_ready", backend=self.name, reason=text)
        else:
            log.error("backend_crashed", backend=self.name, exc_info=error)
        self._enter("down", text)
        self._interrupt_all(text)

    def _interrupt_all(self, why: str) -> None:
        self._interrupt(self.entries.values(), f"backend '{self.name}'", why)

    def _interrupt(self, entries: Iterable[Entry], whose: str, why: str) -> None:
        if self.has_gateways:  # their commands go on, and wait for their robots
            return
        for entry in entries:
            error = AdapterUnavailable(f"the link to {whose} was lost: {why}", origin=self.name)
            self._commands.interrupt(entry.path, error)

    def _note_growth(self) -> None:
        """Update whether requests for missing paths should be refused as retryable."""
        opens = self.state in _OPENS or (self.state == "down" and self._backend is None)
        looks = self._discovering and self._backend is not None
        incomplete = not self._closing.is_set() and (opens or looks)
        self._registry.set_incomplete(self, incomplete=incomplete)

    def _set_backend(self, backend: ContainedBackend | None) -> None:
        """Set the open backend, or None; requests reach it only while the state says that it works."""
        self._backend = backend
        usable = backend if self.state in _WORKING else None
        if usable is not self.backend:
            self.backend = usable
            for unit in (self.whole, *self._units.values()):
                unit.usable_backend = None if unit.state == "down" else usable

    def _enter(self, state: State, detail: str | None) -> None:
        changed = state != self.state
        self.state, self.detail = state, detail
        self._set_backend(self._backend)
        self._note_growth()
        if detail is not None:
            self.last_error = detail
        if not changed:
            return
        self.since = now()
        level = log.warning if state in ("degraded", "down", "failed", "unavailable") else log.info
        level("backend_state", backend=self.name, state=state, detail=detail)
        if not self._shutdown.begun:
            self._hub.demand.backend_changed(list(self.entries.values()))
            self._registry.state_changed()

    @property
    def closes(self) -> bool:
        """Whether it is closed, or being closed, for good."""
        return self._closing.is_set()

    def retire(self) -> None:
        """Let nothing move any more: the configuration has this backend no longer."""
        self.whole.retired = Latch("the gateway", "the backend is being closed")
        self._interrupt_all("it was removed from the configuration")

    def close(self) -> None:
        """Make `run` end; leaving its context closes the backend."""
        if self.state in ("ready", "degraded"):
            self._enter("closing", None)
        self._closing.set()
        self._note_growth()

    def plain(self) -> dict[str, Any]:
        """Describe the backend for `/system/status`."""
        return {
            "name": self.name,
            "plugin": self.config.use,
            "tenant": self.tenant,
            "robot": self.robot,
            "gateways": self.has_gateways,
            "state": self.availability,
            "since": iso(self.since),
            "detail": self.detail,
            "latency": self.latency,
            "last_error": self.last_error,
            "resources": len(self.entries),
            "samples": self.samples,
            "faults": self.faults,
            "estop": next((u.latch.plain() for u in self.units if u.latch is not None), None),
        }

    @property
    def unready(self) -> list[StopGroup]:
        """The robots of which the backend says that they are degraded or down."""
        return [unit for unit in self._units.values() if unit.state != "ready"]

    @property
    def robots(self) -> list[StopGroup]:
        """The robots that it can halt one by one."""
        return [unit for unit in self._units.values() if unit.own]

    def path(self, name: str) -> str:
        """Return the full path of one of the backend's own names."""
        return full_path(self.tenant, self.robot, name)


def _hold_name(robot: str | None) -> str:
    return "service/hold" if robot is None else f"service/{robot}/hold"


def _sentence(error: BaseException) -> str:
    inner: Any = error
    while (several := getattr(inner, "exceptions", None)) is not None:
        inner = several[0]
    return str(inner) or type(inner).__name__
