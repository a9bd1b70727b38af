"""`rcpctl estop` and `rcpctl hold`: stop robots, and show for each whether it is at rest."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Any

from rcp_client.client import Client
from rcp_client.console import show, whole
from rcp_client.console.output import Output, exit_code
from rcp_client.messages import ResourceInfo
from rcp_client.requests import kept
from rcp_protocol.errors import DeviceTimeout, RcpError, UnknownPath

__all__ = ["estop", "estop_without_session", "hold"]

_FAILED = 1
_HELD = "Held."
"""Prefix of the output schema id of every `service/hold` of the gateway."""


async def estop(client: Client, out: Output, args: dict[str, Any]) -> int:
    """Stop the robots in scope, or reset the stop, and show the progress of each robot's stop."""
    late: DeviceTimeout | None = None
    try:
        state = await client.estop(reset=args["reset"], scope=args["scope"], reason=args["reason"])
    except DeviceTimeout as error:
        late = error
        state = _state_of(error)
        with suppress(RcpError):  # otherwise show the robots named in the error
            state = await client.read("/system/estop")
    return _shown(out, args, state, late)


async def estop_without_session(client: Client, out: Output, args: dict[str, Any]) -> int:
    """Do the same by one HTTP request, if the gateway has no session for this client."""
    body = {"reset": args["reset"] or None, "scope": args["scope"], "reason": args["reason"]}
    envelope = {"type": "execute", "path": "/system/estop", "body": kept(body)}
    try:
        reply = await whole.request(client, envelope)
    except DeviceTimeout as error:
        return _shown(out, args, _state_of(error), error)
    return _shown(out, args, reply.body, None)


def _state_of(error: DeviceTimeout) -> dict[str, Any]:
    return {"active": True, "robots": (error.details or {}).get("robots") or {}, "scopes": {}}


def _shown(
    out: Output, args: dict[str, Any], state: dict[str, Any], late: DeviceTimeout | None
) -> int:
    if out.json:
        out.document(state)
    else:
        show.estop(out, state)
    if late is not None:
        out.error(late)
        return exit_code(late)
    robots: dict[str, dict[str, Any]] = state.get("robots") or {}
    moving = sorted(name for name, robot in robots.items() if not show.confirmed(robot))
    if not moving:
        return 0
    out.aside(f"rcpctl: not confirmed at rest: {', '.join(moving)}.")
    # With a scope, these are robots of another stop: the reply was `completed`.
    return 0 if args["reset"] or args["scope"] is not None else _FAILED


async def hold(client: Client, out: Output, args: dict[str, Any]) -> int:
    """Bring one robot, or every robot of the tenant, to rest without a latch."""
    found = await _holds(client, args["robot"])
    outcomes = await asyncio.gather(*(_hold(client, one) for one in found))
    if out.json:
        for outcome in outcomes:
            out.document(outcome)
    else:
        show.holds(out, outcomes)
    return _FAILED if any(not outcome["at_rest"] for outcome in outcomes) else 0


async def _hold(client: Client, found: ResourceInfo) -> dict[str, Any]:
    facts: dict[str, Any] = {"robot": _name(found), "path": found.path}
    try:
        return facts | await client.execute(found.path)
    except RcpError as error:
        return facts | {"at_rest": False, "detail": error.message, "code": error.code}


async def _holds(client: Client, robot: str | None) -> list[ResourceInfo]:
    """Find `service/hold` of a robot, by its name in the tree or that of its backend."""
    place = ""
    if robot is not None and robot.startswith("/"):
        parts = robot.split("/")
        place, robot = "/".join(parts[:3]), "/".join(parts[3:]) or None
    listed = await client.discover(f"{place}/service/**/hold", op="execute", schemas=False)
    # A robot may have its own service of that name.
    holds = [one for one in listed if one.schema_ids.get("output", "").startswith(_HELD)]
    found = [one for one in holds if robot is None or robot in _names(one)]
    if not found:
        known = ", ".join(sorted(_name(one) for one in holds))
        raise UnknownPath(
            f"no robot '{robot}' with a hold service" if robot else "no robot with a hold service",
            remedy=f"The robots are: {known}." if known else "Run `rcpctl discover '/service/**'`.",
        )
    return found


def _name(found: ResourceInfo) -> str:
    """Return the name of a robot in the tree, or that of its backend if it has none."""
    names = found.path.split("/")[4:]  # after /tenant/<tenant>/service
    return "/".join(names[:-1]) or found.backend or found.path


def _names(found: ResourceInfo) -> tuple[str | None, ...]:
    name = _name(found)
    return name, found.backend, f"{found.backend}/{name}"
