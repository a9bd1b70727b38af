"""The journal of commands: each step is written once, and told in one order.

A step goes into the command's history, to the store, to those who hear of all commands (the audit
log among them), and last to those who follow this one. So no client hears of a step before it is on
record; whether its reply waits until the record is kept is for features to say (`ReplyGate`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import structlog

from rcp_kernel.clock import Clock
from rcp_kernel.contract.metrics import Histogram
from rcp_kernel.requests.command_rows import TABLE, as_row, cut_off, from_rows
from rcp_kernel.requests.finished import Finished
from rcp_kernel.requests.inflight import InFlight
from rcp_kernel.requests.replies import ReplyGate
from rcp_kernel.sessions.command import Command, CommandListener, Record
from rcp_kernel.sessions.counts import RequestCounts
from rcp_kernel.store.store import Store
from rcp_kernel.wire import FINAL, Request

if TYPE_CHECKING:
    from rcp_kernel.sessions.session import Answer, OwnCommand, Session

__all__ = ["CommandJournal"]

log = structlog.get_logger("rcp.commands")
_HISTORY = 64  # steps kept of one command; first and last are always among them
_FOLLOWED = 256  # commands that a session knows as its own


class CommandJournal:
    """Every command of the gateway: running, waiting, and the recently finished."""

    def __init__(
        self,
        store: Store,
        inflight: InFlight,
        counts: RequestCounts,
        replies: ReplyGate,
        clock: Clock,
    ) -> None:
        """Take in the commands of earlier runs; those that were cut off are `failed` now."""
        self._store = store
        self._inflight = inflight
        self._requests = counts
        self._replies = replies
        self._now = clock.now
        self.on_step: list[CommandListener] = []
        """Who hears of each step of each command, before its followers do; they raise nothing."""
        self.running: dict[str, Command] = {}
        """Those that have not ended, by id."""
        self.cut_off: list[Command] = []
        """Those that the end of the earlier run cut off."""
        self.counts: dict[tuple[str, str], int] = {}
        """Ended commands by path and final status."""
        self.seconds = Histogram()
        self._finished = Finished(self._forget)
        self._load()

    def _load(self) -> None:
        for command in from_rows(self._store.load(TABLE).values()):
            if not command.final:
                cut_off(command, self._now())
                self.keep(command)
                self.cut_off.append(command)
            self._finished.add(command)

    def find(self, id_: str) -> Command | None:
        """Return a command by the gateway's id."""
        return self.running.get(id_) or self._finished.get(id_)

    def every(self) -> list[Command]:
        """Return all that are known, newest first."""
        return [*reversed(self.running.values()), *self._finished.newest_first()]

    def open(self, command: Command) -> None:
        """Write a command down that is accepted."""
        self.running[command.id] = command
        self.write(command, Record("accepted", self._now(), message="Command accepted."))

    def write(self, command: Command, step: Record) -> None:
        """Write a step down, and tell of it; a final one closes the command."""
        status, history = step.status, command.history
        history.append(step)
        if len(history) > _HISTORY:
            del history[1]
        if status in FINAL:
            self._close(command, step)
        if status != "in_progress" and self._store.keeps:
            self.keep(command)
        for hear in self.on_step:
            hear(command, step)
        for follower in tuple(command.followers):
            follower(command, step)
        if status in FINAL:
            command.asker = command.request = command.work = None
            command.followers.clear()

    def _close(self, command: Command, last: Record) -> None:
        command.finished = last.time
        self.running.pop(command.id, None)
        self._finished.add(command)
        key = command.path, last.status
        self.counts[key] = self.counts.get(key, 0) + 1
        self.seconds.observe((last.time - command.created) / 1e9)

    def keep(self, command: Command) -> None:
        """Have the store keep a command's present state."""
        try:
            row = as_row(command)
        except Exception:  # the command goes on, whether it can be written down or not
            log.exception("store_failed", command=command.id, path=command.path)
            return
        self._store.put(TABLE, command.id, row)

    def _forget(self, command: Command) -> None:
        self._store.put(TABLE, command.id, None)

    def tell_cut_off(self) -> None:
        """Tell those who hear of all commands which ones the end of the earlier run cut off."""
        for command in self.cut_off:
            for hear in self.on_step:
                hear(command, command.history[-1])

    def follow(
        self, command: Command, session: Session, request: Request, answer: Answer, started: float
    ) -> None:
        """Have a request answered by a command's steps, the latest of its past included.

        :raises DuplicateRequest, QueueFull: as `InFlight.claim` does.
        """
        key = self._inflight.claim(session, request)
        answer = self._replies.held(answer, request)
        if not session.stateless:
            session.commands[command.id] = command
            if len(session.commands) > _FOLLOWED:
                _forget_finished(session.commands)

        def on_step(command: Command, step: Record) -> None:
            reply = command.reply(step)
            reply.id = request.id  # others may follow the same command under ids of theirs
            if step.status in FINAL:
                session.inflight.pop(key, None)
                self._requests.conclude(session, reply, started)
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
