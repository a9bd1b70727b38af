"""One command: its steps from the request to the one final status, and how clients are notified of them."""

from __future__ import annotations

import asyncio
import os
import secrets
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import msgspec

from rcp_kernel.access.visibility import names_in
from rcp_kernel.clock import iso, now
from rcp_kernel.contract.identity import Grants
from rcp_kernel.contract.paths import is_system
from rcp_kernel.errors import Refused
from rcp_kernel.sessions.long_value import plain
from rcp_kernel.sessions.substitutes import unrecorded
from rcp_kernel.spi import Progress
from rcp_kernel.tree.entry import Entry
from rcp_kernel.values import ANY, Encoding
from rcp_kernel.wire import FINAL, NO_BODY, Body, Reply, Request, Status
from rcp_protocol.trace import Trace, traced

if TYPE_CHECKING:
    from rcp_kernel.sessions.session import Session

__all__ = [
    "Command",
    "CommandListener",
    "CommandTable",
    "Continuation",
    "Record",
    "Work",
    "command_id",
]

_RANDOM = 1024  # bytes
_numbers: list[str] = []
"""Random numbers for ids, each used once."""
_SHORT = 16_384  # bytes of a command that are kept as they are written


class Work(Protocol):
    """What the gateway itself carries out as a command."""

    async def run(self, command: Command, session: Session, progress: Progress) -> Any:
        """Do it, in the name of whoever sent the command, and return its result."""
        ...

    def report(self, *, over: bool) -> Any:
        """Return how far it has come; with `over` it goes no further."""
        ...

    def outline(self, report: Any) -> Mapping[str, Any] | None:
        """Return what the audit log keeps of a report or a result; None for the whole of it.

        Values that belong to other paths are in the records of those paths.
        """
        ...


class CommandTable(Protocol):
    """The commands of the gateway, for code that ends commands whose control was withdrawn."""

    @property
    def running(self) -> Mapping[str, Command]:
        """Those that have not ended, by id."""
        ...

    def running_on(self, path: str) -> Sequence[Command]:
        """Return those of one path that have not ended, oldest first."""
        ...

    def every(self) -> Iterable[Command]:
        """Go through all that are known, newest first."""
        ...

    def cancel(self, command: Command, reason: str) -> None:
        """Cancel a command; the robot is notified immediately and the final status follows."""
        ...

    def withdraw(self, command: Command, error: Refused) -> None:
        """End a command whose control was withdrawn: refused if it waits, else cancelled."""
        ...


class Record(msgspec.Struct, gc=False):
    """What is remembered of one step of a command.

    No reference cycles, so they are exempt from the garbage collector (`gc=False`).
    """

    status: Status
    time: int
    body: Any = NO_BODY
    progress: float | None = None
    message: str | None = None
    error: dict[str, Any] | None = None

    def plain(self) -> dict[str, Any]:
        """Write the step as plain data."""
        out: dict[str, Any] = {"status": self.status, "timestamp": iso(self.time)}
        if self.body is not NO_BODY:
            out["body"] = plain(self.body)
        for key in ("progress", "message", "error"):
            if (value := getattr(self, key)) is not None:
                out[key] = value
        return out


class _Listed(Body):
    """A command as lists tell of it; what has ended and is short is written once."""

    __slots__ = ("_command", "_written")

    def __init__(self, command: Command) -> None:
        self._command = command
        self._written: dict[Encoding, bytes] = {}

    @property
    def value(self) -> dict[str, Any]:
        """The command with its history as plain data."""
        return self._command.plain()

    def encoded(self, encoding: Encoding) -> bytes:
        """Return it as bytes of the encoding."""
        data = self._written.get(encoding)
        if data is None:
            final = self._command.final
            data = ANY.encode(self._command.plain(), encoding)
            if final and len(data) <= _SHORT:
                self._written[encoding] = data
        return data


class Continuation(msgspec.Struct, frozen=True):
    """What a later run needs to go on with a command: see `Backend.has_gateways`."""

    backend: str
    """The name of the backend whose robot carries it out."""
    until: int
    """Its deadline, ns since the UNIX epoch."""
    grants: Grants
    """Of its principal, when it was sent."""
    idempotency_key: str | None = None
    """The client's."""


class Command(msgspec.Struct, eq=False, weakref=True):
    """One execute, from request to its one final status."""

    id: str
    path: str
    principal: str
    tenant: str | None
    proof: str = "none"
    """How the principal proved itself."""
    request_id: str | None = None
    custom: dict[str, Any] | None = None
    timestamp: str | float | None = None
    """When the client says that it sent it."""
    input: Any = None
    created: int = msgspec.field(default_factory=now)
    finished: int | None = None
    history: list[Record] = []
    session: str | None = None
    requester: Session | None = None
    """In whose name it runs; None once it has ended."""
    request: Request | None = None
    """The request that started it; None once it has ended."""
    work: Work | None = None
    """What the gateway itself does for it; None for the work of a robot."""
    touches: tuple[str, ...] = ()
    """Paths beside its own that it is about."""
    ready: Callable[[], Awaitable[None]] | None = None
    """Awaited before the command is passed to the robot."""
    entry: Entry | None = None
    task: asyncio.Task[Any] | None = None
    followers: list[CommandListener] = []
    """Listeners of this command only."""
    cancelling: str | None = None
    """Reason for a requested cancel; None if none was requested."""
    expired: bool = False
    sent: bool = False
    """Whether it was passed to the robot, which may act on it from then on."""
    began: int = 0
    """Number of stops of its robot before it began."""
    unrecorded: bool = False
    """Whether a step of it is missing in the record, so that its success is not confirmed."""
    deadline: int | None = None
    """The slot of its deadline."""
    continuation: Continuation | None = None
    """Of a command that goes on without this gateway."""
    row: str | None = None
    """The key of its row in the store; None as long as it has none."""
    _listed: _Listed | None = None
    _names: frozenset[str] | None = None
    """What is named once it has ended: nothing changes after that."""

    @property
    def status(self) -> Status:
        """The present status."""
        return self.history[-1].status

    @property
    def final(self) -> bool:
        """Whether the command has ended."""
        return self.status in FINAL

    @property
    def is_system(self) -> bool:
        """Whether the gateway itself carries it out: then it is about what it touches."""
        return is_system(self.path)

    @property
    def names(self) -> frozenset[str]:
        """Path and resource names that occur in the command's public representation."""
        names = self._names
        if names is None:
            names = names_in(self.plain())
            if self.final:
                self._names = names
        return names

    def reply(self, record: Record | None = None) -> Reply:
        """Write a step (the latest if not given) as a reply envelope of its own."""
        record = record or self.history[-1]
        reply = Reply(
            type="execute",
            id=self.request_id,
            path=self.path,
            status=record.status,
            body=record.body,
            message=record.message,
            error=record.error,
            command=self.id,
            progress=record.progress,
            timestamp=iso(record.time),
            custom=self.custom,
        )
        lost = self.unrecorded and record.status == "completed"
        return unrecorded(reply, "could not be written") if lost else reply

    @property
    def order_key(self) -> tuple[int, str]:
        """Sort key: creation time and id."""
        return self.created, self.id

    def plain(self, *, history: bool = True) -> dict[str, Any]:
        """Write the command as plain data, for lists and `/system/commands`."""
        last = self.history[-1]
        out: dict[str, Any] = {
            "command": self.id,
            "path": self.path,
            "status": last.status,
            "principal": self.principal,
            "created": iso(self.created),
            "updated": iso(last.time),
        }
        facts = {"id": self.request_id, "finished": self.finished and iso(self.finished)}
        facts |= {"progress": self.progress, "message": last.message, "error": last.error}
        out |= {key: value for key, value in facts.items() if value is not None}
        if last.body is not NO_BODY:
            out["body"] = plain(last.body)
        if self.input is not None:
            out["input"] = plain(self.input)
        if history:
            out["history"] = [record.plain() for record in self.history]
        return out | (self.custom or {})

    @property
    def trace(self) -> Trace:
        """Its place in a trace, its own one if it came without."""
        found = traced(self.custom, self.id)
        return found or Trace(secrets.token_hex(16), secrets.token_hex(8))

    @property
    def listed(self) -> Body:
        """What `plain` returns, to be written with others."""
        if self._listed is None:
            self._listed = _Listed(self)
        return self._listed

    @property
    def progress(self) -> float | None:
        """The last fraction that the backend reported, 0…1."""
        return next((r.progress for r in reversed(self.history) if r.progress is not None), None)


CommandListener = Callable[[Command, Record], None]
"""Hears of a step of a command when it is in its history."""


def command_id() -> str:
    """Return the id of another command, which nobody can guess.

    Nor do ids tell in which order, or how many, others are given. The operating system takes 3 µs to
    give a random number: it is asked for many at once.
    """
    if not _numbers:
        random = os.urandom(_RANDOM)
        _numbers.extend(random[place : place + 8].hex() for place in range(0, _RANDOM, 8))
    return "cmd-" + _numbers.pop()
