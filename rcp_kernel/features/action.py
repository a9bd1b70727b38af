"""Long-running actions of features: checked as a whole, in steps, then run as a command.

Examples are a recorder that records for ten seconds, or a trigger that waits for an event and then
commands a robot: such an action takes time and acts for the principal that requested it. As a
command it has feedback, a deadline, an end, an audit record and `cancel`, like a robot's action.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Any, Protocol, TypeVar

from rcp_kernel.access.conditions import Conditions
from rcp_kernel.features.services import ServiceKey
from rcp_kernel.model import Operation
from rcp_kernel.sessions.command import Command, Work
from rcp_kernel.sessions.session import Answer, Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.registry import Registry
from rcp_kernel.wire import Reply, Request
from rcp_scheduling.turns import Turns

__all__ = ["Action", "ActionHost", "ActionRun"]

T = TypeVar("T")


class ActionHost(Protocol):
    """The functions of the gateway that an action may use, for the session that requested it."""

    @property
    def loop(self) -> asyncio.AbstractEventLoop:
        """The event loop, with the gateway's monotonic time."""
        ...

    @property
    def turns(self) -> Turns:
        """Turns of the event loop; their owner is the session's `principal.identity`."""
        ...

    @property
    def registry(self) -> Registry:
        """The tree; the action must check the session's rights itself."""
        ...

    @property
    def conditions(self) -> Conditions:
        """Evaluates conditions, and keeps the values that they use published."""
        ...

    def service(self, key: ServiceKey[T]) -> T | None:
        """Return a service of another feature; None if no feature provides it."""
        ...

    def check_group(self, entries: Sequence[Entry]) -> None:
        """Check that a backend can write several paths as one.

        :raises NotImplementedByRobot: they are not of one group of one robot.
        """
        ...

    def resolve(self, session: Session, path: str, operation: Operation) -> Entry:
        """Return a resource on which a session may perform an operation, now or in another state.

        :raises UnknownPath: it does not exist, or is hidden.
        :raises Forbidden: the rules never allow it.
        """
        ...

    def is_personal(self, path: str) -> bool:
        """Return whether a resource shows each reader a different value."""
        ...

    def check_read(self, options: Any) -> None:
        """Validate the body of a `read`.

        :raises InvalidValue: it is invalid.
        """
        ...

    def foresee(
        self, session: Session, entry: Entry, value: Any, *, gained: bool, complete: bool
    ) -> None:
        """Refuse a later write or execute that would be refused in any case.

        `gained`: the action acquires control of the path before. `complete`: the value is already
        final.

        :raises RcpError: as for the request itself.
        """
        ...

    def goal(self, session: Session, entry: Entry, value: Any) -> Any:
        """Return the input of a later execute in the robot's own frame, as things are now.

        None if the goal is already in the robot's frame, or names no frame.

        :raises RcpError: as for the request itself.
        """
        ...

    def send(self, session: Session, request: Request, answer: Answer, /) -> None:
        """Handle a request as if the session's client had sent it, with all checks.

        `answer` receives every reply, exactly one of them final; possibly before this returns.
        """
        ...

    def prepare(self, session: Session, request: Request) -> Generator[None, None, Request]:
        """Check and decode a long body in steps; `send` then carries the request out at once.

        Whoever gives up meanwhile has sent nothing.

        :raises PayloadTooLarge: it has too many values.
        """
        ...

    def started_by(self, request: Request) -> Command | None:
        """Return the command that a request has started, by its `custom` field, while it runs."""
        ...

    def cancel(self, command: Command, reason: str) -> None:
        """Cancel a command: the robot is notified at once, the final status follows."""
        ...

    def disown(self, session: Session, id_: str) -> None:
        """Do not report a command to a resuming client: an action started it."""
        ...

    async def record_read(self, session: Session, request: Request, reply: Reply) -> None:
        """Record a read in the audit log; writes and commands are recorded automatically."""
        ...


class ActionRun(Work, Protocol):
    """One checked run of an action: the work of its command."""

    @property
    def input(self) -> Any:
        """The input, of the type of the resource's input."""
        ...

    @property
    def touches(self) -> tuple[str, ...]:
        """All paths that it affects.

        Principals that may not see one of them are not shown the command. If an e-stop stops the
        robot of one while the request waits for its turn, the command is refused.
        """
        ...

    def dry_run(self) -> Mapping[str, Any]:
        """Return the result of a dry run."""
        ...

    def begin(self, session: Session, request: Request, entry: Entry) -> None:
        """Make the last check before the command starts; may use up an approval."""
        ...


class Action(Protocol):
    """The implementation of `SystemResource.action`."""

    def admit(self, session: Session, running: Sequence[Command]) -> None:
        """Refuse a run beyond the limit; `running` are the unfinished commands of this action.

        :raises QueueFull: as many as allowed are running.
        """
        ...

    def prepare(
        self, session: Session, request: Request, entry: Entry, host: ActionHost
    ) -> Generator[None, None, ActionRun]:
        """Check a whole request, in steps of less than a millisecond, without changing anything.

        :raises RcpError: the request is invalid.
        """
        ...

    def stops(self, request: Request, is_stop: Callable[[Request], bool]) -> bool:
        """Return whether a request only brings robots to rest, so that no quota delays it.

        `is_stop` decides that for another request of the same session. Must be fast for any input.
        """
        ...

    def show(self, command: Command) -> Any:
        """Return a command as the action's list shows it, of the list's item type."""
        ...
