"""The e-stop: latched per robot, tenant or gateway, past every queue and limit.

The latch is set before anything else happens; each robot's `Backend.halt` is called next, and
running or queued commands are ended after that. None of them resumes when the latch is reset.
`safety.stop` handles the stop from there, to its confirmation and while it is latched.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Iterable, Mapping, Sequence
from typing import Annotated, Any

import msgspec
import structlog
from msgspec import Meta

from rcp_kernel.access.identities import Identities
from rcp_kernel.clock import Clock, iso
from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.paths import ESTOP
from rcp_kernel.errors import DeviceRejected, DeviceTimeout, Forbidden
from rcp_kernel.safety.deadman import Deadman
from rcp_kernel.safety.ending import end_commands
from rcp_kernel.safety.estop_scopes import EstopScopes, latch_keys
from rcp_kernel.safety.stop import Stop, StopController, merged
from rcp_kernel.sessions.command import CommandTable
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Owner, RobotUnit
from rcp_kernel.tree.latches import GATEWAY, Latch, Latches, tenant_key
from rcp_kernel.types import Time
from rcp_kernel.wire import Request
from rcp_protocol.timeouts import timeout

__all__ = ["HALT_WAIT", "LONGEST_WAIT", "Estop", "EstopRequest", "EstopState"]

log = structlog.get_logger("rcp.safety")
HALT_WAIT = 5.0  # s an e-stop waits for robots to come to rest; it keeps trying after that
LONGEST_WAIT = 60.0  # s, where the request's `deadline` allows as much


class EstopRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Stop, or with `reset` allow commands again; nothing moves until there is a new one."""

    scope: Annotated[str, Meta(max_length=256)] | None = None
    """`/tenant/<tenant>`, a robot or sub-tree of one, a group of the configuration, the name of a
    backend, or of one of its robots (`<backend>/<robot>`). If omitted: every robot visible to you."""
    reset: bool = False
    reason: Annotated[str, Meta(max_length=500)] | None = None


class EstopState(msgspec.Struct, frozen=True):
    """Which robots are latched."""

    active: bool
    robots: dict[str, dict[str, Any]]
    """Latched robots by the backend's name, or `<backend>/<robot>`: by whom, since when, why; how
    far the stop has come (`state`: requested, commanded, confirmed at rest) and when; in `detail` why
    it is not confirmed; and in `alarm` whether the robot has moved again under the latch."""
    scopes: dict[str, dict[str, Any]] = {}
    """Latches of whole tenants and of the gateway (`*`), which also hold robots that appear later."""
    groups: tuple[str, ...] = ()
    """Groups of the configuration that can be named as a scope."""
    reset: Time | None = None
    """When one of the robots was last reset since the gateway was started."""


EstopRecorder = Callable[
    [Session, Request, EstopRequest, dict[str, str | None], list[RobotUnit]], None
]
"""Records the keys of the latches that were set or reset, and the robots; must not block."""


class Estop:
    """Latches, halts and resets."""

    def __init__(
        self,
        supervisors: Sequence[Owner],
        stops: StopController,
        latches: Latches,
        deadman: Deadman,
        commands: CommandTable,
        *,
        scopes: EstopScopes,
        identities: Identities,
        settings: Settings,
        halted: Callable[[frozenset[str], str, str], None],
        record: EstopRecorder,
        loop: asyncio.AbstractEventLoop,
        clock: Clock,
    ) -> None:
        """Act on the robots of `supervisors`.

        `halted` is called with the stopped paths, by whom and why, once their commands have been
        ended.
        """
        self._supervisors = supervisors
        self._stops = stops
        self._latches = latches
        self._deadman = deadman
        self._commands = commands
        self._scopes = scopes
        self._identities = identities
        self._settings = settings
        self._tell_halted = halted
        self._record = record
        self._loop = loop
        self._now = clock.now
        self._due: list[tuple[list[RobotUnit], str, str | None]] = []
        """E-stops whose running commands have not been ended yet."""
        self._ending: set[asyncio.Task[None]] = set()

    # -- latches -------------------------------------------------------------------------------

    def state(self, session: Session) -> EstopState:
        """Return the latches visible to a session."""
        own = {tenant_key(t) for t in self._identities.tenants_of(session.principal)} | {GATEWAY}
        wide = {key: latch.plain() for key, latch in self._latches.wide.items() if key in own}
        visible = self._scopes.visible(session)
        return self._state_of(visible, wide, self._scopes.groups_of(session, visible))

    def everything(self) -> EstopState:
        """Return all latches."""
        units = [unit for supervisor in self._supervisors for unit in supervisor.units]
        wide = {key: latch.plain() for key, latch in self._latches.wide.items()}
        return self._state_of(units, wide, tuple(self._settings.config.safety.groups))

    def _state_of(
        self, units: Iterable[RobotUnit], wide: dict[str, dict[str, Any]], groups: tuple[str, ...]
    ) -> EstopState:
        robots: dict[str, dict[str, Any]] = {}
        released = 0
        for unit in units:
            released = max(released, unit.released)
            if (latch := unit.latch) is not None:
                stop = self._stops.of(unit)
                robots[unit.name] = latch.plain() | ({} if stop is None else stop.plain())
        reset = iso(released) if released else None
        return EstopState(bool(robots or wide), robots, wide, groups, reset)

    # -- stop and reset ------------------------------------------------------------------------

    def request(
        self, session: Session, request: EstopRequest, sent: Request
    ) -> Coroutine[Any, Any, EstopState]:
        """Latch or reset the robots in scope at once; return a coroutine that waits for rest.

        :raises UnknownPath: the scope contains no robot visible to the session.
        :raises Forbidden: a reset without the right to it in all of the scope; or a stop of several
            tenants without the right to that.
        """
        keys, robots = self.check(session, request)
        if request.reset:
            held = {robot: robot.latch for robot in robots}
            freed = self._reset_latches(keys, robots)
            self._record(session, sent, request, keys, freed)
            asked = {robot: held[robot] for robot in freed if robot.owner.has_gateways}
            return self._reset_at_gateways(session, asked) if asked else self._state_now(session)
        latches, by = self._latches, session.principal.name
        fresh = [robot for robot in robots if robot.latch is None]
        for key in keys:
            latches.set(key, by, request.reason)
        for robot in merged(robots):
            robot.count_stop()
        stops = self._stops.begin(robots)
        self._halt_unseen(keys, robots)
        # After the halts: the latch keeps everything that waits from the robots meanwhile.
        self._due.append((robots, by, request.reason))
        self._loop.call_soon(self._end_due)
        self._record(session, sent, request, keys, fresh)
        return self._halted(session, stops, sent.deadline)

    def _halt_unseen(self, keys: Mapping[str, str | None], robots: list[RobotUnit]) -> None:
        """Stop also robots with gateways of their own that have not shown a resource yet."""
        for owner in {robot.owner for robot in robots if robot.owner.has_gateways}:
            whole = owner.unit(None)
            if whole not in robots and not keys.keys().isdisjoint((GATEWAY, *whole.keys)):
                self._stops.halt_unseen(whole)

    def check(
        self, session: Session, request: EstopRequest
    ) -> tuple[dict[str, str | None], list[RobotUnit]]:
        """Return the latches and robots that a request means; refuse it as `request` does."""
        keys, robots = self._scopes.resolve(session, request.scope)
        if not request.reset:
            return keys, robots
        if session.unattended:
            raise Forbidden(
                "an e-stop must be reset by a person who can see the robot, not by automation",
                remedy="Reset it yourself, when it is safe.",
            )
        known = self._settings.config.tenant_names
        touched = {robot.tenant for robot in robots}
        for key, tenant in keys.items():
            touched.update(known if key == GATEWAY else [tenant or ""])
        if not all(session.rights.may_reset(tenant) for tenant in touched):
            raise Forbidden(
                f"{session.principal.name} may not reset an e-stop",
                remedy="Ask someone whose role has `reset = true`.",
            )
        return keys, robots

    def names(self, session: Session, request: EstopRequest) -> list[str]:
        """Name the robots that a request means, as far as the session sees them; refuse as it would."""
        _, robots = self.check(session, request)
        seen = self._scopes.visible(session)
        return sorted(robot.name for robot in robots if robot in seen)

    def _reset_latches(
        self, keys: dict[str, str | None], robots: list[RobotUnit]
    ) -> list[RobotUnit]:
        """Reset the latches here; return the robots that were latched."""
        self._end_due()
        freed = [robot for robot in robots if robot.latch is not None]
        latches = self._latches
        for robot in robots:
            latches.reset(robot.identity, robot.keys)
            latches.reset(robot.name, robot.keys)
        for key, tenant in keys.items():
            latches.reset(key, () if tenant is None else (tenant_key(tenant),))
        for robot in merged(freed):
            robot.release(self._now())
        self._stops.end(robot for robot in robots if robot.latch is None)
        return freed

    # -- carrying it out -----------------------------------------------------------------------

    def _end_due(self) -> None:
        while self._due:
            self._end_all(*self._due.pop())

    def _end_all(self, robots: list[RobotUnit], by: str, reason: str | None) -> None:
        """End running, queued and pending requests on stopped robots."""
        entries = [entry for robot in robots for entry in robot.entries.values()]
        paths = {entry.path for entry in entries}
        ending = end_commands(
            self._deadman,
            self._commands,
            entries,
            lambda one: one.path in paths or not paths.isdisjoint(one.touches),
            "emergency stop",
        )
        if ending:
            self._ending.add(task := self._loop.create_task(self._again(robots, ending)))
            task.add_done_callback(self._ending.discard)
        why = "emergency stop" + (f": {reason}" if reason else "")
        self._tell_halted(frozenset(paths), by, why)

    async def _again(self, robots: list[RobotUnit], ending: list[asyncio.Task[Any]]) -> None:
        """Halt again when all cancelled work has ended.

        Backends fence it off; for those that do not, the halt must be the last command.
        """
        await asyncio.wait(ending)
        self._stops.again(robots)

    async def _state_now(self, session: Session) -> EstopState:
        return self.state(session)

    async def _reset_at_gateways(
        self, session: Session, robots: Mapping[RobotUnit, Latch | None]
    ) -> EstopState:
        """Ask the gateways of robots to reset their e-stops too.

        :raises DeviceRejected: one refuses or does not answer; it is latched here again.
        """
        # Every gateway is waited for, even if the request ends before.
        asking = [self._loop.create_task(self._reset_at_gateway(*one)) for one in robots.items()]
        found = await asyncio.shield(asyncio.gather(*asking))
        seen = self._scopes.visible(session)
        refused = {r.name: why for r, why in zip(robots, found, strict=True) if why and r in seen}
        if any(found):
            named = ", ".join(f"{name} ({why})" for name, why in refused.items())
            raise DeviceRejected(
                f"still latched, because their own gateways are: {named or 'robots of others'}",
                path=ESTOP,
                remedy="Reset the e-stop at the robot, then here again.",
                details={"robots": refused},
            )
        return self.state(session)

    async def _reset_at_gateway(self, robot: RobotUnit, latch: Latch | None) -> str | None:
        """Ask one robot's own gateway; return why the robot is still latched, or None."""
        try:
            async with timeout(HALT_WAIT):
                await robot.reset_own()
        except Exception as error:
            why = str(error) or "no answer"
            log.warning("estop_not_reset", backend=robot.name, error=why)
            by, reason = ("the gateway", None) if latch is None else (latch.by, latch.reason)
            for key in latch_keys([robot]):
                self._latches.set(key, by, reason)
            robot.count_stop()
            self._stops.begin([robot])
            return why
        return None

    async def _halted(
        self, session: Session, stops: Sequence[Stop], deadline: float | None
    ) -> EstopState:
        """Wait until every robot is confirmed at rest.

        :raises DeviceTimeout: one is not yet; it stays latched and the stop is repeated.
        """
        wait = HALT_WAIT if deadline is None else min(deadline, LONGEST_WAIT)
        late = await self._stops.wait(stops, wait)
        if late:
            raise self._unconfirmed(session, late)
        return self.state(session)

    def _unconfirmed(self, session: Session, late: Iterable[Stop]) -> DeviceTimeout:
        visible = self._scopes.visible(session)
        shown = [stop for stop in late if stop.unit in visible]
        names = [f"{stop.unit.name} ({stop.detail})" for stop in shown]
        names = names or ["another part of the robot"]
        return DeviceTimeout(
            f"latched, but not confirmed at rest: {', '.join(names)}; the gateway keeps "
            "sending the stop",
            path=ESTOP,
            remedy="Use the robot's own emergency stop. /system/estop shows when it is at rest.",
            details={"robots": {stop.unit.name: stop.plain() for stop in shown}},
        )
