"""The gateway's own long-running actions: from a request to a run that may begin."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator
from dataclasses import dataclass

from rcp_kernel.errors import EstopActive
from rcp_kernel.features.action import Action, ActionHost, ActionRun
from rcp_kernel.features.resource import ViewChanges
from rcp_kernel.model import Operation
from rcp_kernel.sessions.command import Command, Record
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry, RobotUnit
from rcp_kernel.tree.registry import Registry
from rcp_kernel.wire import Request
from rcp_requests.admission import Resolver
from rcp_requests.journal import CommandJournal
from rcp_requests.waiting import WaitingCommand, WaitingCommands

__all__ = ["ActionHandler", "PreparedRun"]

_STEP = 256  # paths checked per step


@dataclass(frozen=True, slots=True)
class PreparedRun:
    """A checked run of an action, and the last checks before it starts."""

    run: ActionRun
    waiting: WaitingCommand
    units: list[RobotUnit]
    """The robot units of all paths it affects."""

    def check_stops(self) -> None:
        """Refuse a request sent before an e-stop of a robot that it affects.

        :raises EstopActive: there was one, whether or not it is still latched.
        """
        for unit in self.units:
            if unit.stopped >= self.waiting.since:
                raise EstopActive(
                    f"{unit.name} was stopped while the request waited for its turn",
                    remedy="Check the state of the robot, then send the request again.",
                )

    def command(self, session: Session, request: Request, entry: Entry) -> Command:
        """Return the command that it becomes."""
        return Command(
            id=self.waiting.id,
            path=entry.path,
            principal=session.principal.name,
            proof=session.principal.proof,
            tenant=session.tenant,
            requester=session,
            work=self.run,
            touches=self.run.touches,
            request=request,
            request_id=request.id,
            custom=request.custom,
            timestamp=request.timestamp,
            input=self.run.input,
            session=session.id,
            entry=entry,
        )


class ActionHandler:
    """One action."""

    def __init__(
        self,
        path: str,
        action: Action,
        waiting: WaitingCommands,
        *,
        host: ActionHost,
        journal: CommandJournal,
        resolver: Resolver,
        registry: Registry,
        changes: ViewChanges,
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        self.path = path
        self._action = action
        self.waiting = waiting
        self._host = host
        self._journal = journal
        self._resolver = resolver
        self._registry = registry
        self._changes = changes
        self._loop = loop
        self._told = True

    def check_running(self, session: Session) -> None:
        """Refuse one run too many.

        :raises QueueFull: as many run as may.
        """
        self._action.admit(session, self._journal.running_on(self.path))

    def prepare(
        self, session: Session, request: Request, waiting: WaitingCommand
    ) -> Generator[None, None, PreparedRun]:
        """Check a request whole, in steps.

        :raises RcpError: the session may not send it, or something is wrong with it.
        """
        entry = self._resolver.resolve(session, self.path, Operation.EXECUTE)
        run = yield from self._action.prepare(session, request, entry, self._host)
        units = yield from self._units(run)
        return PreparedRun(run, waiting, units)

    def _units(self, run: ActionRun) -> Generator[None, None, list[RobotUnit]]:
        units: dict[RobotUnit, None] = {}
        for number, path in enumerate(run.touches, 1):
            entry = self._registry.entries.get(path)
            if entry is not None:
                units[entry.unit] = None
            if not number % _STEP:
                yield
        return list(units)

    def follow(self, command: Command, step: Record) -> None:
        """Handle a step of a command: the list of commands has changed."""
        if self._told:
            self._told = False
            self._loop.call_soon(self._tell)

    def _tell(self) -> None:
        self._told = True
        self._changes.tell(self.path)

    def stops(self, request: Request, is_stop: Callable[[Request], bool]) -> bool:
        """Tell whether a request does nothing but bring robots to rest."""
        return self._action.stops(request, is_stop)
