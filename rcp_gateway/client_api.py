"""The interface to the gateway for transports and adapters.

A transport authenticates its client (`authenticate`), opens a `Connection` for a stream or uses the
shared stateless session for single requests, and may offer `Mount`s to the transport that serves
HTTP. It only translates; all decisions are the kernel's.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from typing import Any, TypeVar

import msgspec

from rcp_gateway.mounts import Asgi, Mount, Mounts
from rcp_kernel.access.acl import Rights, Rules
from rcp_kernel.access.identities import Identities
from rcp_kernel.access.visibility import Visibility
from rcp_kernel.config.limits import Limits
from rcp_kernel.config.settings import Settings
from rcp_kernel.contract.identity import Principal
from rcp_kernel.contract.metrics import RequestCounts
from rcp_kernel.contract.peer import UNKNOWN, Peer, Serial
from rcp_kernel.contract.shutdown import Shutdown
from rcp_kernel.errors import AdapterUnavailable, Forbidden, RateLimited, RcpError, Unauthenticated
from rcp_kernel.features.services import FeatureServices, ServiceKey
from rcp_kernel.model import NativeType, Pattern
from rcp_kernel.sessions.command import Command, Record
from rcp_kernel.sessions.hello import Hello
from rcp_kernel.sessions.outbound import Outbound
from rcp_kernel.sessions.session import Answer, Session
from rcp_kernel.sessions.sessions import Sessions
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Reply, Request
from rcp_requests.command_access import CommandAccess
from rcp_requests.connections import Connection, ConnectionParts
from rcp_requests.discovery import Discovery, Query
from rcp_requests.handshake import Handshake
from rcp_requests.prompt_reply import PromptReply
from rcp_requests.replies import ReplyGate
from rcp_requests.request_events import RequestEvents
from rcp_scheduling.turns import Turns
from rcp_store.plugin_store import PluginStore
from rcp_store.store import Store

__all__ = ["Asgi", "ClientApi", "ClientApiParts", "Mount", "Proofs"]

T = TypeVar("T")


class Proofs(msgspec.Struct, frozen=True, kw_only=True):
    """The ways in which clients may authenticate, for descriptions of the gateway."""

    anonymous: bool
    """Whether anonymous clients may do anything."""
    bearer: bool
    """Keys, or tokens of any kind, in `Authorization: Bearer`."""
    certificates: bool
    """Client certificates."""
    issuers: tuple[str, ...] = ()
    """Issuers of tokens that describe themselves by OpenID Connect Discovery."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClientApiParts:
    """The parts behind the API, shared by all transports and adapters."""

    connections: ConnectionParts
    read_prompt: Callable[[Session, Request], PromptReply | None]
    settings: Settings
    shutdown: Shutdown
    rules: Rules
    identities: Identities
    visibility: Visibility
    sessions: Sessions
    handshake: Handshake
    outbound: Outbound
    discovery: Discovery
    access: CommandAccess
    services: FeatureServices
    replies: ReplyGate
    events: RequestEvents
    counts: RequestCounts
    store: Store
    is_stop: Callable[[Session, Request], bool]
    ready: Callable[[], tuple[bool, dict[str, str]]]
    absent_adapters: Callable[[], dict[str, str]]
    exposition: Callable[[Rights], Generator[None, None, bytes]]
    """Writes the Prometheus exposition for a principal, in steps."""
    turns: Turns
    loop: asyncio.AbstractEventLoop


class ClientApi:
    """The gateway as transports and adapters see it. For the event loop's thread only."""

    def __init__(self, parts: ClientApiParts, name: str, mounts: Mounts) -> None:
        self._parts = parts
        self._handle = parts.connections.handle
        self._read_prompt = parts.read_prompt
        self.name = name
        """The transport's name in sessions, counts and metrics."""
        self.mounts = mounts

    def renamed(self, name: str) -> ClientApi:
        """Return the same API under another transport's name; mounts are shared."""
        return ClientApi(self._parts, name, self.mounts)

    @property
    def limits(self) -> Limits:
        """Sizes, numbers and times that hold for every client."""
        return self._parts.settings.limits

    @property
    def loop(self) -> asyncio.AbstractEventLoop:
        """The event loop."""
        return self._parts.loop

    @property
    def turns(self) -> Turns:
        """Turns of the event loop; work for a principal is owned by its `identity`."""
        return self._parts.turns

    def generation(self, session: Session) -> int:
        """Return a number that increases when the visible tree of a session changes, for ETags."""
        return self._parts.discovery.generation(session.rights)

    @property
    def requires_authentication(self) -> bool:
        """Whether anonymous clients may do nothing: they have no role, or one that allows nothing."""
        return self._parts.settings.config.closed

    @property
    def secure(self) -> bool:
        """The former name of `requires_authentication`."""
        return self.requires_authentication

    @property
    def serves(self) -> bool:
        """Whether any client can authenticate as a principal with rights."""
        return self._parts.settings.config.serves or self._parts.identities.serves

    @property
    def closing(self) -> bool:
        """Whether the gateway is shutting down."""
        return self._parts.shutdown.begun

    @property
    def title(self) -> str:
        """The name of the gateway in the configuration."""
        return self._parts.settings.config.name

    @property
    def proofs(self) -> Proofs:
        """The ways in which clients may authenticate."""
        config, identities = self._parts.settings.config, self._parts.identities
        return Proofs(
            anonymous=not config.closed,
            bearer=bool(config.keys or identities.issuers) or identities.serves,
            certificates=bool(config.certificates),
            issuers=tuple(one.url for one in identities.issuers if one.discovery),
        )

    def store(self, table: str) -> PluginStore:
        """Return one of the plugin's own tables in the gateway's store."""
        return PluginStore(self._parts.store, f"{self.name}.{table}")

    @property
    def issuers(self) -> list[str]:
        """URLs of the issuers whose tokens this gateway accepts."""
        return [one.url for one in self._parts.identities.issuers]

    def mount(self, mount: Mount) -> None:
        """Offer a part of the HTTP tree to the listener.

        :raises PluginError: another plugin serves the same prefix, or has the same port.
        """
        self.mounts.add(mount)

    def unmount(self, mount: Mount) -> None:
        """Remove a mount."""
        if mount in self.mounts:
            self.mounts.remove(mount)

    def known(self, token: str | None, peer: Peer = UNKNOWN) -> Principal | None:
        """Return the principal of a token, else of `peer`'s certificate, else anonymous.

        None means that it takes time to determine: then await `identify`.

        :raises Unauthenticated: the token is unknown, or authentication is required.
        :raises TokenExpired: the token has expired.
        :raises RateLimited: `peer` has sent too many invalid tokens.
        """
        try:
            return self._parts.identities.known(token, peer)
        except (Unauthenticated, Forbidden, RateLimited) as error:
            self._parts.events.stranger(self.name, peer, error)
            raise

    def authenticate(self, token: str | None, peer: Peer = UNKNOWN) -> Principal:
        """Return the principal as `known`, for callers that cannot wait.

        :raises AdapterUnavailable: it takes time to determine.
        """
        principal = self.known(token, peer)
        if principal is None:
            raise AdapterUnavailable(
                "the keys of the token's issuer are not available yet",
                remedy="Try again.",
                retry_after=1,
            )
        return principal

    async def identify(self, token: str | None, peer: Peer = UNKNOWN) -> Principal:
        """Return the principal as `known`, and wait if necessary.

        :raises AdapterUnavailable: the keys of the token's issuer cannot be fetched.
        """
        principal = self.known(token, peer)
        if principal is not None or token is None:
            return principal or self._parts.identities.anonymous()
        try:
            return await self._parts.identities.wait(token, peer)
        except (Unauthenticated, Forbidden, RateLimited) as error:
            self._parts.events.stranger(self.name, peer, error)
            raise

    def connect(
        self,
        principal: Principal,
        encoding: Encoding,
        flush: Callable[[], None],
        tenant: str | None = None,
        peer: Peer = UNKNOWN,
        *,
        one_way: bool = False,
        wraps: bool = False,
    ) -> Connection:
        """Open a connection with its own session; `flush` is called to send messages.

        `flush` is called once more when the session has ended or was taken over
        (`Connection.expelled`). A
        `one_way` connection accepts no requests from its client (SSE). A connection that `wraps`
        encloses each message in data of its own client, so that no frames are shared.

        :raises Forbidden: the principal has no role in `tenant`.
        :raises QueueFull: the gateway has too many sessions.
        """
        try:
            session = self._parts.sessions.open(principal, self.name, tenant, peer)
        except Forbidden as error:
            self._parts.events.stranger(self.name, peer, error, principal)
            raise
        connection = Connection(
            self._parts.connections, session, encoding, flush, peer, one_way=one_way
        )
        connection.outbox.alone = wraps
        return connection

    def hello(self, connection: Connection, hello: Hello) -> dict[str, Any]:
        """Perform `hello` for a client that cannot; `session` and `resume_from` resume a session.

        :raises Gap: the session no longer exists.
        :raises Unauthenticated: it belongs to another principal.
        """
        return self._parts.handshake.greet(connection, hello)

    def session(
        self, principal: Principal, tenant: str | None = None, peer: Peer = UNKNOWN
    ) -> Session:
        """Return the stateless session of a principal, for single requests.

        :raises Forbidden: the principal does not act in `tenant`.
        """
        try:
            return self._parts.sessions.stateless(principal, self.name, tenant, peer)
        except Forbidden as error:
            self._parts.events.stranger(self.name, peer, error, principal)
            raise

    def submit(self, session: Session, request: Request, answer: Answer) -> None:
        """Handle a request; `answer` receives every reply, exactly one of them final.

        It may be called before `submit` returns.
        """
        self._handle(session, request, answer)

    def read_at_once(self, session: Session, request: Request) -> PromptReply | None:
        """Return the reply to a read of one value in JSON, or None where `submit` has to be used.

        What is returned is counted as the request's final reply.
        """
        return self._read_prompt(session, request)

    async def request(self, session: Session, request: Request) -> Reply:
        """Handle a request and return its final reply."""
        final: asyncio.Future[Reply] = self._parts.loop.create_future()

        def answer(reply: Reply) -> None:
            if reply.final and not final.done():
                final.set_result(reply)

        self.submit(session, request, answer)
        return await final

    def longest(self, principal: Principal) -> int:
        """Return the length of the longest message that a principal may send, in bytes."""
        return self._parts.identities.longest(principal)

    def check_pace(self, session: Session) -> None:
        """Refuse a long request before its body is read, if the rate limit is reached.

        :raises RateLimited: the limit is reached.
        """
        session.check_pace()

    @property
    def outbound(self) -> Outbound:
        """The data queued for all clients, to which a transport adds its own buffers."""
        return self._parts.outbound

    def charge(self, session: Session) -> None:
        """Count a request that is answered without `submit`.

        :raises RateLimited: the limit is exceeded.
        """
        session.charge()

    def is_stop(self, session: Session, request: Request) -> bool:
        """Return whether a request stops something, which no feature may prevent."""
        return self._parts.is_stop(session, request)

    def command(self, session: Session, id_: str) -> Command:
        """Return a command that the session may see.

        :raises UnknownPath: there is none.
        :raises RateLimited: the limit is exceeded.
        """
        session.charge()
        return self._parts.access.find(session, id_)

    def commands(self, session: Session) -> Iterator[Command | None]:
        """Iterate over the commands, newest first; None stands for a hidden one.

        :raises RateLimited: the limit is exceeded.
        """
        session.charge()
        return self._parts.access.visited(session)

    def service(self, key: ServiceKey[T]) -> T | None:
        """Return a feature's service by its key; None if no feature provides it."""
        return self._parts.services.service(key)

    def follow(self, command: Command, answer: Answer) -> Callable[[], None]:
        """Call `answer` with each further reply of a command; return a function that ends this."""
        held = self._parts.replies.follower(answer)

        def on_step(command: Command, step: Record) -> None:
            held(command.reply(step))

        def stop() -> None:
            if on_step in command.followers:
                command.followers.remove(on_step)

        command.followers.append(on_step)

        return stop

    def until_end(self, session: Session, on_end: Callable[[RcpError], None]) -> Callable[[], None]:
        """Call `on_end` when the session's proof becomes invalid; return what ends that.

        For answers that take long without a connection: they end with that error.
        """
        session.endings.add(on_end)
        return lambda: session.endings.discard(on_end)

    def discover(
        self, session: Session, pattern: str, query: Query
    ) -> Generator[None, None, dict[str, Any]]:
        """Answer discovery in steps for the resources that a session may see; `charge` first."""
        found = Pattern(pattern, session.tenant)
        return self._parts.discovery.find(session.rights, found, query)

    def schemas(self, session: Session) -> Generator[None, None, dict[str, dict[str, Any]]]:
        """Find in steps the schemas of all that a session may see, by id.

        :raises RateLimited: the limit is exceeded.
        """
        session.charge()
        return self._parts.discovery.schemas(session.rights)

    def native_types(self, session: Session, path: str) -> Mapping[str, NativeType]:
        """Return the serialised types of a resource by part (`value`, `input`, `output`).

        Empty for a resource that has none, or that the session may not see.
        """
        return self._parts.discovery.native_types(session.rights, path)

    def rights(self, principal: Principal) -> Rights:
        """Return the compiled rights of a principal."""
        return self._parts.rules.rights(principal)

    def rights_of_anyone(self) -> Rights | None:
        """Return the rights of anonymous clients; None if authentication is required."""
        with suppress(Unauthenticated):
            return self.rights(self._parts.identities.anonymous())
        return None

    def hides(self, session: Session, names: Iterable[str]) -> bool:
        """Return whether one of the names (see `names_in`) refers to something hidden from a session."""
        return self._parts.visibility.mentions_hidden(session.rights, session.tenant, names)

    def revoke(self, serials: frozenset[Serial]) -> None:
        """Revoke client certificates; their sessions end."""
        self._parts.identities.revoke(serials)

    def refused(self, type_: str, code: str) -> None:
        """Count a request that the transport had to refuse before it was an envelope."""
        self._parts.counts.count(self.name, type_, code)

    def attempt(self, peer: Peer) -> AbstractContextManager[None]:
        """Let a client try to authenticate in a way of the transport's own.

        It counts as a failed login while it lasts, and for good if it ends with `Unauthenticated`.

        :raises RateLimited: it has failed too often.
        """
        return self._parts.identities.attempt(peer)

    def turned_away(self, peer: Peer, error: RcpError) -> None:
        """Report a client that failed to authenticate in such a way, or has no role."""
        self._parts.events.stranger(self.name, peer, error)

    def ready(self) -> tuple[bool, dict[str, str]]:
        """Return whether every backend is ready, and each one's state."""
        return self._parts.ready()

    def absent_adapters(self) -> dict[str, str]:
        """Return the adapters that are installed and do not run, each with the reason and remedy."""
        return self._parts.absent_adapters()

    def metrics(self, session: Session) -> Generator[None, None, bytes]:
        """Write the Prometheus exposition in steps, without the paths hidden from a session."""
        return self._parts.exposition(session.rights)
