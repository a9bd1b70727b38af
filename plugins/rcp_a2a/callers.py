"""Who calls: from a request to the session in whose name the agent acts, and to the SDK's context."""

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

from rcp_kernel.api import Principal, Session

__all__ = ["CALLER", "Caller", "Callers", "Contexts", "caller_of", "owner_of", "owner_text"]

CALLER = "rcp.caller"
"""The key under which a request's scope and the SDK's context have the caller."""


class Caller(msgspec.Struct, frozen=True, eq=False):
    """A client with its session, and the address that it came to."""

    session: Session
    base: str
    """The URL of the gateway as this client sees it, without a slash at its end."""
    since: float = msgspec.field(default_factory=time.monotonic)
    """When its request came in."""

    @property
    def principal(self) -> Principal:
        """Who it is."""
        return self.session.principal

    @property
    def tenant(self) -> str | None:
        """In which tenant it acts."""
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
    """Makes the SDK's context of a request whose caller is known already."""

    def build(self, request: Request) -> ServerCallContext:
        """Make the context; the protocol's version may come as a parameter of the URL too."""
        caller: Caller = request.scope[CALLER]
        headers = dict(request.headers)
        if VERSION_HEADER.lower() not in headers:
            asked = parse_qs(request.scope["query_string"].decode("latin-1"))
            if (named := asked.get(VERSION_HEADER)) is not None:
                headers[VERSION_HEADER.lower()] = named[0]
        return ServerCallContext(
            user=_Named(caller.principal),
            state={"headers": headers, CALLER: caller},
            requested_extensions=get_requested_extensions(
                request.headers.getlist(HTTP_EXTENSION_HEADER)
            ),
        )


def caller_of(context: ServerCallContext) -> Caller:
    """Return the caller of a context that `Callers` made."""
    return context.state[CALLER]


def owner_text(session: Session) -> str:
    """Return whose tasks a session's are: a principal's, by the proof that vouches, in a tenant."""
    name, proof = session.principal.identity
    return msgspec.json.encode([session.tenant, proof, name]).decode()


def owner_of(context: ServerCallContext) -> str:
    """Return whose tasks a call is about."""
    return owner_text(caller_of(context).session)


class Contexts(SimpleRequestContextBuilder):
    """Has a message that names only its task go on in that task's context."""

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
        """Make the context of one execution."""
        if task_id is not None and context_id is None:
            # The SDK would make up a new one, and the task would seem to be somebody else's.
            known = await self._tasks.get(task_id, context)
            context_id = None if known is None else known.context_id
        return await super().build(context, params, task_id, context_id, task)
