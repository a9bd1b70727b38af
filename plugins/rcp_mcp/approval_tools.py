"""Approval of commands by the person at the client.

The gateway's rules say which commands require approval, and who may approve at their own client
(`approve_own`). The model is not involved: the client asks the person, and the state in between is
sealed for this caller, tool and arguments.
"""

from __future__ import annotations

from typing import Any

from mcp import types
from mcp.shared.exceptions import MCPError

from rcp_gateway.api import Session
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import ApprovalRequired, Forbidden
from rcp_kernel.features.approval import APPROVALS, NoApprovals
from rcp_kernel.model import tenant_of
from rcp_kernel.wire import Reply, Request
from rcp_mcp.caller import asks_people, modern
from rcp_mcp.offers import Context

__all__ = ["ApprovalTools"]

_KEY = "approval"
_SHOWN = 400  # characters of a command's value in the question


class ApprovalTools:
    """Asks for approval, and handles the response."""

    def __init__(self, client_api: ClientApi) -> None:
        self._client_api = client_api

    def returned(self, ctx: Context, session: Session, request: Request) -> None:
        """Handle the response that a repeated call carries.

        :raises Forbidden: the person refused, or may not approve.
        """
        params = ctx.params or {}
        state, answers = params.get("requestState"), params.get("inputResponses")
        if not isinstance(state, str) or not isinstance(answers, dict):
            return
        answer: Any = answers.get(_KEY)  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]
        if isinstance(answer, dict):
            self._decide(session, request, state, answer)  # pyright: ignore[reportUnknownArgumentType]

    async def request_decision(
        self, ctx: Context, session: Session, request: Request, reply: Reply
    ) -> types.InputRequiredResult | bool:
        """Ask if the client supports it; True means that the same request may be sent again.

        :raises Forbidden: the person refused.
        """
        error = reply.error or {}
        path, id_ = reply.path or "", (error.get("details") or {}).get("approval")
        if error.get("code") != ApprovalRequired.code or request.approval is not None:
            return False
        if not isinstance(id_, str) or not self._may_ask(ctx, session, path):
            return False
        message = _question(session, request, path)
        schema: dict[str, Any] = {
            "type": "object",
            "properties": {
                "approve": {
                    "type": "boolean",
                    "title": "Approve",
                    "description": "Approve: the robot executes this command now, once.",
                }
            },
            "required": ["approve"],
        }
        if modern(ctx):
            form = types.ElicitRequestFormParams(message=message, requested_schema=schema)
            return types.InputRequiredResult(
                input_requests={_KEY: types.ElicitRequest(params=form)}, request_state=id_
            )
        try:
            found = await ctx.session.elicit_form(message, schema, ctx.request_id)
        except MCPError:  # the client cannot ask after all; the refusal lists the alternatives
            return False
        self._decide(session, request, id_, found.model_dump())
        return request.approval is not None

    def _may_ask(self, ctx: Context, session: Session, path: str) -> bool:
        tenant = tenant_of(path)
        return (
            asks_people(ctx)
            and (modern(ctx) or ctx.session.can_send_request)
            and tenant is not None
            and session.rights.may_approve_own(tenant)
        )

    def _decide(self, session: Session, request: Request, id_: str, answer: dict[str, Any]) -> None:
        action, content = answer.get("action"), answer.get("content")
        if action == "cancel":
            return
        yes = action == "accept" and isinstance(content, dict) and content.get("approve") is True  # pyright: ignore[reportUnknownMemberType]
        approvals = self._client_api.service(APPROVALS) or NoApprovals()
        decision = "approve" if yes else "reject"
        approvals.answer(session, id_, decision, "approved at the client")
        if not yes:
            raise Forbidden(
                "the person at the client did not approve the command",
                path=request.path,
                remedy="Do not repeat the command; ask the person how to proceed.",
            )
        request.approval = id_


def _question(session: Session, request: Request, path: str) -> str:
    value = bytes(request.body).decode(errors="replace")
    shown = value if len(value) <= _SHOWN else value[:_SHOWN] + "…"
    what = f" with {shown}" if shown else ""
    if request.path is None:  # of the write of several paths, the value names all of them
        path, what = "as one", f" {shown}"
    return (
        f"{session.principal.name} wants to {request.type} {path}{what}. "
        "This command moves or changes a robot and requires approval. Approve it?"
    )
