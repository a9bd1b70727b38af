"""The gateway's own branch of the tree: `/system/…`, with the same operations as everything else."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable, Iterator, Sequence
from contextlib import asynccontextmanager
from typing import Any

import msgspec

from rcp_gateway.log import Recent
from rcp_gateway.status import StatusReport
from rcp_kernel.access.tree_views import TreeViews
from rcp_kernel.contract.identity import same_rights
from rcp_kernel.contract.paths import ESTOP
from rcp_kernel.errors import RcpError, UnknownPath
from rcp_kernel.features import Filter, Pages, Service, SystemResource, View
from rcp_kernel.model import Operation, Resource
from rcp_kernel.safety.estop import LONGEST_WAIT, Estop, EstopRequest, EstopState
from rcp_kernel.safety.stop import StopController
from rcp_kernel.sessions.session import Session
from rcp_kernel.sessions.sessions import Sessions
from rcp_kernel.spi import Backend, BaseBackend
from rcp_kernel.tree.entry import Availability, Entry, RobotUnit
from rcp_kernel.tree.latches import Latches
from rcp_kernel.tree.registry import Registry
from rcp_kernel.types import Time
from rcp_kernel.wire import Body
from rcp_requests.action_list import ActionList
from rcp_requests.command_access import CommandAccess

__all__ = ["System"]

_POLLED = ("sensor/status", "sensor/sessions", "sensor/commands")
_LOOK = Operation.READ | Operation.SUBSCRIBE
_LOG = "/system/log"
_TREE = "/system/tree"
_SOON = 0.02  # s that changes of the e-stop are gathered
_RARELY = 20.0  # times as long as it takes to describe it: of a thousand robots, some milliseconds
_SETTLED = 0.1  # s that changes of the tree are gathered


class LogRecord(msgspec.Struct, frozen=True):
    """A log record of level warning or above."""

    timestamp: Time | None
    level: str
    logger: str
    message: str
    tenant: str | None = None
    """Its tenant; None for the gateway itself, shown to principals that act in every tenant."""
    facts: dict[str, Any] = {}


class Tree(msgspec.Struct, frozen=True):
    """What one reader sees of the tree, as a number."""

    generation: int = 0
    """That of discovery: it rises with every change of resources that the reader may see."""


class System(BaseBackend):
    """Owner and backend of `/system/…` in one."""

    name = "gateway"
    tenant = None
    robot = None
    on_loss = "continue"

    def __init__(
        self,
        status: StatusReport,
        estop: Estop,
        *,
        access: CommandAccess,
        sessions: Sessions,
        latches: Latches,
        stops: StopController,
        registry: Registry,
        tree_views: TreeViews,
        recent: Recent,
        features: Sequence[SystemResource],
        reader_status: Callable[[Session], dict[str, Any]],
        loop: asyncio.AbstractEventLoop,
    ) -> None:
        self._status = status
        self._estop = estop
        self._access = access
        self._sessions = sessions
        self._reader_status = reader_status
        self._registry = registry
        self._tree_views = tree_views
        self._loop = loop
        self.samples = 0
        self._unit = RobotUnit(self, None)
        self._unit.usable_backend = self
        self._estop_due: asyncio.TimerHandle | None = None
        self._estop_took = 0.0
        """How long it took to describe the e-stop the last time, s."""
        self._tree_due: asyncio.TimerHandle | None = None
        self.latency: float | None = None
        self.entries = {entry.path: entry for entry in map(self._place, _resources())}
        self.views: dict[str, View] = {
            "/system/status": self._health,
            "/system/sessions": self._list_sessions,
            "/system/commands": self._list_commands,
            ESTOP: lambda session: msgspec.to_builtins(estop.state(session)),
            _TREE: self._tree,
        }
        """Resources whose value depends on the reader, by path."""
        self.filters: dict[str, Filter] = {_LOG: self._shown}
        """Filters of resources of whose samples each reader sees only a part, by path; a filter returns
        None for a hidden sample."""
        self.by_rights: set[str] = {_TREE}
        """Resources whose view is the same for readers with equal rights, by path."""
        self.pages: dict[str, Pages] = {}
        """Resources whose items can be searched and read in pages, by path."""
        self.services: dict[str, Service] = {}
        """Other executable resources of `/system`, by path."""
        for resource in features:
            self._add(resource)
        self.entries[_LOG].keep_history()
        latches.on_change.append(self._estop_changed)
        stops.on_change(self._estop_changed)
        self._publish("estop", estop.everything())
        self._publish("tree", {})
        registry.on_added.append(self._tree_changed)
        registry.on_removed.append(self._tree_changed)
        self._recent = recent
        recent.on_record.append(self._logged)

    def close(self) -> None:
        """Stop publishing log records and changes of the tree."""
        self._recent.on_record.remove(self._logged)
        if self._tree_due is not None:
            self._tree_due.cancel()

    def _place(self, resource: Resource) -> Entry:
        path = "/system/" + resource.name.partition("/")[2]
        return self._registry.insert(Entry(path, resource, self, None, None, self._registry.clock))

    def _add(self, own: SystemResource) -> None:
        """Put a feature's resource into the tree."""
        entry = self.entries[own.path] = self._place(own.resource)
        if own.shows is not None:
            self.filters[own.path] = own.shows
            entry.keep_history()
        if own.execute is not None:
            self.services[own.path] = own.execute
        if own.pages is not None:
            self.pages[own.path] = own.pages
        view = own.view
        if own.action is not None:
            view = ActionList(own.path, own.action, self._access).view
        if view is not None:
            self.views[own.path] = view
            if own.by_rights:
                self.by_rights.add(own.path)
            self.entries[own.path].publish((), None)  # its view has changed

    def _publish(self, name: str, value: Any) -> None:
        """Notify subscribers that a view has changed."""
        self.entries["/system/" + name].publish(value, None)

    def _estop_changed(self) -> None:
        """Publish the e-stop soon: a stop of many robots changes it many times, and must not wait."""
        if self._estop_due is None:
            pause = max(_SOON, self._estop_took * _RARELY)
            self._estop_due = self._loop.call_later(pause, self._publish_estop)

    def _publish_estop(self) -> None:
        self._estop_due, begun = None, self._loop.time()
        self._publish("estop", self._estop.everything())
        self._estop_took = self._loop.time() - begun

    def _tree_changed(self, _: Entry) -> None:
        """Announce a change of the tree, after a while: backends declare one by one."""
        if self._tree_due is None:
            self._tree_due = self._loop.call_later(_SETTLED, self._publish_tree)

    def _publish_tree(self) -> None:
        self._tree_due = None
        self._publish("tree", {})

    @property
    def backend(self) -> Backend | None:
        """The gateway is always there."""
        return self

    def unit(self, robot: str | None) -> RobotUnit:
        """Return the robot unit of the gateway, which no e-stop holds."""
        return self._unit

    @property
    def availability(self) -> Availability:
        """The gateway is always ready."""
        return "ready"

    @property
    def units(self) -> list[RobotUnit]:
        """There is nothing to stop."""
        return []

    @property
    def closes(self) -> bool:
        """It is open as long as the gateway runs."""
        return False

    def unavailable(self) -> RcpError:
        """Never called."""
        return UnknownPath("the gateway is closing")

    def state_changed(self) -> None:
        """Do nothing: no e-stop or hold applies to the gateway itself."""

    def fault(self, detail: str) -> None:
        """Do nothing: an invalid value of the gateway's own is a bug, and raises where it is created."""

    def _logged(self, record: dict[str, Any]) -> None:
        # Warnings may come from any thread.
        loop = self._loop
        if not loop.is_closed():
            loop.call_soon_threadsafe(self._publish_record, record)

    def _publish_record(self, record: dict[str, Any]) -> None:
        self.entries[_LOG].publish(record | {"tenant": self._status.tenant_of(record)}, None)

    def _shown(self, session: Session, record: LogRecord) -> LogRecord | None:
        """Return a log record of a session's tenants, as far as the session may see it."""
        plain = {"message": record.message, "facts": record.facts}
        return record if self._status.concerns(plain, session.rights) else None

    @asynccontextmanager
    async def watch(self, name: str, rate: float | None) -> AsyncGenerator[None]:
        """Publish values that must be polled, while a client subscribes."""
        if name not in _POLLED:
            yield
            return
        task = asyncio.create_task(self._repeat(name, 1.0 / min(rate or 1.0, 10.0)))
        try:
            yield
        finally:
            task.cancel()

    async def _repeat(self, name: str, period: float) -> None:
        """Notify periodically that a view may have changed; each subscriber has its own."""
        entry = self.entries["/system/" + name.partition("/")[2]]
        while True:
            entry.publish([] if name != "sensor/status" else {}, None)
            await asyncio.sleep(period)

    # -- views ---------------------------------------------------------------------------------

    def _health(self, session: Session) -> dict[str, Any]:
        report = self._status.plain(session.rights)
        return report | self._reader_status(session)

    def _tree(self, session: Session) -> dict[str, Any]:
        view = self._tree_views.look(session.rights)
        if not view.current:  # the rest of many changes is processed soon
            self._tree_due = self._tree_due or self._loop.call_later(_SETTLED, self._publish_tree)
        return {"generation": view.number}

    def _list_sessions(self, session: Session) -> list[dict[str, Any]]:
        places = session.rights.places("/system/sessions", Operation.EXECUTE)
        known = self._sessions.known.values()
        # All anonymous clients are one principal, but not one person.
        hidden: dict[str, Any] = {"address": None} if session.principal.anonymous else {}
        return [
            s.plain() | ({} if may_end else hidden)
            for s in known
            if (may_end := "*" in places or s.tenant in places)
            or same_rights(s.principal, session.principal)
        ]

    def _list_commands(self, session: Session) -> Iterator[Body | None]:
        return (command and command.listed for command in self._access.judged(session))


def _resources() -> list[Resource]:
    return [
        Resource(
            name="sensor/status",
            description="Health of the gateway and everything connected to it.",
            value=dict[str, Any],
            history=1,
        ),
        Resource(
            name="sensor/tree",
            description="Changes whenever the visible part of the tree does, as in discovery.",
            value=Tree,
            history=1,
        ),
        Resource(
            name="event/log",
            description="Log records of level warning and above.",
            value=LogRecord,
            history=100,
        ),
        Resource(
            name="sensor/sessions",
            description="Sessions of this principal; of everybody for an administrator.",
            value=list[dict[str, Any]],
            history=1,
        ),
        Resource(
            name="sensor/commands",
            description="Running and recent commands on paths that you may see.",
            value=list[dict[str, Any]],
            history=1,
        ),
        Resource(
            name="service/estop",
            description="Emergency stop: latches and halts every robot in scope; reset is a right.",
            value=EstopState,
            input=EstopRequest | None,
            output=EstopState,
            operations=_LOOK | Operation.EXECUTE,
            examples=({}, {"scope": "/tenant/alpha", "reason": "person in the cell"}),
            timeout=LONGEST_WAIT + 1,
        ),
    ]
