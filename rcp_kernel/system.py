"""The gateway's own branch of the tree: `/system/…`, with the same operations as everything else."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Coroutine, Sequence
from contextlib import asynccontextmanager
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from rcp_kernel.audit import PATH
from rcp_kernel.errors import DeviceTimeout, Forbidden, RcpError, UnknownPath
from rcp_kernel.gateway import Gateway
from rcp_kernel.log import Recent
from rcp_kernel.model import Operation, Resource
from rcp_kernel.registry import Entry
from rcp_kernel.safety import Latch, halt
from rcp_kernel.sessions import Session
from rcp_kernel.spi import Backend, BaseBackend, Progress
from rcp_kernel.status import StatusReport
from rcp_kernel.supervisor import Slot
from rcp_kernel.types import Time

__all__ = ["System"]

_POLLED = ("sensor/status", "sensor/sessions", "sensor/commands")
_LOOK = Operation.READ | Operation.SUBSCRIBE
_AUDIT = 1000  # records at hand for `history`
_HALT_WAIT = 5.0  # s an e-stop waits for robots to confirm; it goes on trying after that


class LogRecord(msgspec.Struct, frozen=True):
    """A log record of level warning or above."""

    timestamp: Time | None
    level: str
    logger: str
    message: str
    facts: dict[str, Any] = {}


class EstopRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Stop, or with `reset` let commands through again; nothing moves until a new one."""

    scope: Annotated[str, Meta(max_length=256)] | None = None
    """`/tenant/<tenant>`, or the name of a backend; None is every robot that you may see."""
    reset: bool = False
    reason: Annotated[str, Meta(max_length=500)] | None = None


class EstopState(msgspec.Struct, frozen=True):
    """Which robots are latched."""

    active: bool
    robots: dict[str, dict[str, Any]]
    """Latched backends by name: by whom, since when, why."""


class System(BaseBackend):
    """Owner and backend of `/system/…` in one."""

    name = "gateway"
    tenant = None
    latch = None

    def __init__(
        self, gateway: Gateway, slots: list[Slot], status: StatusReport, recent: Recent
    ) -> None:
        self._gateway = gateway
        self._slots = slots
        self._status = status
        self.samples = 0
        self._stops: set[asyncio.Future[None]] = set()
        self.latency: float | None = None
        self.entries = {entry.path: entry for entry in map(self._place, _resources())}
        gateway.views.update(
            {
                "/system/status": self._health,
                "/system/sessions": self._sessions,
                "/system/commands": self._commands,
                "/system/estop": lambda s: msgspec.to_builtins(self._estop_state(s)),
            }
        )
        gateway.sieves[PATH] = gateway.audit.shows
        self._open_audit(self.entries[PATH])
        gateway.estop = self.estop
        recent.told = self._logged

    def _place(self, resource: Resource) -> Entry:
        path = "/system/" + resource.name.partition("/")[2]
        return self._gateway.registry.place(Entry(path, resource, self, None, None))

    @property
    def backend(self) -> Backend | None:
        """The gateway is always there."""
        return self

    def unavailable(self) -> RcpError:
        """Never asked for."""
        return UnknownPath("the gateway is closing")

    def fault(self, detail: str) -> None:
        """A value of the gateway's own that does not fit is a bug, and raises where it is made."""

    def _open_audit(self, entry: Entry) -> None:
        audit = self._gateway.audit
        self._gateway.hub.keep(entry)
        for record in audit.past(_AUDIT):
            entry.publish(record, None)
        audit.told = lambda record: entry.publish(record, None)

    def _logged(self, record: dict[str, Any]) -> None:
        # Warnings come from any thread.
        loop = self._gateway.loop
        if not loop.is_closed():
            loop.call_soon_threadsafe(self.entries["/system/log"].publish, record, None)

    @asynccontextmanager
    async def watch(self, name: str, rate: float | None) -> AsyncGenerator[None]:
        """Publish what has to be looked at to be known, while somebody watches it."""
        if name not in _POLLED:
            yield
            return
        task = asyncio.create_task(self._repeat(name, 1.0 / min(rate or 1.0, 10.0)))
        try:
            yield
        finally:
            task.cancel()

    async def _repeat(self, name: str, period: float) -> None:
        """Say again and again that a view may have changed; each subscriber's is its own."""
        entry = self.entries["/system/" + name.partition("/")[2]]
        while True:
            entry.publish([] if name != "sensor/status" else {}, None)
            await asyncio.sleep(period)

    # -- views ---------------------------------------------------------------------------------

    def _health(self, session: Session) -> dict[str, Any]:
        audit = self._gateway.audit
        report = self._status.plain(session.rights.tenants)
        return report | {"record": audit.state(head=audit.shows(session, {}))}

    def _sessions(self, session: Session) -> list[dict[str, Any]]:
        mine = session.principal
        everyone = session.rights.mask("/system/sessions") & Operation.EXECUTE
        return [
            s.plain()
            for s in self._gateway.sessions.known.values()
            if everyone or s.principal == mine
        ]

    def _commands(self, session: Session) -> list[dict[str, Any]]:
        rights = session.rights
        return [c.plain() for c in self._gateway.commands.every() if rights.mask(c.path)]

    def _visible(self, session: Session) -> list[Slot]:
        rights = session.rights
        return [s for s in self._slots if any(rights.mask(e.path) for e in s.entries.values())]

    # -- e-stop --------------------------------------------------------------------------------

    def _estop_state(self, session: Session) -> EstopState:
        latched = {s.name: s.latch.plain() for s in self._visible(session) if s.latch is not None}
        return EstopState(bool(latched), latched)

    def estop(self, session: Session, request: EstopRequest) -> Coroutine[Any, Any, EstopState]:
        """Latch or reset the robots in scope, at once; return what waits for them to confirm it.

        :raises UnknownPath: the scope holds no robot that the session may see.
        :raises Forbidden: a reset by somebody whose role may not.
        """
        robots = [s for s in self._visible(session) if _in_scope(s, request.scope)]
        if not robots:
            raise UnknownPath(
                f"there is no robot in the scope {request.scope or 'of this session'!r}"
            )
        if request.reset:
            if not all(session.rights.may_reset(robot.tenant) for robot in robots):
                raise Forbidden(
                    f"{session.principal.name} may not reset an e-stop",
                    remedy="Have a person reset it whose role has `reset = true`.",
                )
            for robot in robots:
                robot.latch = None
            self._publish_estop(session)
            return self._state_now(session)
        for robot in robots:
            robot.latch = robot.latch or Latch(session.principal.name, request.reason)
        stops = [asyncio.ensure_future(self._stop(robot)) for robot in robots]
        for stop in stops:  # held on to: they may have to go on after this request is answered
            self._stops.add(stop)
            stop.add_done_callback(self._stops.discard)
        self._publish_estop(session)
        return self._halted(session, robots, stops)

    async def _state_now(self, session: Session) -> EstopState:
        return self._estop_state(session)

    async def _halted(
        self, session: Session, robots: list[Slot], stops: Sequence[asyncio.Future[None]]
    ) -> EstopState:
        """Wait until every robot has confirmed its halt.

        :raises DeviceTimeout: one has not yet; it stays latched and is told again.
        """
        _, late = await asyncio.wait(stops, timeout=_HALT_WAIT)
        if late:
            names = [r.name for r, stop in zip(robots, stops, strict=True) if stop in late]
            raise DeviceTimeout(
                f"latched, but not confirmed yet by {', '.join(names)}; the halt is repeated",
                remedy="Use the robot's own emergency stop.",
            )
        return self._estop_state(session)

    async def _stop(self, robot: Slot) -> None:
        gateway = self._gateway
        stopping = asyncio.ensure_future(halt(robot))
        for entry in robot.entries.values():
            gateway.deadman.ground(entry)
            for command in [c for c in gateway.commands.running.values() if c.path == entry.path]:
                gateway.commands.cancel(command, "emergency stop")
        await stopping

    def _publish_estop(self, session: Session) -> None:
        latched = {s.name: s.latch.plain() for s in self._slots if s.latch is not None}
        self.entries["/system/estop"].publish(EstopState(bool(latched), latched), None)

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Only the e-stop is executable, and it has a lane of its own."""
        raise UnknownPath(f"nothing to execute at {name}")


def _in_scope(slot: Slot, scope: str | None) -> bool:
    if scope is None or scope == slot.name:
        return True
    parts = scope.strip("/").split("/")
    if parts[0] != "tenant" or len(parts) < 2 or parts[1] != slot.tenant:
        return False
    return len(parts) == 2 or slot.robot in parts[2:]


def _resources() -> list[Resource]:
    return [
        Resource(
            name="sensor/status",
            description="Health of the gateway and everything connected to it.",
            value=dict[str, Any],
            history=1,
        ),
        Resource(
            name="event/log",
            description="Log records of level warning and above.",
            value=LogRecord,
            history=100,
            live=True,
        ),
        Resource(
            name="event/audit",
            description="Records of commands, writes, refusals and logins in your tenants.",
            value=dict[str, Any],
            history=_AUDIT,
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
            timeout=_HALT_WAIT + 1,
        ),
    ]
