"""Control of commands: withdraw from a holder, hand over, cancel, bring to rest.

For features that decide who has control, or where robots may be. A holder is a session, or a
principal as a whole: `Session.holder`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack

from rcp_kernel.errors import Refused
from rcp_kernel.model import Kind, Operation
from rcp_kernel.safety.deadman import Deadman
from rcp_kernel.safety.ending import end_commands
from rcp_kernel.safety.retry import retry_until_confirmed
from rcp_kernel.sessions.command import Command, CommandTable
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry, Owner

__all__ = ["Control"]

Within = Callable[[str], bool]
"""Returns whether a full path is concerned."""


class Control:
    """Ends or hands over the commands of holders that have lost control."""

    def __init__(self, commands: CommandTable, deadman: Deadman) -> None:
        self._commands = commands
        self._deadman = deadman

    def withdraw(self, holder: str, within: Within, error: Callable[[str], Refused]) -> None:
        """End the commands that a holder has running or waiting on some paths; returns at once.

        One that waits is refused with the `error` for its path; one that runs is cancelled.
        """
        for command in self._commanded(holder, within):
            self._commands.withdraw(command, error(command.path))

    def hand_over(self, holder: str, within: Within, heir: Session) -> None:
        """Transfer a holder's running commands on some paths to another session."""
        for command in self._commanded(holder, within):
            command.requester, command.session = heir, heir.id
            if not heir.stateless:
                heir.commands[command.id] = command

    def running(self, path: str | None = None) -> Iterator[Command]:
        """Iterate over the commands that run: on one path, without a walk over all, or on all."""
        table = self._commands
        found = list(table.running.values()) if path is None else table.running_on(path)
        return (command for command in found if command.task is not None)

    def cancel(self, command: Command, reason: str) -> None:
        """Cancel a command: the robot is notified at once."""
        self._commands.cancel(command, reason)

    def stop(self, entry: Entry) -> None:
        """Bring an actuator to its safe value; returns at once.

        It is repeated until the robot confirms it. Does nothing for an actuator without a safe
        value.
        """
        if entry.resource.safe is not None:
            self._deadman.stop(entry)

    @property
    def in_force(self) -> set[str]:
        """The paths with a write that is valid for a time, in flight, or to be stopped."""
        return self._deadman.paths

    def is_in_force(self, entry: Entry) -> bool:
        """Return whether a command, or a stop that is not confirmed, is in force on an actuator."""
        return self._deadman.is_in_force(entry)

    def end_stopped(self, owner: Owner, reason: str) -> asyncio.Task[None] | None:
        """End the commands of a backend whose robots were stopped by something else.

        Nothing that was admitted before reaches them. Return the hold that keeps them at rest until
        they confirm it or it is cancelled; None without a connection.
        """
        whole = owner.unit(None)
        whole.count_stop()
        end_commands(
            self._deadman,
            self._commands,
            owner.entries.values(),
            lambda one: one.entry is not None and one.entry.owner is owner and one.entry.barred,
            reason,
        )
        if owner.backend is None:
            return None
        held = ExitStack()  # from now on, not from when the task first runs
        held.enter_context(whole.bringing_to_rest())
        hold = retry_until_confirmed(whole.hold, "hold_failed", backend=owner.name)
        hold.add_done_callback(lambda _: held.close())
        return hold

    def bring_to_rest(self, entries: Iterable[Entry]) -> None:
        """Stop the values in force or in flight on some resources; returns at once.

        An actuator gets its safe value, repeated until the robot confirms it; any other write in
        progress is cancelled.
        """
        deadman, commanded = self._deadman, self._deadman.paths
        for entry in entries:
            moves = entry.kind is Kind.ACTUATOR and bool(entry.operations & Operation.WRITE)
            if moves and deadman.is_in_force(entry):
                deadman.stop(entry)
            elif entry.path in commanded:
                deadman.cancel_pending(entry)

    def _commanded(self, holder: str, within: Within) -> list[Command]:
        return [
            command
            for command in self._commands.running.values()
            if command.requester is not None
            and holder in command.requester.holders
            and within(command.path)
        ]
