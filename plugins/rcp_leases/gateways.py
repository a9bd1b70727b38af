"""Leases on robots that have gateways of their own, which are held there: see `has_gateways`.

What a robot's gateway has not granted is not held, so that two hubs cannot both grant it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from rcp_kernel.clock import Clock
from rcp_kernel.errors import DeadlineExceeded, Refused
from rcp_kernel.features import Scope
from rcp_kernel.features.robots import Robots
from rcp_kernel.spi import RobotLease, RobotLeaseRequest
from rcp_kernel.tree.entry import RobotUnit
from rcp_leases.lease import GatewayLease, Lease, Program

__all__ = ["GatewayLeases", "Granted"]


class Granted(NamedTuple):
    """What the gateways of all robots in a scope have granted."""

    held: dict[str, GatewayLease]
    """By the robot's name: see `Lease.gateways`."""
    until: int
    """When the first of them expires, by the clock here, ns: rather too early than too late."""


class GatewayLeases:
    """Asks the robots' own gateways for leases, and knows those that they have granted to anybody."""

    def __init__(self, robots: Robots, clock: Clock, leases: Mapping[str, Lease]) -> None:
        self._robots, self._clock, self._leases = robots, clock, leases
        self._leased: dict[str, RobotUnit] = {}
        """The robots whose gateways hold leases, by name."""

    def units(self, scope: Scope) -> list[RobotUnit]:
        """List the robots in a scope that have gateways of their own."""
        return [
            unit
            for owner in self._robots.backends
            if owner.has_gateways and owner.tenant == scope.tenant
            for unit in owner.units
            if unit.robot is not None and _has(scope, unit)
        ]

    def update(self, unit: RobotUnit) -> bool:
        """Note the leases at a robot's gateway; return whether there are or were any."""
        before, own = self._leased.pop(unit.name, None), unit.own_leases
        if own is not None and own.leases:
            self._leased[unit.name] = unit
        return before is not None or unit.name in self._leased

    def others(self) -> Iterator[RobotLease]:
        """Go through the leases at gateways that were not granted through this one."""
        ours = {(name, held.id) for one in self._leases.values() for name, held in one.of_robots()}
        for name, unit in list(self._leased.items()):
            own = unit.own_leases
            for lease in () if own is None else own.leases:
                if (name, lease.id) not in ours:
                    yield lease

    def over(self, unit: RobotUnit, path: str) -> RobotLease | None:
        """Return the lease at its own gateway that a path of a robot is under, if known."""
        leases = () if unit.own_leases is None else unit.own_leases.leases
        return next((one for one in leases if Scope(one.scope).covers(path)), None)

    async def acquire(
        self,
        units: Iterable[RobotUnit],
        scope: Scope,
        ttl: float,
        *,
        take: bool,
        reason: str | None,
        principal: str,
        program: Program,
    ) -> Granted:
        """Acquire a lease at all robots, or at none of them.

        :raises RcpError: one of them refuses, or cannot be asked.
        """
        before = self._clock.now()
        wanted = {
            unit: RobotLeaseRequest(
                do="acquire",
                scope=narrowed(scope, unit),
                ttl=ttl,
                take=take,
                reason=reason,
                program=program.name,
                former=program.former,
            )
            for unit in sorted(units, key=lambda unit: unit.name)
        }
        # What somebody had before stays theirs; another hub's lease of the person may be the same.
        fresh = {u for u, one in wanted.items() if not _holds(u, one.scope, principal)}
        refused = set(wanted)

        async def ask(unit: RobotUnit) -> RobotLease:
            refused.discard(unit)
            try:
                return await unit.lease_own(wanted[unit])
            except Refused:
                refused.add(unit)
                raise

        try:
            # Whoever gets the first one has gone ahead of others who ask for the same.
            first, *rest = wanted
            granted = {first: await ask(first)}
            granted |= await _all({unit: ask(unit) for unit in rest})
            return self._granted(granted, before)
        except BaseException:
            # Not where it was refused: a release would also forgive an earlier loss there.
            undo = [self._undo(unit, wanted[unit].scope) for unit in fresh - refused]
            _background(asyncio.gather(*undo, return_exceptions=True))
            raise

    async def extend(
        self, units: Iterable[RobotUnit], lease: Lease, ttl: float, program: Program
    ) -> Granted:
        """Renew a lease at all robots of its scope; one that is new in there is asked for it.

        :raises LeaseHeld, LeaseLost, LeaseRequired: a robot's gateway holds it no longer.
        :raises RcpError: one of them cannot be asked.
        """
        before = self._clock.now()
        asked: dict[RobotUnit, Coroutine[Any, Any, RobotLease]] = {}
        for unit in units:
            held, scope = lease.gateways.get(unit.name), narrowed(lease.scope, unit)
            request = RobotLeaseRequest(
                do="acquire" if held is None else "renew",
                scope=scope,
                lease=None if held is None else held.id,
                ttl=ttl,
                reason=lease.reason if held is None else None,
                program=program.name,
            )
            asked[unit] = unit.lease_own(request)
        return self._granted(await _all(asked), before)

    async def release(self, units: Iterable[RobotUnit], lease: Lease) -> None:
        """Release a lease that is no longer held here; at a robot that cannot be asked it expires."""
        asked = [
            unit.lease_own(
                RobotLeaseRequest(do="release", scope=narrowed(lease.scope, unit), lease=held.id)
            )
            for unit in units
            if (held := lease.gateways.get(unit.name)) is not None
            and not self._is_used(unit.name, held.id)
        ]
        await asyncio.gather(*asked, return_exceptions=True)

    async def hand_over(self, units: Iterable[RobotUnit], lease: Lease, heir: Any) -> Granted:
        """Hand a lease over at all robots.

        :raises RcpError: one of them refuses, or cannot be asked; others may have done it.
        """
        before = self._clock.now()
        asked = {
            unit: unit.lease_own(
                RobotLeaseRequest(
                    do="hand_over", scope=narrowed(lease.scope, unit), lease=held.id, heir=heir
                )
            )
            for unit in units
            if (held := lease.gateways.get(unit.name)) is not None
        }
        return self._granted(await _all(asked), before)

    def _is_used(self, name: str, id_: str) -> bool:
        """Return whether another lease here is the same one at a robot's gateway."""
        held = (one.gateways.get(name) for one in self._leases.values())
        return any(one is not None and one.id == id_ for one in held)

    async def _undo(self, unit: RobotUnit, scope: str) -> None:
        await unit.lease_own(RobotLeaseRequest(do="release", scope=scope))

    def _granted(self, granted: Mapping[RobotUnit, RobotLease], before: int) -> Granted:
        """Return what was granted, if it lasts any longer."""
        left = min((one.expires - one.reported for one in granted.values()), default=0)
        if granted and before + left <= self._clock.now():
            raise DeadlineExceeded("the lease has expired at a robot before the last one answered")
        return Granted(
            {unit.name: GatewayLease(one.id, one.reported) for unit, one in granted.items()},
            before + left,
        )


def narrowed(scope: Scope, unit: RobotUnit) -> str:
    """Return the part of a scope that is one robot's."""
    parts = scope.text.count("/")
    whole = scope.robot is None and parts <= 3
    return f"{scope.text}/{unit.robot_segment}" if whole else scope.text


def _has(scope: Scope, unit: RobotUnit) -> bool:
    if scope.robot is not None:
        return scope.robot == unit.robot_segment
    return any(scope.covers(entry.path) for entry in unit.own.values())


def _holds(unit: RobotUnit, scope: str, principal: str) -> bool:
    own = unit.own_leases
    return own is not None and any(
        one.scope == scope and one.holder == principal for one in own.leases
    )


async def _all(
    asked: Mapping[RobotUnit, Coroutine[Any, Any, RobotLease]],
) -> dict[RobotUnit, RobotLease]:
    """Wait for all answers, and raise the first refusal."""
    found = await asyncio.gather(*asked.values(), return_exceptions=True)
    granted: dict[RobotUnit, RobotLease] = {}
    for unit, one in zip(asked, found, strict=True):
        if isinstance(one, BaseException):
            raise one
        granted[unit] = one
    return granted


_running: set[asyncio.Future[Any]] = set()


def _background(future: asyncio.Future[Any]) -> None:
    """Keep a future until it is done."""
    _running.add(future)
    future.add_done_callback(_running.discard)
