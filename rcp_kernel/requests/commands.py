"""The life of an execute: accepted → pending → in_progress → completed | failed | rejected | cancelled.

The kernel derives every status from the life of one coroutine, `Backend.execute`, so that no
plugin can send an illegal sequence. A command has an id of the gateway's own, outlives its
connection, and is remembered after its end.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, Protocol

from rcp_kernel.clock import now
from rcp_kernel.contract.fence import permitted
from rcp_kernel.contract.metrics import Histogram
from rcp_kernel.contract.turns import Turns
from rcp_kernel.errors import (
    AlreadyRunning,
    Cancelled,
    DeadlineExceeded,
    DeviceRejected,
    QueueFull,
    RcpError,
    Refused,
)
from rcp_kernel.model import Kind
from rcp_kernel.requests.finished import Finished
from rcp_kernel.safety.loss import tell_loss
from rcp_kernel.sessions.command import (
    Command,
    CommandListener,
    Record,
    outcome_of,
    status_of,
)
from rcp_kernel.sessions.long_value import checked
from rcp_kernel.spi import Backend
from rcp_kernel.tree.entry import Entry
from rcp_kernel.values import is_long
from rcp_kernel.wire import FINAL, NO_BODY, error_body

if TYPE_CHECKING:
    from rcp_kernel.sessions.session import Session

__all__ = ["CommandObserver", "Commands"]


Confirm = Callable[[], Backend]
"""Returns the robot that takes a command, or refuses it by now."""
_QUEUE = 16  # commands that wait for one path
_HISTORY = 64  # replies kept of one command; first and last are always among them
_CANCEL_GRACE = 5.0  # s a backend has to bring a cancelled command to rest


class CommandObserver(Protocol):
    """Where commands are written down so that a restart finds them."""

    def save(self, command: Command) -> None:
        """Note the command's present state; must not block."""
        ...

    def forget(self, command: Command) -> None:
        """Let go of a command that is not remembered any more; must not block."""
        ...


class Commands:
    """Every command of the gateway: running, queued, and the recently finished."""

    def __init__(
        self, keeper: CommandObserver, began: Callable[[Entry], None], turns: Turns
    ) -> None:
        """Note commands with `keeper`; `began` is told before one runs, and must cost nothing."""
        self.on_step: list[CommandListener] = []
        """Those who listen to all commands; they raise nothing."""
        self.running: dict[str, Command] = {}
        self.finished = Finished(keeper.forget)
        self.counts: dict[tuple[str, str], int] = {}
        """Ended commands by path and final status."""
        self.seconds = Histogram()
        self.keeper = keeper
        self._began = began
        self._turns = turns
        self._active: dict[str, Command] = {}
        """The command that holds each path, where the policy allows only one."""
        self._queues: dict[str, deque[Command]] = {}
        self._starts: dict[str, Callable[[], None]] = {}

    def find(self, id_: str) -> Command | None:
        """Return a command by the gateway's id."""
        return self.running.get(id_) or self.finished.get(id_)

    def every(self) -> list[Command]:
        """Return all that are known, newest first."""
        return [*reversed(self.running.values()), *self.finished.newest_first()]

    def remember(self, commands: Iterable[Command]) -> None:
        """Take in finished commands of an earlier run."""
        for command in commands:
            self.finished.add(command)

    def admit(self, entry: Entry) -> None:
        """Refuse a command that the path's policy does not allow now.

        :raises AlreadyRunning: one is running and the policy is `reject`.
        :raises QueueFull: too many wait already.
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
            f"action '{entry.path}' is currently in progress; rejecting duplicate request",
            path=entry.path,
            details={"command": busy.id},
        )

    def start(
        self,
        command: Command,
        asker: Session,
        entry: Entry,
        value: Any,
        timeout: float | None,
        deadline: float | None = None,
        *,
        confirm: Confirm,
    ) -> None:
        """Accept an admitted command and run it, now or when the path is free.

        It has `timeout` seconds from then on, and `deadline` from now on. `confirm` is asked when
        its turn comes: the world may have changed while it waited.
        """
        command.asker = asker
        command.entry = entry
        self.running[command.id] = command
        self._note(command, Record("accepted", now(), message="Command accepted."))

        def begin() -> None:
            self._run(command, asker, entry, value, timeout, confirm)

        busy = self._active.get(entry.path)
        if busy is None or self._shared(entry):
            begin()
            return
        self._note(
            command,
            Record("pending", now(), message=f"Waiting for command {busy.id} on {entry.path}."),
        )
        queue = self._queues.setdefault(entry.path, deque())
        self._starts[command.id] = begin
        if entry.resource.policy == "preempt":
            for waiting in list(queue):
                self.cancel(waiting, "preempted by a newer command")
            self.cancel(busy, "preempted by a newer command")
        self._queues.setdefault(entry.path, deque()).append(command)
        if deadline is not None:
            loop = asyncio.get_running_loop()
            command.timer = loop.call_later(deadline, self._expire, command, deadline)

    @staticmethod
    def _shared(entry: Entry) -> bool:
        """Whether the path runs any number at once: services do unless they say otherwise."""
        policy = entry.resource.policy
        return policy == "parallel" or (policy is None and entry.kind is Kind.SERVICE)

    def _run(
        self,
        command: Command,
        asker: Session,
        entry: Entry,
        value: Any,
        timeout: float | None,
        confirm: Confirm,
    ) -> None:
        self._began(entry)
        if not self._shared(entry):
            self._active[entry.path] = command
        if entry.moves:
            entry.unit.lost = None
        loop = asyncio.get_running_loop()
        command.task = loop.create_task(
            self._call(command, asker, entry, value, confirm), name=f"command {command.id}"
        )
        if timeout and command.timer is None:
            command.timer = loop.call_later(timeout, self._expire, command, timeout)
        command.task.add_done_callback(lambda task: self._ended(command, task))

    async def _call(
        self, command: Command, asker: Session, entry: Entry, value: Any, confirm: Confirm
    ) -> Any:
        work, stops = command.work, entry.unit.stops
        if command.ready is not None:
            await command.ready()
        if command.unrecorded and not entry.is_hold:
            raise QueueFull(
                f"the audit record of {entry.path} could not be written; it was not begun",
                remedy="Ask the operator to look into the log of the gateway.",
            )
        backend = confirm()

        def progress(feedback: Any = None, *, fraction: float | None = None) -> None:
            if not command.final:
                self._progress(command, entry, feedback, fraction)

        if work is not None:
            result = await work.run(command, asker, progress)
        else:
            with permitted(entry.unit, stops):
                result = await backend.execute(entry.name, value, progress)
        try:
            if work is None and is_long(result):
                owner = asker.principal.identity
                return await self._turns.finish(owner, checked(entry.output_type, result))
            return entry.output_type.check(result)[0] if result is not None else None
        except RcpError as error:
            entry.owner.fault(f"result of {entry.path}: {error.message}")
            raise DeviceRejected(
                f"the robot finished, but its result does not match its type: {error.message}",
                remedy="Correct the backend or the type that it declares.",
            ) from error

    def _progress(
        self, command: Command, entry: Entry, feedback: Any, fraction: float | None
    ) -> None:
        body: Any = NO_BODY
        if feedback is not None:
            try:
                body = entry.feedback_type.check(feedback)[0]
            except RcpError as error:
                entry.owner.fault(f"feedback of {entry.path}: {error.message}")
                return
        if fraction is not None:
            fraction = min(1.0, max(0.0, fraction))
        self._note(command, Record("in_progress", now(), body, fraction))

    def _expire(self, command: Command, timeout: float) -> None:
        """End a command in time for its client, whatever the backend makes of the cancel."""
        if command.final:
            return
        command.expired = True
        if command.task is None:
            self._unqueue(command)
            what = f"did not start within {timeout:g} s: other commands were ahead of it"
        else:
            command.task.cancel()
            what = f"did not finish within {timeout:g} s; the robot was told to stop"
        self._end(command, DeadlineExceeded(f"{command.path} {what}", path=command.path))

    def _unqueue(self, command: Command) -> None:
        del self._starts[command.id]
        self._queues[command.path].remove(command)

    def cancel(self, command: Command, reason: str) -> None:
        """Have a command cancelled: the robot is told at once, the final status follows."""
        if command.final or command.cancelling is not None:
            return
        command.cancelling = reason
        if command.id in self._starts:
            self._unqueue(command)
            self._end(
                command, Cancelled(f"{command.path} was cancelled: {reason}", path=command.path)
            )
        elif command.task is not None:
            command.task.cancel()
            asyncio.get_running_loop().call_later(_CANCEL_GRACE, self._give_up, command)

    def withdraw(self, command: Command, error: Refused) -> None:
        """End a command that has lost its ground: refused if it waits, else cancelled."""
        if command.id in self._starts:
            self._unqueue(command)
            self._end(command, error)
        else:
            self.cancel(command, error.message)

    def _give_up(self, command: Command) -> None:
        if not command.final:
            self._end(
                command,
                DeadlineExceeded(
                    f"{command.path} was cancelled, but the backend has not confirmed it for "
                    f"{_CANCEL_GRACE:g} s",
                    path=command.path,
                    remedy="Check the robot: it may still be moving. Use the e-stop if in doubt.",
                ),
            )

    def _ended(self, command: Command, task: asyncio.Task[Any]) -> None:
        if not command.final:
            self._end(command, outcome_of(command, task))
        elif not task.cancelled():
            task.exception()  # looked at, so that asyncio does not report it as lost
        if self._active.get(command.path) is command:
            del self._active[command.path]
            self._next(command.path)

    def _next(self, path: str) -> None:
        queue = self._queues.get(path)
        if not queue:
            self._queues.pop(path, None)
            return
        following = queue.popleft()
        if not queue:
            del self._queues[path]
        self._starts.pop(following.id)()

    def _end(self, command: Command, outcome: Any) -> None:
        if isinstance(outcome, RcpError):
            outcome.path = outcome.path or command.path
            if outcome.origin is None and command.entry is not None:
                outcome.origin = command.entry.owner.name
            if command.task is not None and command.entry is not None:
                tell_loss(command.entry, outcome)
            status: Any = status_of(command, outcome)
            body = NO_BODY if command.work is None else command.work.report(over=True)
            record = Record(status, now(), body, message=outcome.message, error=error_body(outcome))
        else:
            body = NO_BODY if outcome is None else outcome
            text = f"Command {command.path} executed successfully."
            record = Record("completed", now(), body, message=text)
        command.finished = record.time
        if command.timer is not None:
            command.timer.cancel()
            command.timer = None
        self._note(command, record)
        command.asker = command.request = command.work = None
        command.followers.clear()

    def _note(self, command: Command, record: Record) -> None:
        history = command.history
        history.append(record)
        if len(history) > _HISTORY:
            del history[1]
        if record.status in FINAL:
            self.running.pop(command.id, None)
            self.finished.add(command)
            key = command.path, record.status
            self.counts[key] = self.counts.get(key, 0) + 1
            self.seconds.observe((record.time - command.created) / 1e9)
        if record.status != "in_progress":
            self.keeper.save(command)
        self.tell(command, record)
        if command.followers:
            reply = command.reply(record)
            for follower in list(command.followers):
                follower(reply)

    def tell(self, command: Command, record: Record) -> None:
        """Tell a step to those who listen to all commands."""
        for hear in self.on_step:
            hear(command, record)

    def interrupt(self, path: str, error: RcpError) -> None:
        """End what runs on a path whose backend is gone, with the reason."""
        for command in [c for c in self.running.values() if c.path == path]:
            if command.id in self._starts:
                self._unqueue(command)
            elif command.task is not None:
                command.task.cancel()
            self._end(command, error)

    async def close(self) -> None:
        """Cancel everything that runs, and wait a bounded time for it."""
        tasks = [c.task for c in self.running.values() if c.task is not None]
        for command in list(self.running.values()):
            self.cancel(command, "the gateway is closing")
        if tasks:
            await asyncio.wait(tasks, timeout=_CANCEL_GRACE)
