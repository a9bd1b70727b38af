"""The tasks extension: a long action is a task with the id of its command.

Its state is that of the command, so it survives the client and a restart of the gateway, after
which interrupted commands have failed. A refusal by the robot is a result with an error; a task
itself fails only without a result.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mcp import types
from mcp.shared.exceptions import MCPError

from rcp_gateway.api import Command
from rcp_gateway.client_api import ClientApi
from rcp_kernel.clock import iso
from rcp_kernel.errors import RcpError, UnknownPath
from rcp_kernel.wire import Request
from rcp_mcp.answers import body_of, replied
from rcp_mcp.aside import aside
from rcp_mcp.caller import TASKS, modern, session_of, takes_tasks
from rcp_mcp.config import McpConfig
from rcp_mcp.offers import Context, Method

__all__ = ["Tasks"]

_TTL = 3_600_000  # ms for which a command is kept, unless there are many
_POLL = 1000  # ms
_CUT_OFF = "internal"


class _TaskParams(types.RequestParams):
    task_id: str


class _UpdateParams(_TaskParams):
    input_responses: dict[str, Any] | None = None


class Tasks:
    """The handlers."""

    def __init__(self, config: McpConfig, client_api: ClientApi) -> None:
        self._config = config
        self._client_api = client_api

    def methods(self) -> Sequence[Method]:
        """List the requests of the extension."""
        return [
            Method("tasks/get", _TaskParams, self.get),
            Method("tasks/update", _UpdateParams, self.update),
            Method("tasks/cancel", _TaskParams, self.cancel),
        ]

    def created(self, ctx: Context, id_: str) -> dict[str, Any]:
        """Return the task that a call has started."""
        command = self._client_api.command(session_of(ctx), id_)
        return {"resultType": "task", **_base(command), "status": "working"}

    async def get(self, ctx: Context, params: _TaskParams) -> dict[str, Any]:
        """Return the state of a task, with its result or error."""
        command = self._found(ctx, params)
        facts = {"resultType": "complete", **_base(command)}
        if not command.final:
            return {**facts, "status": "working"}
        if command.status == "cancelled":
            return {**facts, "status": "cancelled"}
        error = command.reply().error
        if error is not None and error["code"] == _CUT_OFF:
            data = {key: item for key, item in error.items() if key != "trace_id"}
            details = {"code": types.INTERNAL_ERROR, "message": error["message"], "data": data}
            return {**facts, "status": "failed", "error": details}
        reply = command.reply()
        result = await aside(body_of(reply), lambda: replied(reply, self._config))
        plain = result.model_dump(by_alias=True, mode="json", exclude_none=True)
        return {**facts, "status": "completed", "result": plain}

    async def update(self, ctx: Context, params: _UpdateParams) -> dict[str, Any]:
        """Accept input; tasks never request any, because questions come before they start."""
        self._found(ctx, params)
        return {"resultType": "complete"}

    async def cancel(self, ctx: Context, params: _TaskParams) -> dict[str, Any]:
        """Cancel the command; the next `tasks/get` returns the outcome."""
        command = self._found(ctx, params)
        if not command.final:
            request = Request(type="cancel", command=command.id)
            reply = await self._client_api.request(session_of(ctx), request)
            if reply.error is not None:
                raise MCPError(types.INVALID_REQUEST, reply.message or "", reply.error)
        return {"resultType": "complete"}

    def _found(self, ctx: Context, params: _TaskParams) -> Command:
        """Return the command of a task.

        :raises MCPError: the caller has no such task, or the client does not support tasks.
        """
        if not modern(ctx):
            raise MCPError(types.METHOD_NOT_FOUND, "Method not found", ctx.method)
        if not takes_tasks(ctx):
            raise MCPError(
                types.MISSING_REQUIRED_CLIENT_CAPABILITY,
                "the client does not support tasks",
                {"requiredCapabilities": {"extensions": {TASKS: {}}}},
            )
        request: Any = ctx.request
        if request.headers.get("mcp-name") != params.task_id:
            raise MCPError(types.HEADER_MISMATCH, "mcp-name does not match the task's id")
        session = session_of(ctx)
        try:
            command = self._client_api.command(session, params.task_id)
            if (command.principal, command.proof) != session.principal.identity:
                raise UnknownPath(f"unknown command '{params.task_id[:64]}'")
        except UnknownPath:
            raise MCPError(types.INVALID_PARAMS, "Task not found") from None
        except RcpError as error:
            raise MCPError(types.INVALID_REQUEST, error.message) from None
        return command


def _base(command: Command) -> dict[str, Any]:
    facts: dict[str, Any] = {
        "taskId": command.id,
        "createdAt": iso(command.created),
        "lastUpdatedAt": iso(command.history[-1].time),
        "ttlMs": _TTL,
        "pollIntervalMs": _POLL,
    }
    if command.progress is not None and not command.final:
        facts["statusMessage"] = f"{command.progress:.0%} done"
    return facts
