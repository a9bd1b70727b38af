"""The e-stop: latched per robot, tenant or gateway, past every queue and limit.

The latch stands before anything else happens; each robot's `Backend.halt` is entered next, and
what ran or waited is ended after that. Nothing of it resumes when the latch is reset.
"""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Sequence
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from rcp_kernel.clients.session import Session
from rcp_kernel.clock import now
from rcp_kernel.errors import DeviceTimeout, Forbidden, UnknownPath
from rcp_kernel.gateway import Gateway
from rcp_kernel.motion.latches import GATEWAY, tenant_key
from rcp_kernel.motion.safety import MOVING, halt
from rcp_kernel.motion.scope import Scope
from rcp_kernel.motion.units import Unit
from rcp_kernel.process.supervisor import Slot

__all__ = ["HALT_WAIT", "Estop", "EstopRequest", "EstopState"]

HALT_WAIT = 5.0  # s an e-stop waits for robots to confirm; it goes on trying after that


class EstopRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Stop, or with `reset` let commands through again; nothing moves until a new one."""

    scope: Annotated[str, Meta(max_length=256)] | None = None
    """`/tenant/<tenant>`, a robot or sub-tree of one, the name of a backend, or of one of its
    robots (`<backend>/<robot>`); None is every robot that you may see."""
    reset: bool = False
    reason: Annotated[str, Meta(max_length=500)] | None = None


class EstopState(msgspec.Struct, frozen=True):
    """Which robots are latched."""

    active: bool
    robots: dict[str, dict[str, Any]]
    """Latched robots by the backend's name, or `<backend>/<robot>`: by whom, since when, why."""
    scopes: dict[str, dict[str, Any]] = {}
    """Latches of whole tenants and of the gateway (`*`), which hold also robots that appear."""


class Estop:
    """Latches, halts and resets."""

    def __init__(self, gateway: Gateway, slots: list[Slot]) -> None:
        self._gateway = gateway
        self._slots = slots
        self._stops: set[asyncio.Future[None]] = set()
        self._due: list[tuple[list[Unit], str, str | None]] = []
        """E-stops after which what ran has not been ended yet."""

    # -- what is latched -----------------------------------------------------------------------

    def state(self, session: Session) -> EstopState:
        """Return what a session may see of the latches."""
        mine = {tenant_key(t) for t in self._gateway.identities.tenants_of(session.principal)} | {
            GATEWAY
        }
        wide = {key: latch.plain() for key, latch in self._wide().items() if key in mine}
        return _state(self._visible(session), wide)

    def everything(self) -> EstopState:
        """Return all that is latched."""
        units = [unit for slot in self._slots for unit in slot.units]
        return _state(units, {key: latch.plain() for key, latch in self._wide().items()})

    def _wide(self) -> dict[str, Any]:
        return self._gateway.latches.wide

    def _visible(self, session: Session) -> list[Unit]:
        """List the robots that a session may see, one by one."""
        seen = session.rights.mask
        return [
            unit
            for slot in self._slots
            for unit in slot.units
            if any(seen(entry.path) for entry in unit.own.values())
        ]

    # -- stop and reset ------------------------------------------------------------------------

    def request(self, session: Session, asked: EstopRequest) -> Coroutine[Any, Any, EstopState]:
        """Latch or reset what is in scope, at once; return what waits for robots to confirm it.

        :raises UnknownPath: the scope holds no robot that the session may see.
        :raises Forbidden: a reset by somebody whose role may not, in all of the scope.
        """
        keys, robots = self.check(session, asked)
        if asked.reset:
            self._reset(session, asked, keys, robots)
            return self._state_now(session)
        latches, by = self._gateway.latches, session.principal.name
        fresh = [robot for robot in robots if robot.latch is None]
        for key in keys:
            latches.set(key, by, asked.reason)
        robots = _merged(robots)
        for robot in robots:
            robot.count_stop()
        stops = [halt(robot) for robot in robots]
        for stop in stops:  # held on to: they may have to go on after this request is answered
            self._stops.add(stop)
            stop.add_done_callback(self._stops.discard)
        # After the halts: the latch keeps everything that waits from the robots meanwhile.
        self._due.append((robots, by, asked.reason))
        self._gateway.loop.call_soon(self._end_due)
        self._note(session, asked, keys, fresh)
        return self._halted(session, robots, stops)

    def check(
        self, session: Session, asked: EstopRequest
    ) -> tuple[dict[str, str | None], list[Unit]]:
        """Return the latches and robots that a request means; refuse it as `request` does."""
        keys, robots = self._meant(session, asked.scope)
        if not asked.reset:
            return keys, robots
        known = self._gateway.config.tenant_names
        touched = {robot.tenant for robot in robots}
        for key, tenant in keys.items():
            touched.update(known if key == GATEWAY else [tenant or ""])
        if not all(session.rights.may_reset(tenant) for tenant in touched):
            raise Forbidden(
                f"{session.principal.name} may not reset an e-stop",
                remedy="Have a person reset it whose role has `reset = true`.",
            )
        return keys, robots

    def _reset(
        self, session: Session, asked: EstopRequest, keys: dict[str, str | None], robots: list[Unit]
    ) -> None:
        self._end_due()
        freed = [robot for robot in robots if robot.latch is not None]
        latches = self._gateway.latches
        for robot in robots:
            latches.reset(robot.name, robot.keys)
        for key, tenant in keys.items():
            latches.reset(key, () if tenant is None else (tenant_key(tenant),))
        for robot in _merged(freed):
            robot.release(now())
        self._note(session, asked, keys, freed)

    def _note(
        self, session: Session, asked: EstopRequest, keys: dict[str, str | None], robots: list[Unit]
    ) -> None:
        tenants = {tenant for tenant in keys.values() if tenant is not None}
        self._gateway.audit.note(
            "estop",
            principal=session.principal,
            tenant=tenants.pop() if len(tenants) == 1 else None,
            path="/system/estop",
            session=session,
            reset=asked.reset,
            scope=asked.scope,
            latches=sorted(keys),
            robots=[robot.name for robot in robots],
            reason=asked.reason,
        )

    # -- what a scope means --------------------------------------------------------------------

    def _meant(
        self, session: Session, scope: str | None
    ) -> tuple[dict[str, str | None], list[Unit]]:
        """Return the keys of the latches that a scope means, with their tenants, and the robots."""
        visible = self._visible(session)
        tenants = self._gateway.identities.tenants_of(session.principal)
        keys: dict[str, str | None] = {}
        if scope is None:
            robots = visible
            if "*" in session.rights.tenants and not self._hidden(session, None):
                keys[GATEWAY] = None
            else:
                keys = self._widest(session, tenants, visible)
        elif not scope.startswith("/"):
            robots = [unit for unit in visible if scope in (unit.name, unit.whole.name)]
            keys = _keys(robots)
        else:
            found = Scope(scope, session.tenant)
            robots = [unit for unit in visible if self._within(session, unit, found)]
            if found.whole and found.tenant in tenants:
                keys = self._widest(session, [found.tenant], robots)
            else:
                keys = _keys(robots)
        if not keys:
            raise UnknownPath(f"there is no robot in the scope {scope or 'of this session'!r}")
        return keys, robots

    def _widest(
        self, session: Session, tenants: list[str], robots: list[Unit]
    ) -> dict[str, str | None]:
        """Mean whole tenants where the session sees all their robots, else the robots it sees."""
        keys: dict[str, str | None] = {}
        for tenant in tenants:
            if not self._hidden(session, tenant):
                keys[tenant_key(tenant)] = tenant
            else:
                keys |= _keys([unit for unit in robots if unit.tenant == tenant])
        return keys

    def _hidden(self, session: Session, tenant: str | None) -> bool:
        """Tell whether there is a robot that the session may not see, or none at all to go by."""
        units = [u for slot in self._slots for u in slot.units if tenant in (None, slot.tenant)]
        visible = self._visible(session)
        return not units or any(unit.own and unit not in visible for unit in units)

    @staticmethod
    def _within(session: Session, unit: Unit, scope: Scope) -> bool:
        if unit.tenant != scope.tenant:
            return False
        if scope.whole or (scope.robot is not None and scope.robot == unit.place):
            return True
        rights = session.rights
        return any(scope.covers(e.path) and rights.mask(e.path) for e in unit.own.values())

    # -- carrying it out -----------------------------------------------------------------------

    def _end_due(self) -> None:
        while self._due:
            self._end_all(*self._due.pop())

    def _end_all(self, robots: list[Unit], by: str, reason: str | None) -> None:
        """End what runs, waits or is under way on stopped robots, and the leases on them."""
        gateway = self._gateway
        paths: set[str] = set()
        for robot in robots:
            for entry in robot.entries.values():
                paths.add(entry.path)
                if entry.kind in MOVING:
                    gateway.deadman.ground(entry)
        for command in list(gateway.commands.running.values()):
            if command.path in paths or not paths.isdisjoint(command.touches):
                gateway.commands.cancel(command, "emergency stop")
        why = "emergency stop" + (f": {reason}" if reason else "")
        gateway.leases.drop_on(paths, by, why)

    async def _state_now(self, session: Session) -> EstopState:
        return self.state(session)

    async def _halted(
        self, session: Session, robots: list[Unit], stops: Sequence[asyncio.Future[None]]
    ) -> EstopState:
        """Wait until every robot has confirmed its halt.

        :raises DeviceTimeout: one has not yet; it stays latched and is told again.
        """
        if stops:
            _, late = await asyncio.wait(stops, timeout=HALT_WAIT)
            if late:
                names = [r.name for r, stop in zip(robots, stops, strict=True) if stop in late]
                raise DeviceTimeout(
                    f"latched, but not confirmed yet by {', '.join(names)}; the halt is repeated",
                    remedy="Use the robot's own emergency stop.",
                )
        return self.state(session)


def _state(units: list[Unit], wide: dict[str, dict[str, Any]]) -> EstopState:
    robots = {unit.name: latch.plain() for unit in units if (latch := unit.latch) is not None}
    return EstopState(bool(robots or wide), robots, wide)


def _merged(units: list[Unit]) -> list[Unit]:
    """Have backends halt as a whole of which all robots are to stop."""
    meant = set(units)
    return list(
        dict.fromkeys(
            unit.whole if unit.whole in meant or meant.issuperset(unit.owner.units) else unit
            for unit in units
        )
    )


def _keys(units: list[Unit]) -> dict[str, str | None]:
    """Return the keys of the latches for robots, those of whole backends where they can be."""
    return {unit.name: unit.tenant for unit in _merged(units)}
