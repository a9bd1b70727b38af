"""The life of an execute: accepted → pending → in_progress → completed | failed | rejected | cancelled.

The kernel derives every status from the state of one coroutine, `Backend.execute`, so that no
plugin can send an illegal sequence. `Commands` owns the coroutine of a command, `CommandJournal` the
command itself: its steps, and its place among those that run or have ended. Commands outlive their
connection and are kept after their end.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from rcp_kernel.clock import Clock
from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.caller import request_context
from rcp_kernel.contract.fence import current_permit, permit
from rcp_kernel.contract.identity import Principal
from rcp_kernel.contract.internal_errors import LinkLost
from rcp_kernel.errors import (
    AlreadyRunning,
    Cancelled,
    DeadlineExceeded,
    DeviceRejected,
    QueueFull,
    RcpError,
    Refused,
)
from rcp_kernel.features import Call
from rcp_kernel.model import Kind
from rcp_kernel.sessions.command import Command, Continuation, Record
from rcp_kernel.sessions.long_value import checked
from rcp_kernel.spi import Backend
from rcp_kernel.tree.entry import Entry
from rcp_kernel.values import is_long
from rcp_kernel.wire import NO_BODY, Request
from rcp_requests.journal import CommandJournal
from rcp_requests.outcomes import failed_step, outcome_of
from rcp_scheduling.timers import Deadlines, moment_of
from rcp_scheduling.turns import Turns

__all__ = ["Commands"]

Confirm = Callable[[Call], Backend]
"""Returns the backend of a command, or refuses the command under the current state."""
_SERVICE_TIMEOUT = 10.0  # s for a service that declares none
_QUEUE = 16  # commands queued per path
_CANCEL_GRACE = 5.0  # s for a backend to bring a cancelled command to rest


class Commands:
    """Queues, starts and cancels commands; the journal records their steps."""

    def __init__(
        self,
        journal: CommandJournal,
        turns: Turns,
        deadlines: Deadlines,
        loop: asyncio.AbstractEventLoop,
        clock: Clock,
        settings: Settings,
    ) -> None:
        self._journal = journal
        self._turns = turns
        self._deadlines = deadlines
        self._loop = loop
        self._now = clock.now
        self._settings = settings
        self._active: dict[str, Command] = {}
        """The command that occupies each path whose policy allows only one."""
        self._queues: dict[str, deque[Command]] = {}
        self._starts: dict[str, Callable[[], None]] = {}
        self._detached: dict[str, list[Command]] = {}
        """Commands that go on without this gateway, by path, until they are taken up again."""
        for command in self.running.values():
            self._wait(command)

    @property
    def running(self) -> Mapping[str, Command]:
        """Commands that have not ended, by id."""
        return self._journal.running

    def running_on(self, path: str) -> tuple[Command, ...]:
        """Return the commands on a path that have not ended, oldest first."""
        return self._journal.running_on(path)

    def every(self) -> list[Command]:
        """Return all known commands, newest first."""
        return self._journal.every()

    def admit(self, entry: Entry) -> None:
        """Check a command against the path's policy.

        :raises AlreadyRunning: one is running and the policy is `reject`.
        :raises QueueFull: the queue of the path is full.
        """
        busy = self._active.get(entry.path)
        if busy is None or entry.resource.policy == "preempt":
            return
        if entry.resource.policy == "queue":
            if len(self._queues.get(entry.path, ())) >= _QUEUE:
                raise QueueFull(
                    f"{_QUEUE} commands are already waiting for {entry.path}", path=entry.path
                )
            return
        raise AlreadyRunning(
            f"Warning: action '{entry.path}' is currently in progress; rejecting duplicate request.",
            path=entry.path,
            details={"command": busy.id},
        )

    def start(self, command: Command, call: Call, confirm: Confirm) -> None:
        """Accept an admitted command and run it, now or when its path is free.

        The timeout of its path counts from its start, the request's deadline from now. `confirm` is
        called when its turn comes, because the state may have changed while it waited.
        """
        accepted = Record("accepted", self._now(), message="Command accepted.")
        self._journal.write(command, accepted)
        entry = call.entry
        busy = self._active.get(entry.path)
        if busy is None or _begins_at_once(entry):
            self._run(command, call, confirm)
        else:
            text = f"Waiting for command {busy.id} on {entry.path}."
            self._journal.write(command, Record("pending", self._now(), message=text))
            self._starts[command.id] = partial(self._run, command, call, confirm)
            self._queue(command, call, busy)

    def _queue(self, command: Command, call: Call, busy: Command) -> None:
        """Queue a command behind another one on its path, or pre-empt that one."""
        path, deadline = command.path, call.request.deadline
        if call.entry.resource.policy == "preempt":
            for waiting in list(self._queues.get(path, ())):
                self.cancel(waiting, "preempted by a newer command")
            self.cancel(busy, "preempted by a newer command")
        self._queues.setdefault(path, deque()).append(command)
        if deadline is not None:
            missed = partial(self._expire, command, deadline)
            command.deadline = self._deadlines.set(deadline, command, missed)

    def _run(self, command: Command, call: Call, confirm: Confirm) -> None:
        entry, deadline = call.entry, call.request.deadline
        if not (entry.parallel or _begins_at_once(entry)):
            self._active[entry.path] = command
        if entry.moves:
            entry.unit.loss.command = None
        command.began = entry.unit.stops
        work = self._carry_out(command, call, confirm)
        command.task = self._loop.create_task(work, name=f"command {command.id}")
        command.task.add_done_callback(partial(self._on_task_done, command))
        if command.deadline is None:
            timeout = entry.resource.timeout or (
                _SERVICE_TIMEOUT
                if entry.kind is Kind.SERVICE
                else self._settings.limits.action_timeout
            )
            if deadline is not None:
                timeout = min(timeout, deadline)
            missed = partial(self._expire, command, timeout)
            command.deadline = self._deadlines.set(timeout, command, missed)
        if entry.owner.has_gateways:
            self._outlive(command, call, command.deadline)

    # -- commands that go on without this gateway ------------------------------------------------

    def _outlive(self, command: Command, call: Call, slot: int) -> None:
        """Keep what is needed to go on with a command, before its robot is told of it."""
        until = self._now() + int((moment_of(slot) - self._loop.time()) * 1e9)
        grants, key = call.session.principal.grants, call.request.idempotency_key
        command.continuation = Continuation(call.entry.owner.name, until, grants, key)
        self._journal.keep(command)
        command.ready = self._journal.committed

    def detach(self, backend: str) -> list[asyncio.Task[Any]]:
        """Leave the commands of a backend to its robots; return their tasks, to be ended with it."""
        tasks: list[asyncio.Task[Any]] = []
        for command in self.running.values():
            kept, task = command.continuation, command.task
            if kept is not None and kept.backend == backend and task is not None:
                tasks.append(task)
                command.task = None
                if command.deadline is not None:
                    self._deadlines.clear(command.deadline, command)
                self._wait(command)
        return tasks

    def _wait(self, command: Command) -> None:
        """Keep a detached command until its backend is back, or its deadline has passed."""
        assert command.continuation is not None
        self._detached.setdefault(command.path, []).append(command)
        left = max(0.0, (command.continuation.until - self._now()) / 1e9)
        taken = (command.continuation.until - command.created) / 1e9
        missed = partial(self._expire, command, taken)
        command.deadline = self._deadlines.set(left, command, missed)

    def take_up(self, entry: Entry, backend: Backend) -> None:
        """Follow the commands of a path again that were detached, or that an earlier run began."""
        for command in list(self._detached.get(entry.path, ())):
            command.entry = entry
            if entry.barred and entry.unit.latch is not None:
                why = f"{entry.path} was cancelled: emergency stop"
                self._finish(command, Cancelled(why, path=entry.path))
                continue
            self._detached[entry.path].remove(command)
            if not _begins_at_once(entry):
                self._active.setdefault(entry.path, command)
            work = self._continue(command, entry, backend)
            command.task = self._loop.create_task(work, name=f"command {command.id}")
            command.task.add_done_callback(partial(self._on_task_done, command))
            if command.cancelling is not None:  # once its robot can be told
                self._loop.call_soon(command.task.cancel)

    async def _continue(self, command: Command, entry: Entry, backend: Backend) -> Any:
        kept, slot = command.continuation, command.deadline
        assert kept is not None
        assert slot is not None
        principal = Principal(command.principal, kept.grants, command.proof)
        request = Request(type="execute", path=entry.path, idempotency_key=kept.idempotency_key)
        value = entry.input_type.convert(command.input)
        request_context.set((principal, request, slot, command.id))
        permit(entry.unit, entry.unit.stops)
        command.sent = True
        result = await backend.execute(entry.name, value, partial(self._progress, command, entry))
        try:
            if result is None:
                return None
            return await self._turns.finish(principal.identity, checked(entry.output_type, result))
        except RcpError as error:
            raise _mismatch(entry, error) from error

    # -- their work ------------------------------------------------------------------------------

    async def _carry_out(self, command: Command, call: Call, confirm: Confirm) -> Any:
        entry, work = call.entry, command.work
        if command.ready is not None:
            await command.ready()
        if command.unrecorded and not entry.is_hold:
            raise QueueFull(
                f"the audit record of {entry.path} could not be written; it was not begun",
                remedy="Ask the operator to look into the log of the gateway.",
            )
        backend = confirm(call)
        assert command.deadline is not None
        request_context.set((call.session.principal, call.request, command.deadline, command.id))
        progress = partial(self._progress, command, entry)
        command.sent = True
        if work is not None:
            result = await work.run(command, call.session, progress)
        else:
            current_permit.set((entry.unit, command.began))
            result = await backend.execute(entry.name, call.value, progress)
        try:
            if work is None and entry.output_type.grows and is_long(result):
                owner = call.session.principal.identity
                result = await self._turns.finish(owner, checked(entry.output_type, result))
            elif result is not None:
                result = entry.output_type.check(result)[0]
        except RcpError as error:
            raise _mismatch(entry, error) from error
        if command.continuation is None:
            # Not by the task's callback, a turn of the loop later: a result that comes at once is
            # sent together with `accepted`.
            current_permit.set(None)  # what follows from the result is not the robot's any more
            request_context.set(None)
            command.task = None
            if command.finished is None:
                self._finish(command, result)
            self._release(command)
        return result

    def _progress(
        self,
        command: Command,
        entry: Entry,
        feedback: Any = None,
        *,
        fraction: float | None = None,
    ) -> None:
        """Report the progress of a command: the `Progress` passed to its backend."""
        if command.finished is not None:
            return
        body: Any = NO_BODY
        if feedback is not None:
            try:
                body = entry.feedback_type.check(feedback)[0]
            except RcpError as error:
                entry.owner.fault(f"feedback of {entry.path}: {error.message}")
                return
        if fraction is not None:
            fraction = min(1.0, max(0.0, fraction))
        self._journal.write(command, Record("in_progress", self._now(), body, fraction))

    def _expire(self, command: Command, timeout: float) -> None:
        """End a command at its deadline, regardless of how the backend handles the cancellation."""
        if command.final:
            return
        command.expired = True
        if command in self._detached.get(command.path, ()):
            what = f"did not finish within {timeout:g} s; its robot could not be reached"
        elif command.task is None:
            self._unqueue(command)
            what = f"did not start within {timeout:g} s: other commands were ahead of it"
        else:
            command.task.cancel()
            what = f"did not finish within {timeout:g} s; the robot was told to stop"
        self._finish(command, DeadlineExceeded(f"{command.path} {what}", path=command.path))

    def _unqueue(self, command: Command) -> None:
        del self._starts[command.id]
        self._queues[command.path].remove(command)

    def cancel(self, command: Command, reason: str) -> None:
        """Cancel a command: the robot is notified at once, the final status follows."""
        if command.final or command.cancelling is not None:
            return
        command.cancelling = reason
        if command.id in self._starts:
            self._unqueue(command)
            self._finish(
                command, Cancelled(f"{command.path} was cancelled: {reason}", path=command.path)
            )
        elif command.task is not None or command.continuation is not None:
            if command.task is not None:
                command.task.cancel()
            self._loop.call_later(_CANCEL_GRACE, self._give_up, command)

    def withdraw(self, command: Command, error: Refused) -> None:
        """End a command that is no longer permitted: refused if queued, otherwise cancelled."""
        if command.id in self._starts:
            self._unqueue(command)
            self._finish(command, error)
        else:
            self.cancel(command, error.message)

    def _give_up(self, command: Command) -> None:
        if not command.final:
            self._finish(
                command,
                DeadlineExceeded(
                    f"{command.path} was cancelled, but the backend has not confirmed it for "
                    f"{_CANCEL_GRACE:g} s",
                    path=command.path,
                    remedy="Check the robot: it may still be moving. Use the e-stop if in doubt.",
                ),
            )

    def _on_task_done(self, command: Command, task: asyncio.Task[Any]) -> None:
        if command.task is None and command.continuation is None:
            return  # it is complete; asyncio reports what failed after that
        moved_on = command.task is not task  # it continues without this gateway
        if command.finished is None and not moved_on:
            self._finish(command, outcome_of(command, task))
        elif not task.cancelled():
            task.exception()  # retrieved, so that asyncio does not report it
        if not moved_on:
            command.task = None  # and all it refers to, because the command is kept for long
            self._release(command)

    def _release(self, command: Command) -> None:
        """Free the path of a command that has ended, as its task has, and start the next one there."""
        path = command.path
        if self._active.get(path) is command:
            del self._active[path]
            if path in self._queues:
                self._next(path)

    def _next(self, path: str) -> None:
        queue = self._queues[path]
        if not queue:
            del self._queues[path]
            return
        following = queue.popleft()
        if not queue:
            del self._queues[path]
        self._starts.pop(following.id)()

    def _finish(self, command: Command, outcome: Any) -> None:
        if command.deadline is not None:
            self._deadlines.clear(command.deadline, command)
            command.deadline = None
        if isinstance(outcome, RcpError):
            self._journal.write(command, failed_step(command, outcome, self._now()))
        else:
            body = NO_BODY if outcome is None else outcome
            text = f"Command {command.path} executed successfully."
            self._journal.write(command, Record("completed", self._now(), body, message=text))
        path = command.path
        if path in self._detached and command in self._detached[path]:
            self._detached[path].remove(command)
            self._release(command)

    def interrupt(self, path: str, error: RcpError) -> None:
        """End the commands on a path whose backend is gone, with the reason."""
        for command in self._journal.running_on(path):
            if command.id in self._starts:
                self._unqueue(command)
                self._finish(command, error)
                continue
            if command in self._detached.get(path, ()):
                continue
            if command.task is not None:
                command.task.cancel()
            lost = LinkLost(error.message, origin=error.origin) if command.sent else error
            self._finish(command, lost)

    async def close(self) -> None:
        """Cancel all commands but those that go on without this gateway; wait a limited time."""
        ours = [c for c in self._journal.running.values() if c.continuation is None]
        tasks = [c.task for c in ours if c.task is not None]
        for command in ours:
            self.cancel(command, "the gateway is closing")
        if tasks:
            await asyncio.wait(tasks, timeout=_CANCEL_GRACE)


def _begins_at_once(entry: Entry) -> bool:
    """Return whether a command does not wait here: a robot's own gateway has the queue of its path."""
    return entry.parallel or (entry.owner.has_gateways and entry.resource.policy == "queue")


def _mismatch(entry: Entry, error: RcpError) -> RcpError:
    """Return the error for a result that does not match its type."""
    entry.owner.fault(f"result of {entry.path}: {error.message}")
    return DeviceRejected(
        f"the robot finished, but its result does not match its type: {error.message}",
        remedy="Correct the backend or the type that it declares.",
    )
