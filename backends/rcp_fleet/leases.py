"""Leases on one robot: asked of its own gateway, and shown as that one has them."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

from rcp_client.client import Client
from rcp_client.messages import Notice
from rcp_fleet.resources import LEASES
from rcp_fleet.sessions import GatewaySessions
from rcp_kernel.clock import parse_time
from rcp_kernel.errors import AdapterUnavailable, InvalidValue, LeaseHeld, RcpError
from rcp_kernel.model import BRANCHES
from rcp_kernel.spi import Caller, Host, OwnLeases, RobotLease, RobotLeaseRequest

__all__ = ["RobotLeases", "hub_scope", "robot_scope"]

_RELEASE = 5.0  # s for a release, whatever is left of the request that has failed
_PROGRAMS = ("program", "former")
_TENANT, _BRANCH = 3, 4  # parts of a path up to there, the empty one before the first `/` included


def robot_scope(scope: str, gateway: str) -> str:
    """Return a scope of the hub in the paths of a robot's gateway."""
    parts = scope.split("/")
    place = _TENANT if parts[_TENANT] == gateway and len(parts) == _BRANCH else _BRANCH
    return "/".join(parts[:place] + parts[place + 1 :])


def hub_scope(scope: str, gateway: str) -> str:
    """Return a scope of a robot's gateway in the paths of the hub; one that has none is widened."""
    parts = scope.split("/")
    if len(parts) == _TENANT or parts[_TENANT] not in BRANCHES:
        return "/".join([*parts[:_TENANT], gateway])
    return "/".join([*parts[:_BRANCH], gateway, *parts[_BRANCH:]])


class RobotLeases:
    """Who holds leases on one robot."""

    def __init__(self, sessions: GatewaySessions, host: Host, robot: str) -> None:
        self._sessions, self._host, self._robot = sessions, host, robot
        self._knows_programs = True
        """Whether its gateway keeps the programs of a person apart, as far as is known."""
        sessions.own.channel.listeners.append(self._heard)

    def _heard(self, notice: Notice) -> None:
        if notice.code == "disconnected":
            self._knows_programs = True  # it may be replaced meanwhile
            self._host.own_leases(self._robot, None)

    async def follow(self, path: str) -> AsyncIterator[object]:
        """Keep up with the list of leases of the robot's gateway."""
        client: Client = self._sessions.own
        async for update in client.subscribe(path):
            told = parse_time(update.timestamp)
            leases = tuple(self._lease(one, told) for one in update.body)
            self._host.own_leases(self._robot, OwnLeases(leases, told))
            yield update

    async def ask(
        self, request: RobotLeaseRequest, asked: Caller | None, left: float | None
    ) -> RobotLease:
        """Ask the robot's gateway as the person who asked.

        :raises RcpError: it refuses, or cannot be reached.
        """
        principal = None if asked is None else asked.principal
        if not self._sessions.own.connected:
            raise AdapterUnavailable(f"the gateway of '{self._robot}' cannot be reached")
        body: dict[str, Any] = {"do": request.do}
        if request.lease is not None:
            body["lease"] = request.lease
        else:
            body["scope"] = robot_scope(request.scope, self._robot)
        programs = _PROGRAMS if self._knows_programs else ()
        for name in ("ttl", "reason", *programs):
            if (value := getattr(request, name)) is not None:
                body[name] = value
        if request.take:
            body["take"] = True
        wait = _RELEASE if request.do == "release" else left
        async with self._sessions.acting(principal) as client:
            if request.heir is None:
                return await self._send(client, body, wait)
            async with self._sessions.acting(request.heir) as heir:  # who has to be there
                body["to"] = str(heir.greeting["session"])[:8]
                return await self._send(client, body, wait)

    async def _send(self, client: Client, body: dict[str, Any], wait: float | None) -> RobotLease:
        envelope: dict[str, Any] = {"type": "execute", "path": LEASES, "body": body}
        if wait is not None:
            envelope["deadline"] = wait
        try:
            reply = await client.channel.ask(envelope)
        except InvalidValue as error:  # one of an earlier version
            if "program" not in body or "program" not in error.message:
                raise
            self._knows_programs = False
            rest = {key: item for key, item in body.items() if key not in _PROGRAMS}
            return await self._send(client, rest, wait)
        except LeaseHeld as error:
            raise self._held(error) from error
        except RcpError as error:
            error.message = f"{self._robot}: {error.message}"
            raise
        return self._lease(reply.body, parse_time(reply.timestamp or ""))

    def _held(self, error: LeaseHeld) -> LeaseHeld:
        """Say it in the paths of the hub."""
        facts = dict(error.details or {})
        scope = facts["scope"] = hub_scope(facts["scope"], self._robot)
        text = f"{facts['holder']} holds the lease on {scope} until {facts['expires']}"
        return LeaseHeld(text, path=scope, retry_after=error.retry_after, details=facts)

    def _lease(self, told: dict[str, Any], moment: int) -> RobotLease:
        return RobotLease(
            id=told["lease"],
            scope=hub_scope(told["scope"], self._robot),
            holder=told["holder"],
            priority=told["priority"],
            since=parse_time(told["since"]),
            expires=parse_time(told["expires"]),
            reason=told.get("reason"),
            reported=moment,
        )
