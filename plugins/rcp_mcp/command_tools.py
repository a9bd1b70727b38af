"""The tools that change something: write, execute, cancel, and those of actions and services."""

from __future__ import annotations

import asyncio
from typing import Annotated, Any

import msgspec
from mcp import types
from msgspec import Meta, Raw

from rcp_gateway.api import Session
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import BadRequest, RcpError
from rcp_kernel.model import parse_path
from rcp_kernel.values import value_type
from rcp_kernel.wire import NO_BODY, Reply, Request
from rcp_mcp.answers import answered, body_of, failed, replied
from rcp_mcp.approval_tools import ApprovalTools
from rcp_mcp.aside import aside
from rcp_mcp.caller import takes_tasks
from rcp_mcp.catalogue import Catalogue, Typed, matches
from rcp_mcp.command_replies import Following
from rcp_mcp.config import McpConfig
from rcp_mcp.content import text
from rcp_mcp.fixed import PLANS, Cancel, Execute, Plan, Write, WriteAll
from rcp_mcp.logs import Logs
from rcp_mcp.offers import Context, Outcome
from rcp_mcp.repeats import with_key
from rcp_mcp.stops import is_hold
from rcp_mcp.tasks import Tasks
from rcp_protocol.trace import carried
from rcp_web.untrusted import marked, speaks

__all__ = ["CommandTools"]


class _Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The options that a tool accepts in addition to the command's input."""

    deadline: Annotated[float, Meta(gt=0, le=86_400)] | None = None
    wait: Annotated[float, Meta(ge=0, le=3600)] | None = None
    dry_run: bool = False
    approval: Annotated[str, Meta(max_length=128)] | None = None


_OPTIONS = value_type(_Options)


class CommandTools:
    """The handlers."""

    def __init__(
        self, config: McpConfig, client_api: ClientApi, catalogue: Catalogue, logs: Logs
    ) -> None:
        self.config = config
        self.logs = logs
        self.client_api = client_api
        self.catalogue = catalogue
        self.tasks = Tasks(config, client_api)
        self._approving = ApprovalTools(client_api)

    async def write(self, ctx: Context, session: Session, arguments: Write) -> Outcome:
        """Set a value."""
        request = Request(
            type="write",
            path=arguments.path,
            body=_raw(arguments.value),
            valid_for=arguments.valid_for,
            dry_run=arguments.dry_run,
            idempotency_key=arguments.idempotency_key,
            approval=arguments.approval,
        )
        return await self.run(ctx, session, request, None)

    async def write_all(self, ctx: Context, session: Session, arguments: WriteAll) -> Outcome:
        """Set several values as one."""
        request = Request(
            type="write",
            body=_raw(arguments.values),
            valid_for=arguments.valid_for,
            dry_run=arguments.dry_run,
            idempotency_key=arguments.idempotency_key,
            approval=arguments.approval,
        )
        return await self.run(ctx, session, request, None)

    async def execute(self, ctx: Context, session: Session, arguments: Execute) -> Outcome:
        """Run an action or service by its path."""
        request = Request(
            type="execute",
            path=arguments.path,
            body=NO_BODY if arguments.input is None else _raw(arguments.input),
            deadline=arguments.deadline,
            dry_run=arguments.dry_run,
            idempotency_key=arguments.idempotency_key,
            approval=arguments.approval,
        )
        return await self.run(ctx, session, request, arguments.wait)

    async def plan(self, ctx: Context, session: Session, arguments: Plan) -> Outcome:
        """Run a plan."""
        plan = arguments.plan
        request = Request(
            type="execute",
            path=PLANS,
            body=_raw({"lines": plan} if isinstance(plan, str) else plan),
            deadline=arguments.deadline,
            dry_run=arguments.dry_run,
            idempotency_key=arguments.idempotency_key,
            approval=arguments.approval,
        )
        return await self.run(ctx, session, request, arguments.wait)

    async def call(
        self, ctx: Context, session: Session, typed: Typed, arguments: dict[str, Any]
    ) -> Outcome:
        """Run the action or service of a tool."""
        taken = typed.arguments
        given = {key: item for key, item in arguments.items() if key not in taken.options}
        chosen = {key: item for key, item in arguments.items() if key in taken.options}
        options: _Options = _OPTIONS.convert(chosen, "the options")
        request = Request(
            type="execute",
            path=typed.facts["path"],
            body=_input(typed, given),
            deadline=options.deadline,
            dry_run=options.dry_run,
            approval=options.approval,
        )
        return await self.run(ctx, session, request, options.wait)

    async def run(
        self, ctx: Context, session: Session, request: Request, wait: float | None
    ) -> Outcome:
        """Run a command until it ends or the caller's time limit expires."""
        if request.custom is None:
            request.custom = carried((ctx.params or {}).get("_meta"))
        with_key(ctx, request, _whole(session, request.path))
        self._approving.returned(ctx, session, request)
        found = await self._tried(ctx, session, request, wait)
        if isinstance(found, Reply) and found.error is not None:
            decision = await self._approving.request_decision(ctx, session, request, found)
            if isinstance(decision, types.InputRequiredResult):
                return decision
            if decision:
                found = await self._tried(ctx, session, request, wait)
        if not isinstance(found, Reply):
            return found
        await self._log(ctx, found)
        return await aside(body_of(found), lambda: replied(found, self.config))

    async def _log(self, ctx: Context, reply: Reply) -> None:
        """Tell a client that wants log messages what became of its command."""
        level = "info" if reply.error is None else "error"
        code = None if reply.error is None else reply.error["code"]
        facts = {"path": reply.path, "status": reply.status, "command": reply.command, "code": code}
        await self.logs.send(ctx, level, {k: v for k, v in facts.items() if v is not None})

    async def _tried(
        self, ctx: Context, session: Session, request: Request, wait: float | None
    ) -> Reply | Outcome:
        """Send a request once; return its final reply, or an earlier result for the caller."""
        if request.type == "write":
            return await self.client_api.request(session, request)
        following = Following(self.client_api, session)

        async def report(progress: float, message: str | None, reply: Reply) -> None:
            await ctx.session.report_progress(progress, 1.0, _said(message, reply))

        try:
            following.start(request)
            if takes_tasks(ctx) and not request.dry_run and self._is_long(session, request.path):
                begun = await following.begun()
                if not begun.final and following.command is not None:
                    return self.tasks.created(ctx, following.command)
            patience = self.config.wait if wait is None else wait
            final = await following.until(patience, 1 / self.config.feedback, report)
        except asyncio.CancelledError:
            if self.stops(session, request.path):
                following.stop()
            raise
        return final if final is not None else _going_on(following)

    def _is_long(self, session: Session, path: str | None) -> bool:
        facts = self.catalogue.find(session, _whole(session, path))
        return facts is not None and facts["kind"] == "action"

    def stops(self, session: Session, path: str | None) -> bool:
        """Return whether cancelling a call of a path stops the robot."""
        whole = _whole(session, path)
        # Cancelling a hold would leave the robot moving.
        return not is_hold(whole) and not matches(self.config.keeps_going, whole)

    async def cancel(self, ctx: Context, session: Session, arguments: Cancel) -> Outcome:
        """Cancel a command, or what runs on a path."""
        if (arguments.command is None) == (arguments.path is None):
            raise BadRequest(
                "`cancel` needs either `command` or `path`",
                remedy="Send the command id from the call's result, or the path of the action.",
            )
        request = Request(type="cancel", command=arguments.command, path=arguments.path)
        reply = await self.client_api.request(session, request)
        if reply.error is not None:
            return failed(reply.error, reply.status)
        return answered({**body_of(reply), "path": reply.path, "message": reply.message})


def _going_on(following: Following) -> types.CallToolResult:
    """Return that a command is still running."""
    latest = following.latest
    facts: dict[str, Any] = {"status": "in_progress", "command": following.command}
    if latest is not None:
        body = body_of(latest) if latest.status == "in_progress" else None
        facts |= {"path": latest.path, "progress": latest.progress, "feedback": body}
        facts["untrusted"] = True if speaks(body) else None
    facts["message"] = (
        "The command is still running. Call `status` with command "
        f"{following.command} and `wait`, or `cancel`."
    )
    found = {key: item for key, item in facts.items() if item is not None}
    if not found.get("untrusted"):
        return answered(found)
    said = types.TextContent(type="text", text=facts["message"])
    feedback = text(found["feedback"], found.get("path"), untrusted=True)
    return answered(found, said, feedback)


def _whole(session: Session, path: str | None) -> str:
    """Return the full path that the caller means, or the text itself if it is not a path."""
    try:
        return parse_path(path or "", session.tenant)
    except RcpError:
        return path or ""


def _said(message: str | None, reply: Reply) -> str | None:
    """Return feedback as text, marked if it contains text from the robot."""
    body = body_of(reply)
    if body is None:
        return message
    written = msgspec.json.encode(body).decode()[:500]
    return marked(written, reply.path) if speaks(body) else written


def _raw(plain: Any) -> Raw:
    return Raw(msgspec.json.encode(plain))


def _input(typed: Typed, given: dict[str, Any]) -> Raw:
    """Build a command's input from a call's arguments.

    :raises BadRequest: there are arguments that the tool does not accept.
    """
    taken = typed.arguments
    if not taken.wrapped:
        return NO_BODY if not given and taken.optional else _raw(given)
    unknown = sorted(given.keys() - {"value"})
    if unknown:
        raise BadRequest(
            f"{typed.tool.name} has no argument {unknown[0][:60]!r}",
            path=typed.facts["path"],
            remedy="Its input is the argument `value`.",
        )
    return _raw(given["value"]) if "value" in given else NO_BODY
