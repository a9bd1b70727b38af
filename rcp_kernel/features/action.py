"""Long-running actions of the gateway's own: checked whole in steps, then run as a command.

A recorder that records for ten seconds, a trigger that waits for its event and then commands a robot:
what such an action does takes time and happens in the name of whoever asked for it. As a command it
has feedback, a deadline, an end, a record and a `cancel`, like the actions of robots.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Any, Protocol, TypeVar

from rcp_kernel.access.conditions import Conditions
from rcp_kernel.contract.turns import Turns
from rcp_kernel.features.services import ServiceKey
from rcp_kernel.model import Operation
from rcp_kernel.sessions.command import Command, Work
from rcp_kernel.sessions.session import Answer, Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.registry import Registry
from rcp_kernel.wire import Reply, Request

__all__ = ["Action", "ActionHost", "ActionRun"]

T = TypeVar("T")


class ActionHost(Protocol):
    """What an action may use of the gateway, in the name of the session that asked for it."""

    @property
    def loop(self) -> asyncio.AbstractEventLoop:
        """The event loop, with the gateway's monotonic time."""
        ...

    @property
    def turns(self) -> Turns:
        """The time of the event loop; its owner is the session's `principal.identity`."""
        ...

    @property
    def registry(self) -> Registry:
        """The tree. What a session may see of it is for the action to ask the session's rights."""
        ...

    @property
    def conditions(self) -> Conditions:
        """Evaluates conditions, and keeps the values coming that they name."""
        ...

    def service(self, key: ServiceKey[T]) -> T | None:
        """Return what another feature offers; None where no feature does."""
        ...

    def resolve(self, session: Session, path: str, operation: Operation) -> Entry:
        """Return a resource on which a session may do something, now or in another state.

        :raises UnknownPath: it is not there, or hidden.
        :raises Forbidden: the rules never allow it.
        """
        ...

    def is_personal(self, path: str) -> bool:
        """Tell whether a resource shows each reader something else."""
        ...

    def check_read(self, options: Any) -> None:
        """Refuse what is no body of a `read`.

        :raises InvalidValue: it is none.
        """
        ...

    def foresee(
        self, session: Session, entry: Entry, value: Any, *, gained: bool, complete: bool
    ) -> None:
        """Refuse a later write or execute that would be refused whatever happens until then.

        `gained` says that the action gets control of the path itself before, `complete` that the
        value is known already.

        :raises RcpError: as the request itself would be refused.
        """
        ...

    def send(self, session: Session, request: Request, answer: Answer, /) -> None:
        """Have a request handled as if the session's client had sent it: it passes all checks.

        `answer` gets every reply, exactly one of them final; maybe before this returns.
        """
        ...

    def started_by(self, request: Request) -> Command | None:
        """Return the command that a request has started, by its `custom`, while it runs."""
        ...

    def cancel(self, command: Command, reason: str) -> None:
        """Have a command cancelled: the robot is told at once, the final status follows."""
        ...

    def disown(self, session: Session, id_: str) -> None:
        """Have a client that comes back not told of a command that an action started for it."""
        ...

    async def record_read(self, session: Session, request: Request, reply: Reply) -> None:
        """Record what was read for a session; writes and commands go on record by themselves."""
        ...


class ActionRun(Work, Protocol):
    """One checked run of an action: the work of its command."""

    @property
    def input(self) -> Any:
        """What was asked for, of the type of the resource's input."""
        ...

    @property
    def touches(self) -> tuple[str, ...]:
        """All paths that it is about.

        Who may not see one is not told of the command. If an e-stop stops the robot of one while the
        request waits for its turn, the command is refused.
        """
        ...

    def dry_run(self) -> Mapping[str, Any]:
        """Return what a dry run tells."""
        ...

    def begin(self, session: Session, request: Request, entry: Entry) -> None:
        """Refuse the command as the last to be asked, or use up what lets it pass once."""
        ...


class Action(Protocol):
    """What `SystemResource.action` does."""

    def admit(self, session: Session, running: Sequence[Command]) -> None:
        """Refuse one run too many; `running` are the commands of this action that have not ended.

        :raises QueueFull: there are as many as may be.
        """
        ...

    def prepare(
        self, session: Session, request: Request, entry: Entry, host: ActionHost
    ) -> Generator[None, None, ActionRun]:
        """Check a request whole, in steps of less than a millisecond, and change nothing.

        :raises RcpError: something is wrong with it.
        """
        ...

    def stops(self, request: Request, is_stop: Callable[[Request], bool]) -> bool:
        """Tell whether a request does nothing but bring robots to rest: no quota holds it up then.

        `is_stop` tells it of another request of the same session. Must be quick, whatever it is given.
        """
        ...

    def show(self, command: Command) -> Any:
        """Return what the list of the action's commands has of one, of the type of its items."""
        ...
