"""The asyncio client: every request of the contract as a method."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator, Callable, Iterable, Mapping, Sequence
from typing import Any, Literal, Self

import msgspec

from rcp_client.channel import Channel
from rcp_client.command import CommandHandle, Feedback
from rcp_client.lease import Lease
from rcp_client.messages import Notice, Reply, ResourceInfo
from rcp_client.pages import joined, pages
from rcp_client.plans import plan_of
from rcp_client.requests import hold_path, kept, plain, repeat_of
from rcp_client.settings import MARGIN, Settings
from rcp_client.subscription import Subscription
from rcp_protocol.values import value_type

__all__ = ["Client"]

_PAGE = 500  # resources requested at once


def _reading(
    path: str,
    fields: Sequence[str] | None,
    fresh: bool,  # noqa: FBT001 - as its callers call it
    frame: str | None,
    limit: int | None = None,
) -> dict[str, Any]:
    options = {
        "fields": list(fields) if fields else None,
        "fresh": fresh or None,
        "frame": frame,
        "limit": limit,
    }
    return kept({"type": "read", "path": path, "body": kept(options) or None})


class Client:
    """A session with a gateway, which outlives its individual connections.

    Methods raise the error class (`rcp_protocol.errors`) of the code in the gateway's reply, with
    its
    `remedy`; `DeadlineExceeded` if no reply came in time, and `ConnectionLost` if there is no
    connection. A lost connection is recovered transparently: writes and executes carry an
    idempotency key, so that sending them again never executes them twice.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.channel = Channel(settings)

    async def __aenter__(self) -> Self:
        await self.channel.open()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.channel.close()

    @property
    def connected(self) -> bool:
        """Whether the client is currently connected."""
        return self.channel.connected

    @property
    def greeting(self) -> dict[str, Any]:
        """The gateway's reply to `hello`: principal, roles, tenant, limits."""
        return self.channel.greeting

    # -- values --------------------------------------------------------------------------------

    async def read(
        self,
        path: str,
        *,
        fields: Sequence[str] | None = None,
        fresh: bool = False,
        frame: str | None = None,
        type: Any = None,  # noqa: A002 - the natural name
        deadline: float | None = None,
    ) -> Any:
        """Return the current value of a path, or the list of all items of a pattern.

        `fields` selects some fields (`position.x`), `fresh` reads from the robot itself,
        `frame` names the frame of the value (`earth`), and `type` decodes it to a msgspec type.
        """
        reply = await self.sample(path, fields=fields, fresh=fresh, frame=frame, deadline=deadline)
        return reply.body if type is None else value_type(type).convert(reply.body)

    async def sample(
        self,
        path: str,
        *,
        fields: Sequence[str] | None = None,
        fresh: bool = False,
        frame: str | None = None,
        deadline: float | None = None,
    ) -> Reply:
        """Read a path and return the whole reply: value, number, source time, freshness.

        For a pattern, all pages are fetched; `pages` yields them one by one.
        """
        return await joined(self.channel.ask, _reading(path, fields, fresh, frame), deadline)

    async def pages(
        self,
        pattern: str,
        *,
        fields: Sequence[str] | None = None,
        fresh: bool = False,
        frame: str | None = None,
        limit: int | None = None,
        deadline: float | None = None,
    ) -> AsyncGenerator[list[dict[str, Any]]]:
        """Read a pattern page by page, each with at most `limit` items (default 1000).

        `deadline` applies to all pages together, in s.
        """
        envelope = _reading(pattern, fields, fresh, frame, limit)
        async for reply in pages(self.channel.ask, envelope, deadline):
            yield reply.body

    async def write(
        self,
        path: str,
        value: Any,
        *,
        valid_for: float | None = None,
        dry_run: bool = False,
        idempotency_key: str | None = None,
        approval: str | None = None,
        deadline: float | None = None,
    ) -> Any:
        """Write a value and return the value in force.

        `valid_for` is the time in s after which the gateway brings the robot to rest unless a new
        value is written; `dry_run` checks everything and changes nothing.
        """
        envelope = kept(
            {
                "type": "write",
                "path": path,
                "valid_for": valid_for,
                "dry_run": dry_run or None,
                "idempotency_key": idempotency_key or None,
                "approval": approval,
                "deadline": deadline,
            }
        )
        reply = await self.channel.ask({**envelope, "body": plain(value)}, "keyed")
        return reply.body

    async def write_all(
        self,
        values: Mapping[str, Any],
        *,
        valid_for: float | None = None,
        dry_run: bool = False,
        idempotency_key: str | None = None,
        approval: str | None = None,
        deadline: float | None = None,
    ) -> dict[str, Any]:
        """Write several paths of one robot as one, all or none; return the values in force.

        They must be of one `atomic` group (`discover`). The options are those of `write`, and
        concern all of them.

        :raises RcpError: of the first that is refused; `details["faults"]` names all that are.
        """
        envelope = kept(
            {
                "type": "write",
                "valid_for": valid_for,
                "dry_run": dry_run or None,
                "idempotency_key": idempotency_key or None,
                "approval": approval,
                "deadline": deadline,
            }
        )
        reply = await self.channel.ask({**envelope, "body": plain(values)}, "keyed")
        if dry_run:
            return dict(zip(values, reply.body, strict=True))
        return {path: item["body"] for path, item in zip(values, reply.body, strict=True)}

    # -- commands ------------------------------------------------------------------------------

    async def start(
        self,
        path: str,
        input: Any = None,  # noqa: A002 - the name in the protocol
        *,
        deadline: float | None = None,
        idempotency_key: str | None = None,
        approval: str | None = None,
        on_feedback: Callable[[Feedback], None] | None = None,
        type: Any = None,  # noqa: A002
    ) -> CommandHandle:
        """Start a command and return once the gateway has accepted it.

        Without a `deadline`, the time limit of the path applies. Cancelling the call cancels the
        command.

        :raises RcpError: it was refused.
        """
        more = {"idempotency_key": idempotency_key, "approval": approval}
        handle = self._execute(path, input, deadline, more, on_feedback, type)
        try:
            await handle.accepted(self._first_wait(deadline))
        except asyncio.CancelledError:
            handle.cancel_soon()
            raise
        return handle

    async def execute(
        self,
        path: str,
        input: Any = None,  # noqa: A002
        *,
        deadline: float | None = None,
        dry_run: bool = False,
        idempotency_key: str | None = None,
        approval: str | None = None,
        on_feedback: Callable[[Feedback], None] | None = None,
        type: Any = None,  # noqa: A002
    ) -> Any:
        """Run a command and return its result; cancelling the call cancels the command.

        :raises RcpError: it was refused, failed, or was cancelled.
        """
        if dry_run:
            envelope = {"type": "execute", "path": path, "dry_run": True, "body": plain(input)}
            return (await self.channel.ask(envelope)).body
        more = {"idempotency_key": idempotency_key, "approval": approval}
        handle = self._execute(path, input, deadline, more, on_feedback, type)
        try:
            await handle.accepted(self._first_wait(deadline))
            return await handle.result()
        except asyncio.CancelledError:
            handle.cancel_soon()
            raise

    def _first_wait(self, deadline: float | None) -> float:
        own = self.settings.deadline
        return (own if deadline is None else min(deadline, own)) + MARGIN

    def _execute(
        self,
        path: str,
        value: Any,
        deadline: float | None,
        more: dict[str, Any],
        on_feedback: Callable[[Feedback], None] | None,
        type_: Any,
    ) -> CommandHandle:
        envelope: dict[str, Any] = {"type": "execute", "path": path}
        envelope |= kept(more)
        if value is not None:
            envelope["body"] = plain(value)
        if deadline is not None:
            envelope["deadline"] = deadline
        call = self.channel.start(envelope, repeat_of(envelope))
        limit = None if deadline is None else deadline + MARGIN
        return CommandHandle(self.channel, call, limit=limit, type_=type_, on_feedback=on_feedback)

    async def plan(
        self,
        plan: str | Sequence[Mapping[str, Any]] | Mapping[str, Any],
        *,
        dry_run: bool = False,
        approval: str | None = None,
        deadline: float | None = None,
        idempotency_key: str | None = None,
        on_feedback: Callable[[Feedback], None] | None = None,
    ) -> list[dict[str, Any]]:
        """Run several operations as one plan, checked first; return the state of each step.

        `plan` is a list of steps, a complete body, or a text: the output of a planner, or command
        lines (docs/protocol.md, Plans). Feedback reports each change of a step. `dry_run` returns
        the requests that would be sent. Cancelling the call cancels the plan.

        :raises RcpError: it was refused (`details["faults"]` lists all faults), or a step failed
            (`details["body"]` has the state of each step).
        """
        result = await self.execute(
            "/system/plans",
            plan_of(plan),
            dry_run=dry_run,
            approval=approval,
            deadline=deadline,
            idempotency_key=idempotency_key,
            on_feedback=on_feedback,
        )
        return result["steps"]

    async def approve(
        self, approval: str, *, reject: bool = False, reason: str | None = None
    ) -> dict[str, Any]:
        """Decide on another principal's approval request (docs/protocol.md, Approvals)."""
        decision = "reject" if reject else "approve"
        body = kept({"id": approval, "decision": decision, "reason": reason})
        return await self.execute("/system/approvals", body)

    async def approvals(self) -> list[dict[str, Any]]:
        """List the approvals that this principal may decide on or has requested."""
        return await self.read("/system/approvals")

    async def cancel(self, command: str) -> list[str]:
        """Cancel a command by the gateway's id, or all commands on a path; return the ids."""
        named = "path" if command.startswith("/") else "command"
        reply = await self.channel.ask({"type": "cancel", named: command})
        return (reply.body or {}).get("cancelled", [])

    async def commands(self) -> list[dict[str, Any]]:
        """List running and recent commands, newest first, with their histories."""
        return await self.read("/system/commands")

    async def estop(
        self,
        *,
        reset: bool = False,
        scope: str | None = None,
        reason: str | None = None,
        deadline: float | None = None,
    ) -> dict[str, Any]:
        """Stop every robot visible to this principal, or those in `scope`; or reset the stop.

        `scope` is a robot, a group, a backend or a tenant (docs/protocol.md, E-stop). Returns the
        state of the e-stop once every robot in scope is confirmed at rest by measurement;
        `deadline` limits that time in s (in this client; the gateway waits at most 60 s). A reset
        is not repeated after a lost connection.

        :raises DeviceTimeout: a robot is not confirmed at rest; `details["robots"]` has the
            progress and reason for each. It stays latched, and the gateway repeats the stop.
        """
        body = kept({"reset": reset or None, "scope": scope, "reason": reason})
        envelope: dict[str, Any] = {"type": "execute", "path": "/system/estop", "body": body}
        if deadline is not None:
            envelope["deadline"] = deadline
        return (await self.channel.ask(envelope, repeat_of(envelope))).body

    async def hold(
        self, robot: str | None = None, *, deadline: float | None = None
    ) -> dict[str, Any]:
        """Bring a robot to rest and end its commands, without an e-stop: the next command moves it.

        `robot` is its name in the session's tenant, or `/tenant/<tenant>/<robot>`; it can be
        omitted if the tenant has a single unnamed robot. Returns `at_rest` and `detail`.

        :raises DeviceTimeout: the robot was commanded to stop but still moves: use the e-stop.
        :raises UnknownPath: there is no such robot, or it has nothing that moves.
        """
        return await self.execute(hold_path(robot), deadline=deadline)

    def lease(
        self,
        scope: str,
        *,
        ttl: float | None = None,
        take: bool = False,
        reason: str | None = None,
    ) -> Lease:
        """Return a lease; `async with` acquires, renews and releases it.

        `scope` is a tenant, a robot or a sub-tree (docs/protocol.md, Leases). `take` takes it over
        from holders with a lower priority, who receive the `reason`. Losing the lease cancels the
        block, which then raises `LeaseLost`.
        """
        body = {"scope": scope, "ttl": ttl, "take": take or None, "reason": reason}
        return Lease(self.channel, kept(body))

    async def robots(self, q: str | None = None) -> list[dict[str, Any]]:
        """List the robots visible to this principal, or those that a text finds.

        Each has `path`, `state`, `kind`, `profiles`, `control` and more, as far as known
        (docs/inventory.md). All words of `q` must occur: `drone` finds copters and planes.
        """
        envelope = {"type": "read", "path": "/system/robots", "body": kept({"q": q or None})}
        reply = await joined(self.channel.ask, envelope)
        return reply.body

    async def leases(self) -> list[dict[str, Any]]:
        """List the leases on robots visible to this principal."""
        return await self.read("/system/leases")

    # -- streams -------------------------------------------------------------------------------

    def subscribe(
        self,
        patterns: str | Iterable[str],
        *,
        rate: float | None = None,
        on: Literal["sample", "change"] | None = None,
        deadband: Any = None,
        where: dict[str, Any] | None = None,
        fields: Sequence[str] | None = None,
        frame: str | None = None,
        history: int | str | None = None,
        initial: bool | None = None,
        reliable: bool = False,
        qos: dict[str, Any] | None = None,
        encoding: Literal["native"] | None = None,
        duration: float | None = None,
        count: int | None = None,
        type: Any = None,  # noqa: A002
        buffer: int = 4096,
        on_notice: Callable[[Notice], None] | None = None,
    ) -> Subscription:
        """Return a subscription to paths or patterns; iterating or `async with` starts it.

        For the options see docs/protocol.md, section 7. `reliable` is short for the `qos` of that
        name: every sample in order, or an `Overrun`. `buffer` is the number of unread updates
        queued in the client before the oldest is dropped (or a reliable subscription ends).
        """
        wanted = [patterns] if isinstance(patterns, str) else list(patterns)
        if not wanted:
            raise ValueError("a subscription needs at least one path or pattern")
        if reliable:
            qos = {**(qos or {}), "reliability": "reliable"}
        options: dict[str, Any] = {
            "rate": rate,
            "on": on,
            "deadband": deadband,
            "where": where,
            "fields": list(fields) if fields else None,
            "frame": frame,
            "history": history,
            "initial": initial,
            "qos": qos,
            "encoding": encoding,
            "duration": duration,
            "count": count,
        }
        return Subscription(
            self.channel, wanted, options, type_=type, buffer=buffer, on_notice=on_notice
        )

    # -- the gateway ---------------------------------------------------------------------------

    async def discover(
        self,
        pattern: str | None = None,
        *,
        kind: str | None = None,
        op: str | None = None,
        q: str | None = None,
        profile: str | None = None,
        schemas: bool = True,
        offers: bool = False,
    ) -> list[ResourceInfo]:
        """List the matching resources: by path, `kind`, operation, words in `q`, and `profile`.

        `offers` adds the operations that this principal may not use.
        """
        found: list[ResourceInfo] = []
        wanted = {"kind": kind, "op": op, "q": q, "profile": profile, "limit": _PAGE}
        body = {**kept(wanted), "schemas": schemas, **kept({"offers": offers or None})}
        envelope = kept({"type": "discover", "path": pattern, "body": body})
        async for reply in pages(self.channel.ask, envelope):
            found += msgspec.convert(reply.body["resources"], list[ResourceInfo])
        return found

    async def status(self) -> dict[str, Any]:
        """Return the gateway's health report."""
        return (await self.channel.ask({"type": "status"})).body

    async def ping(self) -> float:
        """Return the round-trip time of a request in s."""
        began = time.perf_counter()
        await self.channel.ask({"type": "ping"})
        return time.perf_counter() - began

    async def batch(self, envelopes: Sequence[dict[str, Any]]) -> list[Reply]:
        """Send several requests as one and return their final replies in the same order.

        A reply with an error does not raise; check its `status`.
        """
        envelope: dict[str, Any] = {"type": "batch", "body": list(envelopes)}
        reply = await self.channel.ask(envelope, repeat_of(envelope))
        return msgspec.convert(reply.body, list[Reply])

    async def request(self, envelope: dict[str, Any]) -> Reply:
        """Send any envelope, including `x-…` fields, and return its final reply.

        :raises RcpError: the reply contains an error.
        """
        whole = {key: item for key, item in envelope.items() if key != "id"}
        return await self.channel.ask(whole, repeat_of(whole))
