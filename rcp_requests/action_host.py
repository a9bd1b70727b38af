"""The gateway's interface for long-running actions of features."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Container, Generator, Sequence
from typing import Any, TypeVar

import msgspec

from rcp_kernel.access.conditions import Conditions
from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.digest import bounded, hashing
from rcp_kernel.features.control import CONTROL, NoControl
from rcp_kernel.features.services import FeatureServices, ServiceKey
from rcp_kernel.model import Operation
from rcp_kernel.safety.motion_checks import check_motion
from rcp_kernel.sessions.command import Command
from rcp_kernel.sessions.session import Handler, Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.registry import Registry
from rcp_kernel.values import Encoding, dump, to_plain
from rcp_kernel.wire import NO_BODY, Body, Reply, Request
from rcp_protocol.structure import check_structure
from rcp_requests.admission import Resolver
from rcp_requests.atomic_group import check_group
from rcp_requests.commands import Commands
from rcp_requests.journal import CommandJournal
from rcp_requests.long_bodies import LongBodies
from rcp_requests.read_options import READ_OPTIONS
from rcp_requests.request_events import RequestEvents
from rcp_scheduling.turns import Turns
from rcp_streams.frames import FrameConverter

__all__ = ["GatewayActionHost"]

T = TypeVar("T")
_LONG = 262_144  # bytes of a value that is hashed in steps


class GatewayActionHost:
    """The `ActionHost` of all of them."""

    def __init__(
        self,
        *,
        handle: Handler,
        resolver: Resolver,
        long_bodies: LongBodies,
        settings: Settings,
        foresee: Callable[[Session, Entry, Any], None],
        frames: FrameConverter,
        commands: Commands,
        journal: CommandJournal,
        conditions: Conditions,
        registry: Registry,
        services: FeatureServices,
        personal: tuple[Container[str], ...],
        events: RequestEvents,
        turns: Turns,
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        """`personal` has the paths that show each reader something else."""
        self._resolver = resolver
        self._journal = journal
        self._long_bodies = long_bodies
        self._settings = settings
        self._foresee = foresee
        self._frames = frames
        self._services = services
        self._control = services.service(CONTROL) or NoControl()
        self._personal = personal
        self._events = events
        self.send = handle
        self.cancel = commands.cancel
        self.conditions = conditions
        self.registry = registry
        self.turns = turns
        self.loop = loop

    def service(self, key: ServiceKey[T]) -> T | None:
        """Return what another feature offers."""
        return self._services.service(key)

    def resolve(self, session: Session, path: str, operation: Operation) -> Entry:
        """Return a resource on which a session may do something, now or in another state."""
        return self._resolver.resolve(session, path, operation, anyway=True)

    def is_personal(self, path: str) -> bool:
        """Tell whether a resource shows each reader something else."""
        return any(path in paths for paths in self._personal)

    def check_read(self, options: Any) -> None:
        """Validate the body of a `read`."""
        READ_OPTIONS.decode(dump(options, Encoding.JSON), Encoding.JSON, "read")

    def foresee(
        self, session: Session, entry: Entry, value: Any, *, gained: bool, complete: bool
    ) -> None:
        """Refuse a later command that would be refused whatever happens until then."""
        check_motion(entry)
        if not gained:
            self._control.check(session, entry)
        if entry.unit.usable_backend is None:
            raise entry.unit.unavailable()
        if complete:
            self._foresee(session, entry, value)

    def check_group(self, entries: Sequence[Entry]) -> None:
        """Check that a backend can write several paths as one.

        :raises NotImplementedByRobot: they are not of one group of one robot.
        """
        check_group(entries)

    def goal(self, session: Session, entry: Entry, value: Any) -> Any:
        """Return the input of an execute in the robot's own frame."""
        body = msgspec.Raw(dump(value, Encoding.JSON))
        request = Request(type="execute", path=entry.path, body=body)
        return self._frames.goal(session, request, entry)

    def prepare(self, session: Session, request: Request) -> Generator[None, None, Request]:
        """Check and decode a long body in steps.

        :raises PayloadTooLarge: it has too many values.
        """
        if self._long_bodies.takes(request):
            limit = self._settings.limits.values
            yield from check_structure(bytes(request.body), request.encoding, limit)
        return (yield from self._long_bodies.prepare(session, request))

    def started_by(self, request: Request) -> Command | None:
        """Return the command that a request has started, while it runs."""
        # Not by its id: the reply that contains it may wait for its record.
        running = self._journal.running_on(request.path or "")
        return next((c for c in running if c.custom is request.custom), None)

    def disown(self, session: Session, id_: str) -> None:
        """Do not report a command to a resuming client."""
        command = self._journal.find(id_)
        if command is not None and command.entry is not None and command.entry.resource.outlives:
            session.commands.pop(id_, None)

    async def record_read(self, session: Session, request: Request, reply: Reply) -> None:
        """Record a read of a session; a long value by its hash."""
        path = reply.path or request.path or ""
        body, touches = reply.body, [path]
        if "*" in path:
            recorded = _plain(body)
            touches = [item["path"] for item in recorded]
        elif isinstance(body, Body) and len(data := body.encoded(Encoding.JSON)) > _LONG:
            recorded = await self.turns.finish(session.principal.identity, hashing(data))
        else:
            recorded = bounded(_plain(body))
        self._events.looked(session, request, path, recorded, touches)


def _plain(body: Any) -> Any:
    if body is NO_BODY:
        return None
    return to_plain(body.value if isinstance(body, Body) else body)
