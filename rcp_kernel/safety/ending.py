"""The end of what drives robots that are brought to rest as a whole."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from typing import Any

from rcp_kernel.safety.deadman import Deadman
from rcp_kernel.sessions.command import Command, CommandTable
from rcp_kernel.tree.entry import Entry

__all__ = ["end_commands"]


def end_commands(
    deadman: Deadman,
    commands: CommandTable,
    entries: Iterable[Entry],
    concerns: Callable[[Command], bool],
    reason: str,
) -> list[asyncio.Task[Any]]:
    """Cancel the writes to entries that move, and the commands concerned; return at once.

    The returned tasks have not ended yet: their last messages may still reach a robot.
    """
    ending = [task for e in entries if e.moves for task in deadman.cancel_writes(e)]
    for command in list(commands.running.values()):
        if concerns(command):
            if command.task is not None:
                ending.append(command.task)
            commands.cancel(command, reason)
    return ending
