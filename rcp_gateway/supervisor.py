"""One task for each backend: open, ready, degraded, backoff, close. A crash changes a state only.

    declared → opening → ready ⇄ degraded → closing → closed,  and  down, unavailable, failed

A backend is `down` when it could not be opened or crashed (`_down`), or when it says so itself
(`report`): only it knows how long its robot may be silent. After `NotReady` or a crash it is opened
again, with backoff; `ConfigError` is final.
Adapters and transports are opened after the backends were started and closed before them, in
reverse; motion is halted, with a bound, before anything closes.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any

import structlog

from rcp_gateway.backend_status import BackendStatus, State
from rcp_gateway.containment import ContainedBackend, contained
from rcp_gateway.declared_resources import DeclaredResources
from rcp_gateway.recovery import LossRecovery
from rcp_gateway.thread_calls import ThreadCalls
from rcp_kernel.clock import iso, now
from rcp_kernel.config.file import BackendConfig
from rcp_kernel.contract.shutdown import Shutdown
from rcp_kernel.errors import AdapterUnavailable, ConfigError, NotReady, PluginError, RcpError
from rcp_kernel.model import full_path
from rcp_kernel.safety.safety_events import SafetyEvents
from rcp_kernel.safety.stop import StopController
from rcp_kernel.spi import (
    Anchor,
    Backend,
    BackendKind,
    BaseBackend,
    FrameTree,
    OwnLeases,
    RobotFacts,
)
from rcp_kernel.tree.entry import Availability, Entry, RobotUnit
from rcp_kernel.tree.latches import Latch, Latches
from rcp_kernel.tree.registry import Registry
from rcp_protocol.timeouts import timeout
from rcp_requests.commands import Commands
from rcp_requests.journal import CommandJournal
from rcp_streams.hub import Hub

__all__ = ["BackendSupervisor"]

log = structlog.get_logger("rcp.supervisor")
_FIRST_RETRY = 0.25  # s
_LAST_RETRY = 10.0  # s
_OPENS = ("declared", "opening")
_WORKING = ("ready", "degraded", "closing")


class BackendSupervisor(BackendStatus):
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
        super().__init__(config)
        self._registry = registry
        self._hub = hub
        self._commands = commands
        self._latches = latches
        self._stops = stops
        self._events = events
        self._shutdown = shutdown
        self._recovery = LossRecovery(self, journal, stops, events)
        self.call_soon = ThreadCalls(loop, hub.flush_scheduler, self._call_failed).add
        """Runs a function on the event loop, from any thread."""
        declared = DeclaredResources(self, config.tenant, registry, commands, self._recovery)
        self.entries = declared.entries
        self.declare, self.withdraw = declared.declare, declared.withdraw
        self.publish, self.publish_batch = declared.publish, declared.publish_batch
        self._units: dict[str, RobotUnit] = {}
        self.whole = RobotUnit(self, self._latches)
        self.settled = asyncio.Event()
        """Set once the first attempt to open has ended, well or not."""
        self._backend: ContainedBackend | None = None
        self.backend: Backend | None = None
        """The open backend, or None while there is none that works. Every read looks at it."""
        self.on_loss = BaseBackend.on_loss
        """The policy for a robot whose command was lost with its link, as the last opening said."""
        self.has_gateways = BaseBackend.has_gateways
        """Whether each of its robots has a gateway of its own, as the last opening said."""
        self._closing = asyncio.Event()
        self._discovering = False
        self._note_growth()

    # -- Owner ---------------------------------------------------------------------------------

    def unit(self, robot: str | None) -> RobotUnit:
        """Return a robot unit: one of the backend's robots, or all of them."""
        if robot is None:
            return self.whole
        unit = self._units.get(robot)
        if unit is None:
            unit = self._units[robot] = RobotUnit(self, self._latches, robot)
            unit.usable_backend = self.backend
            if self._backend is not None and unit.latch is not None:
                self._stops.resume(unit)
        return unit

    @property
    def units(self) -> list[RobotUnit]:
        """The robots that can be stopped one by one, and all of the backend if more than they move."""
        alone = [unit for unit in self._units.values() if unit.own]
        if not alone or any(entry.moves for entry in self.whole.own.values()):
            alone.append(self.whole)
        return alone

    def state_changed(self) -> None:
        """Announce that the state of one of its robots may have changed."""
        self._registry.state_changed()

    # -- Host ----------------------------------------------------------------------------------

    def _call_failed(self, error: BaseException) -> None:
        self.fault(f"{type(error).__name__}: {error}")
        log.error("backend_call_failed", backend=self.name, exc_info=error)

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

    def _report_robot(self, unit: RobotUnit, detail: str | None, *, down: bool) -> None:
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
        self._recovery.settle(unit)

    def own_estop(
        self, robot: str, state: Mapping[str, Any] | None, *, reset: bool = False
    ) -> None:
        """Show the e-stop of a robot's own gateway; a reset there applies here too."""
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
        """Record who holds leases on a robot, as its own gateway reports."""
        unit = self.unit(robot)
        unit.own_leases = leases
        self._registry.leases_changed(unit)

    def refused(self, error: RcpError, *, count: int = 1) -> None:
        """Report that a peer was refused at the robots' side."""
        self.refusals[error.code] += count
        log.warning("backend_refused", backend=self.name, reason=error.message, count=count)
        self._events.refused(self.name, self.tenant, error, count)

    def is_latched(self, robot: str | None = None) -> bool:
        """Return whether an e-stop holds a robot."""
        return self.unit(robot).latch is not None

    def describe(self, facts: RobotFacts, robot: str | None = None) -> None:
        """Record what a robot is."""
        unit = self.unit(robot)
        if unit.facts != facts:
            unit.facts = facts
            self._registry.state_changed()

    def anchor(self, anchor: Anchor | None, robot: str | None = None) -> None:
        """Record where one of a robot's frames is."""
        self.unit(robot).anchor = anchor

    def transforms(self, tree: FrameTree, robot: str | None = None) -> None:
        """Record where to look up transforms."""
        self.unit(robot).frames = tree

    def discovering(self, *, active: bool) -> None:
        """Record whether an open backend is still discovering resources."""
        self._discovering = active
        self._note_growth()

    # -- life ----------------------------------------------------------------------------------

    def fail(self, state: State, detail: str) -> None:
        """Set the final state of a backend that cannot be opened at all."""
        self._enter(state, detail)
        self.settled.set()

    async def run(self, kind: BackendKind, config: Any) -> None:
        """Keep the backend open until `close`; returns when it is closed or has failed for good."""
        wait = _FIRST_RETRY
        while not self._closing.is_set():
            started = time.monotonic()
            self._discovering = False
            for unit in self._units.values():  # reports of an earlier life no longer apply
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
                async with timeout(wait):
                    await self._closing.wait()
            wait = min(wait * 2, _LAST_RETRY)
        self._enter("closed", None)

    async def _live(self, kind: BackendKind, config: Any) -> None:
        left: list[asyncio.Task[Any]] = []
        if kind.lacks is not None:  # in a thread: the file may be on a mount that does not answer
            lacking = await asyncio.to_thread(kind.lacks, config)
            if lacking is not None:
                raise NotReady(lacking)
        try:
            async with kind.open(config, self) as opened:
                self._use_backend(ContainedBackend(opened))
                try:
                    await self._closing.wait()
                finally:
                    self._recovery.cancel()
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
        self.on_loss, self.has_gateways = backend.on_loss, backend.has_gateways
        self._enter("ready", None)
        self._recovery.report_cut_off()
        for unit in self.units:
            self._recovery.settle(unit)
        if backend.has_gateways:
            for entry in list(self.entries.values()):
                self._commands.take_up(entry, backend)
        self.settled.set()

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
        if self.has_gateways:  # their commands continue, and wait for their robots
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
        """Set the open backend, or None; requests reach it only in a working state."""
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
        """Refuse all motion from now on: the configuration no longer has this backend."""
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
    def unready(self) -> list[RobotUnit]:
        """The robots that the backend reports as degraded or down."""
        return [unit for unit in self._units.values() if unit.state != "ready"]

    @property
    def robots(self) -> list[RobotUnit]:
        """The robots that it can halt one by one."""
        return [unit for unit in self._units.values() if unit.own]

    def path(self, name: str) -> str:
        """Return the full path of one of the backend's own names."""
        return full_path(self.tenant, self.robot, name)


def _sentence(error: BaseException) -> str:
    inner: Any = error
    while (several := getattr(inner, "exceptions", None)) is not None:
        inner = several[0]
    return str(inner) or type(inner).__name__
