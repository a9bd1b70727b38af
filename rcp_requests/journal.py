"""The journal of commands: each step is recorded once and reported in a fixed order.

A step is added to the command's history, then passed to the store, to the listeners of all commands
(such as the audit log), and finally to the followers of the command. So no client sees a step before
it is recorded; features decide whether its reply waits until the record is stored (`ReplyGate`).
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from itertools import product
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import structlog

from rcp_kernel.clock import Clock
from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.metrics import Histogram, RequestCounts
from rcp_kernel.sessions.command import Command, CommandListener, Record
from rcp_kernel.sessions.long_value import SCALARS, LongValue
from rcp_kernel.values import Encoding, dump
from rcp_kernel.wire import FINAL, NO_BODY, Request
from rcp_requests.command_rows import TABLE, as_row, cut_off, from_rows, row_key
from rcp_requests.idempotency import committed
from rcp_requests.replies import ReplyGate
from rcp_store.store import Store

if TYPE_CHECKING:
    from rcp_kernel.sessions.session import Answer, OwnCommand, Session

__all__ = ["CommandJournal"]

log = structlog.get_logger("rcp.commands")
_HISTORY = 64  # steps kept per command, always including the first and last
_FOLLOWED = 256  # own commands remembered per session
_KEPT = 1000  # finished commands
_BYTES = 32 * 1024 * 1024  # of the inputs, feedback and results of all finished commands
_EMPTY = 1024  # bytes that any command counts for, numbers included


@runtime_checkable
class Idle(Protocol):
    """What may have nothing to do for a time."""

    @property
    def idle(self) -> bool:
        """Whether a step would change nothing for it now."""
        ...


class StepListener(Protocol):
    """A feature that hears each step of all commands."""

    on_command: CommandListener
    state: Idle
    """While it is idle, the feature is not called."""
    hears_feedback: bool

    def missed_step(self, command: Command, step: Record, error: Exception, /) -> None:
        """Handle a step at which the feature failed."""
        ...


class CommandJournal:
    """All commands of the gateway: running, queued and recently finished."""

    def __init__(
        self,
        store: Store,
        settings: Settings,
        counts: RequestCounts,
        replies: ReplyGate,
        clock: Clock,
    ) -> None:
        """Load the commands of earlier runs.

        Interrupted ones become `failed`, but for those that go on without this gateway.
        """
        self._store = store
        self._settings = settings
        self._requests = counts
        self._replies = replies
        self._now = clock.now
        self.listeners: list[StepListener] = []
        """Listeners of all commands, called before followers."""
        self.running: dict[str, Command] = {}
        """Commands that have not ended, by id."""
        self._by_path: dict[str, dict[str, Command]] = {}
        """The same, by path; no empty ones."""
        self.interrupted: list[Command] = []
        """Commands interrupted by the end of the previous run."""
        self.counts: dict[tuple[str, str], int] = {}
        """Ended commands by path and final status."""
        self.seconds = Histogram()
        self._finished = _Finished(self._forget)
        self._load()

    def _load(self) -> None:
        for command in from_rows(self._store.load(TABLE)):
            if not command.final and command.continuation is not None:
                self._begin(command)
                continue
            if not command.final:
                cut_off(command, self._now())
                self.keep(command)
                self.interrupted.append(command)
            self._finished.add(command)

    def find(self, id_: str) -> Command | None:
        """Return a command by the gateway's id."""
        return self.running.get(id_) or self._finished.get(id_)

    def running_on(self, path: str) -> tuple[Command, ...]:
        """Return the commands on a path that have not ended, oldest first."""
        found = self._by_path.get(path)
        return () if found is None else tuple(found.values())

    def every(self) -> list[Command]:
        """Return all known commands, newest first."""
        return [*reversed(self.running.values()), *self._finished.newest_first()]

    def write(self, command: Command, step: Record) -> None:
        """Record and report a step; the first one adds the command, a final one closes it."""
        status, history = step.status, command.history
        if not history:
            self._begin(command)
        history.append(step)
        if len(history) > _HISTORY:
            del history[1]
        if status in FINAL:
            self._close(command, step)
        if status != "in_progress" and self._store.keeps:
            self.keep(command)
        for listener in self.listeners:
            if status == "in_progress" and not listener.hears_feedback:
                continue
            try:
                if not listener.state.idle:
                    listener.on_command(command, step)
            except Exception as error:  # a feature must not prevent commands or stops
                listener.missed_step(command, step, error)
        for follower in tuple(command.followers):
            follower(command, step)
        if status in FINAL:
            command.requester = command.request = command.work = None
            command.followers.clear()

    def _begin(self, command: Command) -> None:
        self.running[command.id] = command
        self._by_path.setdefault(command.path, {})[command.id] = command

    def _close(self, command: Command, last: Record) -> None:
        command.finished = last.time
        if self.running.pop(command.id, None) is not None:
            here = self._by_path[command.path]
            del here[command.id]
            if not here:
                del self._by_path[command.path]
        self._finished.add(command)
        key = command.path, last.status
        self.counts[key] = self.counts.get(key, 0) + 1
        self.seconds.observe((last.time - command.created) / 1e9)

    def keep(self, command: Command) -> None:
        """Store a command's current state."""
        try:
            row = as_row(command)
        except Exception:  # the command continues whether or not it can be stored
            log.exception("store_failed", command=command.id, path=command.path)
            return
        if command.row is None:
            command.row = row_key()
        self._store.put(TABLE, command.row, row)

    async def committed(self) -> None:
        """Wait until the commands are stored as they are now."""
        await committed(self._store)

    def _forget(self, command: Command) -> None:
        if command.row is not None:
            self._store.put(TABLE, command.row, None)

    def tell_cut_off(self) -> None:
        """Report the interrupted commands to the listeners of all commands."""
        for command, listener in product(self.interrupted, self.listeners):
            step = command.history[-1]
            try:
                listener.on_command(command, step)
            except Exception as error:
                listener.missed_step(command, step, error)

    def follow(
        self, command: Command, session: Session, request: Request, answer: Answer, started: float
    ) -> None:
        """Answer a request with the steps of a command, starting with its latest one.

        :raises DuplicateRequest, QueueFull: see `Session.in_flight_key`.
        """
        key = session.in_flight_key(request, self._settings.limits.in_flight)
        session.inflight.add(key)
        if self._replies.demands:
            answer = self._replies.when_stored(answer, request)
        if session.connection is not None or not session.stateless:
            session.commands[command.id] = command
            if len(session.commands) > _FOLLOWED:
                _forget_finished(session.commands)

        def on_step(command: Command, step: Record) -> None:
            reply = command.reply(step)
            reply.id = request.id  # others may follow the same command with their own request ids
            if step.status in FINAL:
                session.inflight.discard(key)
                self._requests.conclude(session.transport, reply, started)
            answer(reply)

        history = command.history
        if not history or not command.final:
            command.followers.append(on_step)
        if history:
            on_step(command, history[-1])


def _forget_finished(commands: dict[str, OwnCommand]) -> None:
    known = [id_ for id_, command in commands.items() if command.finished is not None]
    for id_ in known[: _FOLLOWED // 2]:
        del commands[id_]


class _Finished:
    """The commands that ended last, by id; `forget` is called for each that is removed."""

    def __init__(self, forget: Callable[[Command], None]) -> None:
        self._forget = forget
        self._known: OrderedDict[str, Command] = OrderedDict()
        self._sizes: dict[str, int] = {}
        self._bytes = 0

    def get(self, id_: str) -> Command | None:
        """Return a command by the gateway's id."""
        return self._known.get(id_)

    def newest_first(self) -> list[Command]:
        """Return the finished commands, the one that ended last first."""
        return list(reversed(self._known.values()))

    def add(self, command: Command) -> None:
        """Remember a command, at the cost of the oldest."""
        size = _EMPTY
        if not isinstance(command.input, SCALARS):
            size += _length(command.input)
        for step in command.history:
            if step.body is not NO_BODY and not isinstance(step.body, SCALARS):
                size += _length(step.body)
        self._known[command.id] = command
        self._sizes[command.id] = size
        self._bytes += size
        while len(self._known) > _KEPT or (self._bytes > _BYTES and len(self._known) > 1):
            id_, oldest = self._known.popitem(last=False)
            self._bytes -= self._sizes.pop(id_)
            self._forget(oldest)


def _length(value: Any) -> int:
    if isinstance(value, LongValue):
        return value.size
    try:
        return len(dump(value, Encoding.MSGPACK))
    except Exception:  # what cannot be encoded is not shown to clients either
        return _EMPTY
