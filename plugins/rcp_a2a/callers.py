"""The caller: from a request to the session that the agent acts for, and the SDK's context."""

from __future__ import annotations

import time
from urllib.parse import parse_qs

import msgspec
from a2a.auth.user import User
from a2a.extensions.common import HTTP_EXTENSION_HEADER, get_requested_extensions
from a2a.server.agent_execution import RequestContext, SimpleRequestContextBuilder
from a2a.server.context import ServerCallContext
from a2a.server.routes.common import ServerCallContextBuilder
from a2a.server.tasks import TaskStore
from a2a.types.a2a_pb2 import SendMessageRequest, Task
from a2a.utils.constants import VERSION_HEADER
from starlette.requests import Request

from rcp_gateway.api import Principal, Session

__all__ = [
    "CALLER",
    "NEW_TASK",
    "Caller",
    "Callers",
    "Contexts",
    "caller_of",
    "context_of",
    "owner_of",
    "owner_text",
]

CALLER = "rcp.caller"
"""Key of the caller in a request's scope and in the SDK's context."""
NEW_TASK = "rcp.new-task"
"""Key in the SDK's context of the id for the task that a message makes."""


class Caller(msgspec.Struct, frozen=True, eq=False):
    """A client with its session, and the URL that it used."""

    session: Session
    base: str
    """The gateway's URL as this client sees it, without a trailing slash."""
    stops: bool = False
    """Whether the request stops something."""
    since: float = msgspec.field(default_factory=time.monotonic)
    """When the request arrived."""

    @property
    def principal(self) -> Principal:
        """Its identity."""
        return self.session.principal

    @property
    def tenant(self) -> str | None:
        """The tenant that it acts in."""
        return self.session.tenant


class _Named(User):
    def __init__(self, principal: Principal) -> None:
        self._principal = principal

    @property
    def is_authenticated(self) -> bool:
        return not self._principal.anonymous

    @property
    def user_name(self) -> str:
        return self._principal.name


class Callers(ServerCallContextBuilder):
    """Builds the SDK's context of a request whose caller is authenticated."""

    def build(self, request: Request) -> ServerCallContext:
        """Build the context; the protocol version may also be a URL parameter."""
        caller: Caller = request.scope[CALLER]
        headers = dict(request.headers)
        if VERSION_HEADER.lower() not in headers:
            query = parse_qs(request.scope["query_string"].decode("latin-1"))
            if (named := query.get(VERSION_HEADER)) is not None:
                headers[VERSION_HEADER.lower()] = named[0]
        return context_of(caller, headers)


def context_of(caller: Caller, headers: dict[str, str]) -> ServerCallContext:
    """Make the SDK's context of a call; over gRPC the metadata are the headers."""
    asked = headers.get(HTTP_EXTENSION_HEADER.lower())
    return ServerCallContext(
        user=_Named(caller.principal),
        state={"headers": headers, CALLER: caller},
        requested_extensions=get_requested_extensions([] if asked is None else [asked]),
    )


def caller_of(context: ServerCallContext) -> Caller:
    """Return the caller of a context that `Callers` made."""
    return context.state[CALLER]


def owner_text(session: Session) -> str:
    """Return the owner of a session's tasks: a principal, by its credentials, in a tenant."""
    name, proof = session.principal.identity
    return msgspec.json.encode([session.tenant, proof, name]).decode()


def owner_of(context: ServerCallContext) -> str:
    """Return the owner of the tasks of a call."""
    return owner_text(caller_of(context).session)


class Contexts(SimpleRequestContextBuilder):
    """Continues a message that names only its task in that task's context."""

    def __init__(self, tasks: TaskStore) -> None:
        super().__init__()
        self._tasks = tasks

    async def build(
        self,
        context: ServerCallContext,
        params: SendMessageRequest | None = None,
        task_id: str | None = None,
        context_id: str | None = None,
        task: Task | None = None,
    ) -> RequestContext:
        """Build the context of one execution."""
        if task_id is not None and context_id is None:
            # The SDK would create a new one, and the task would appear to have another owner.
            known = await self._tasks.get(task_id, context)
            context_id = None if known is None else known.context_id
        if task_id is None and params is not None:
            params.message.task_id = context.state[NEW_TASK]
        return await super().build(context, params, task_id, context_id, task)
