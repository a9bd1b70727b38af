"""`execute` and `cancel`: from an envelope to a command, whose steps are the replies."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from time import perf_counter
from typing import Any

import msgspec

from rcp_kernel.clock import iso, now
from rcp_kernel.contract.requests import PreparedRequest, QueuedRequest
from rcp_kernel.errors import RcpError
from rcp_kernel.features import Call
from rcp_kernel.model import Operation
from rcp_kernel.safety.deadman import Deadman
from rcp_kernel.safety.hold import Hold
from rcp_kernel.safety.partners import Partners
from rcp_kernel.sessions.accounting import count_command
from rcp_kernel.sessions.command import Command, CommandListener, Record, command_id
from rcp_kernel.sessions.long_value import LongValue
from rcp_kernel.sessions.session import Answer, Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.values import value_type
from rcp_kernel.wire import FINAL, Reply, Request
from rcp_requests.actions import ActionHandler, PreparedRun
from rcp_requests.admission import Admission, Resolver
from rcp_requests.command_access import CommandAccess, is_own
from rcp_requests.commands import Commands
from rcp_requests.exempt import Exemptions
from rcp_requests.idempotency import Keys
from rcp_requests.journal import CommandJournal
from rcp_requests.services import ServiceHandler
from rcp_requests.waiting import WaitingCommand
from rcp_requests.write import DryRun, dry_run_reply
from rcp_scheduling.turns import at_once
from rcp_streams.frames import FrameConverter

__all__ = ["ExecuteHandler"]

_NOTHING = (b"", b"{}", b"null", b"\x80")  # bodies for a path without input


class _Cancel(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    command: str | None = None


_CANCEL = value_type(_Cancel | None)


class ExecuteHandler:
    """The handler of `execute` and `cancel`."""

    def __init__(
        self,
        resolver: Resolver,
        admission: Admission,
        commands: Commands,
        journal: CommandJournal,
        access: CommandAccess,
        *,
        services: ServiceHandler,
        actions: Mapping[str, ActionHandler],
        dry_run: DryRun,
        exempt: Exemptions,
        keys: Keys,
        partners: Partners,
        deadman: Deadman,
        frames: FrameConverter,
    ) -> None:
        self._resolver = resolver
        self._admission = admission
        self._commands = commands
        self._journal = journal
        self._access = access
        self._services = services
        self._actions = actions
        self._dry_run = dry_run
        self._is_exempt = exempt
        self._keys = keys
        self._partners = partners
        self._deadman = deadman
        self._frames = frames

    def execute_in_steps(
        self, session: Session, request: Request, answer: Answer
    ) -> Generator[None, None, Reply | None]:
        """Start a command; an action of the gateway queues from now on, and is checked in steps."""
        action = self._actions.get(request.path or "")
        if action is None:
            return self._execute_soon(session, request, answer)
        since = request.since if isinstance(request, QueuedRequest) else None
        waiting = action.waiting.enter(session, since)
        return self._execute_checked(session, request, answer, action, waiting)

    def _execute_soon(
        self, session: Session, request: Request, answer: Answer
    ) -> Generator[None, None, Reply | None]:
        yield from ()
        return self.execute(session, request, answer)

    def _execute_checked(
        self,
        session: Session,
        request: Request,
        answer: Answer,
        action: ActionHandler,
        waiting: WaitingCommand,
    ) -> Generator[None, None, Reply | None]:
        try:
            if self._keys.find(session, request, action.path) is not None:
                return self.execute(session, request, answer)
            if session.account is not None:
                session.account.check_command(action.path)
            action.check_running(session)
            prepared = yield from action.prepare(session, request, waiting)
            return self.execute(session, request, answer, prepared)
        finally:
            action.waiting.leave(waiting)

    def execute(
        self,
        session: Session,
        request: Request,
        answer: Answer,
        prepared: PreparedRun | None = None,
    ) -> Reply | None:
        """Start a command, or follow the one started with the same idempotency key.

        `prepared` is the checked run of an action of the gateway.
        """
        started = perf_counter()
        entry = self._resolver.resolve(session, request.path, Operation.EXECUTE)
        action = self._actions.get(entry.path)
        if (
            request.idempotency_key is not None
            and (known := self._known(session, request, entry)) is not None
        ):
            self._journal.follow(known, session, request, answer, started)
            return None
        if prepared is not None:
            value = prepared.run.input
        elif entry.resource.input is None and bytes(request.body) in _NOTHING:
            value = None
        elif entry.takes_frame is False or (value := self._goal(session, request, entry)) is None:
            value = request.decode_body(entry.input_type, f"input of {entry.label}")
        if entry.path in self._services.paths:
            return self._services.execute(session, request, entry, value, answer)
        call = Call(session, request, entry, value)
        self._admission.admit(call)
        self._commands.admit(entry)
        halts = entry.is_hold or (action is not None and self.stops(session, request))
        if not halts:
            if session.account is not None:
                session.account.check_command(entry.path)
            if action is not None:
                action.check_running(session)
        if entry.is_hold and not request.dry_run:
            self._hold(call, answer, started)
            return None
        if action is not None:
            prepared = self._prepared(action, session, request, prepared)
        self._admission.admit_late(call)
        if request.dry_run:
            return self._would(call, prepared)
        self._begin(call, answer, started, action, prepared)
        return None

    def _begin(
        self,
        call: Call,
        answer: Answer,
        started: float,
        action: ActionHandler | None,
        prepared: PreparedRun | None,
    ) -> None:
        """Make a command of an admitted call, answer the request with its steps, and start it."""
        session, request, entry = call.session, call.request, call.entry
        keyed = request.idempotency_key is not None
        if action is None or prepared is None:
            command = _command(call)
        else:
            prepared.run.begin(session, request, entry)
            command = prepared.command(session, request, entry)
            command.followers.append(action.follow)
        if keyed:
            command.ready = self._keys.committed
            command.followers.append(self._settling(session, request, entry.path))
        self._journal.follow(command, session, request, answer, started)
        if keyed:
            self._keys.note(session, request, entry.path, command)
        if session.account is not None:
            count_command(session.account, command)
        self._commands.start(command, call, self._admission.confirm)
        if action is not None and prepared is not None:
            action.waiting.settle(prepared.waiting, command)

    def _goal(self, session: Session, request: Request, entry: Entry) -> Any:
        """Return the input in a frame that the robot takes; None: it is so already."""
        if entry.takes_frame is None:
            entry.takes_frame = self._frames.takes(entry)
        return self._frames.goal(session, request, entry) if entry.takes_frame else None

    def _would(self, call: Call, prepared: PreparedRun | None) -> Reply:
        """Answer a dry run.

        :raises RcpError: the backend knows that it would refuse the command.
        """
        request, entry = call.request, call.entry
        if prepared is not None:
            return dry_run_reply(request, entry, dict(prepared.run.dry_run()))
        if entry.unit.usable_backend is not None:
            entry.unit.usable_backend.foresee(entry.name, call.value)
        return dry_run_reply(request, entry, {"execute": call.value, **self._dry_run(call)})

    @staticmethod
    def _prepared(
        action: ActionHandler, session: Session, request: Request, prepared: PreparedRun | None
    ) -> PreparedRun:
        """Return a checked run that may start now.

        :raises EstopActive: one of its robots was stopped since it was sent.
        :raises RcpError: the check failed.
        """
        if prepared is None:
            waiting = action.waiting.enter(session)
            prepared = at_once(action.prepare(session, request, waiting))
        prepared.check_stops()
        return prepared

    def _hold(self, call: Call, answer: Answer, started: float) -> None:
        """Start a hold, which bypasses quotas and all guards."""
        session, request, entry = call.session, call.request, call.entry
        command = _command(call)
        units = [entry.unit, *self._partners.of(entry)]
        command.work = Hold(units, self._commands, self._deadman)
        self._journal.follow(command, session, request, answer, started)
        self._commands.start(command, call, self._admission.confirm)

    def stops(self, session: Session, request: Request) -> bool:
        """Return whether a request brings a robot to rest."""
        if request.type != "execute":
            return False
        action = self._actions.get(request.path or "")
        if action is not None:
            return action.stops(
                request, lambda one: self._is_exempt(one) or self.stops(session, one)
            )
        try:
            return self._resolver.resolve(session, request.path, Operation.EXECUTE).is_hold
        except RcpError:
            return False

    def _settling(self, session: Session, request: Request, path: str) -> CommandListener:
        def settle(command: Command, step: Record) -> None:
            if step.status in FINAL:
                self._keys.settle(session, request, path, command.reply(step))

        return settle

    def _known(self, session: Session, request: Request, entry: Entry) -> Command | None:
        """Return the command that was started with the same key.

        It is looked up before the input is converted to the robot's frame, which may be impossible by now.
        """
        if entry.path in self._services.paths:
            return None
        known = self._keys.find(session, request, entry.path)
        return known if isinstance(known, Command) else None

    def cancel(self, session: Session, request: Request, answer: Answer) -> Reply | None:
        """Cancel a command by its id, or everything running on a path; robots are notified at once."""
        body = request.decode_body(_CANCEL, "cancel")
        id_ = request.command or (body.command if body is not None else None)
        targets = [self._access.to_cancel(session, id_)] if id_ is not None else []
        path = targets[0].path if targets else request.path
        entry = self._resolver.resolve(session, path, Operation.EXECUTE, anyway=True)
        if id_ is None:
            running = self._journal.running_on(entry.path)
            targets = [c for c in running if self._access.sees(session, c)]
        action = self._actions.get(entry.path) if id_ is None else None
        waiting = None if action is None else action.waiting
        own = targets or (waiting is not None and waiting.own(session))
        if not own or not all(is_own(session, command) for command in targets):
            # The sender of a command may always cancel it, regardless of conditions.
            self._resolver.check(session, entry, Operation.EXECUTE)
        live = [command for command in targets if not command.final]
        for command in live:
            self._commands.cancel(command, f"requested by {session.principal.name}")
        ended = [command.id for command in live]
        if waiting is not None:
            others = session.rights.permits(entry, Operation.EXECUTE)
            ended += waiting.cancel(session, others=others)
        text = (
            f"Cancel request for {entry.path} sent."
            if ended
            else f"Nothing is running on {entry.path}."
        )
        return Reply(
            type="cancel",
            id=request.id,
            path=entry.path,
            body={"cancelled": ended},
            message=text,
            timestamp=iso(now()),
            custom=request.custom,
        )


def _command(call: Call) -> Command:
    """Return the command for a call."""
    session, request, entry = call.session, call.request, call.entry
    return Command(
        id=command_id(),
        path=entry.path,
        principal=session.principal.name,
        proof=session.principal.proof,
        tenant=entry.tenant,
        requester=session,
        request=request,
        request_id=request.id,
        custom=request.custom,
        timestamp=request.timestamp,
        input=LongValue(call.value) if isinstance(request, PreparedRequest) else call.value,
        session=session.id,
        entry=entry,
    )
