"""The hot path: admit → resolve → check → call. Every request of every client passes here.

A handler returns its reply, or None when the answer comes later; whatever goes wrong in between
becomes the one final reply of that request.
"""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Callable
from contextlib import suppress
from time import perf_counter
from typing import Any

import msgspec

from rcp_kernel.acl import Rules
from rcp_kernel.admission import Admission
from rcp_kernel.audit import Audit
from rcp_kernel.audit_keeping import Keeping
from rcp_kernel.batching import Batching
from rcp_kernel.certificates import Certificates
from rcp_kernel.clock import iso, now
from rcp_kernel.commands import Commands
from rcp_kernel.conditions import Conditions
from rcp_kernel.config import GatewayConfig
from rcp_kernel.discovery import Discovery
from rcp_kernel.envelopes import Envelopes
from rcp_kernel.errors import (
    AdapterUnavailable,
    BadRequest,
    DuplicateRequest,
    Forbidden,
    QueueFull,
    RcpError,
    Unauthenticated,
    UnknownPath,
    UnsupportedOperation,
)
from rcp_kernel.executing import EstopLane, Executing, Service
from rcp_kernel.filters import Options
from rcp_kernel.history import History
from rcp_kernel.hub import Hub
from rcp_kernel.idempotency import Keys
from rcp_kernel.identity import Keyring, Principal, fingerprint
from rcp_kernel.latches import Latches
from rcp_kernel.leases import Leases
from rcp_kernel.meter import free
from rcp_kernel.metrics import Histogram
from rcp_kernel.model import Operation, Pattern, operation_names, parse_path
from rcp_kernel.peer import UNKNOWN, Peer, Serial
from rcp_kernel.pending import Pace, Pending, crash
from rcp_kernel.quotas import Accounts
from rcp_kernel.reading import Reading
from rcp_kernel.recording import ACTS, DENIALS, Recorded, Recording
from rcp_kernel.registry import Entry, Registry
from rcp_kernel.returning import Returning
from rcp_kernel.safety import Deadman
from rcp_kernel.samples import READ_PIECE
from rcp_kernel.sessions import Answer, Handler, Session, Sessions
from rcp_kernel.standing import Standing
from rcp_kernel.store import Store
from rcp_kernel.subscribing import Subscribing
from rcp_kernel.wire import Reply, Request, failure
from rcp_kernel.writing import Writing

__all__ = ["Gateway"]

_READ = int(Operation.READ)
_WHOLE = ("/tenant/", "/system/")
_to_json = msgspec.json.Encoder().encode


class Gateway:
    """The kernel at work: registry, rules, sessions, commands and streams behind one `handle`."""

    def __init__(
        self,
        config: GatewayConfig,
        loop: asyncio.AbstractEventLoop,
        *,
        store: Store | None = None,
        authenticator: Callable[[str], Principal | None] | None = None,
        interceptors: list[Callable[[Handler], Handler]] | None = None,
    ) -> None:
        self.config = config
        self.limits = config.limits
        self.loop = loop
        self.registry = Registry()
        self.hub = Hub(self.registry, loop)
        self.conditions = Conditions(self.hub)
        self.admission = Admission(self)
        self.store = store or Store()
        """What survives the process."""
        self.audit = Audit(self.store, loop, config.audit, lambda: self.rules.roles)
        self.keeping = Keeping(self.audit, self.store, loop, config.audit)
        self.recording = Recording(self)
        history = self.history = History(self.store)
        self.commands = Commands(self.admission.confirm, Recorded(self.recording, history))
        self.rules = Rules(config.roles, self.conditions)
        self.commands.remember(history.load())
        self.accounts, self.sessions = Accounts(self), Sessions(self)
        self.standing = Standing(self.hub)
        self.deadman = Deadman(loop)
        self.deadman.note = self.recording.dead_man
        self.envelopes = Envelopes(self)
        self.discovery = Discovery(self.registry, self.envelopes)
        self.closing = False
        self.counts: dict[tuple[str, str, str], int] = {}
        """Requests by transport, type and code."""
        self.seconds = Histogram()
        self._authenticator = authenticator
        self._keyring = _keyring(config)
        self._certificates = Certificates(config.certificates)
        self.keys = Keys(self.store, loop)
        self.keys.load(self.commands.find)
        self.returning = Returning(self)
        self.views: dict[str, Callable[[Session], Any]] = {}
        """Resources whose value depends on who asks, by path."""
        self.sieves: dict[str, Callable[[Session, Any], bool]] = {}
        """Resources of whose samples everybody sees their own only, by path."""
        self.estop: EstopLane | None = None
        self._pace = Pace(loop)
        self.services: dict[str, Service] = {}
        """What else of the gateway's own branch can be executed, by path."""
        self.latches = Latches(self.store)
        self.leases = Leases(self)
        self.executing = Executing(self)
        self._reading = Reading(self)
        self._subscribing = Subscribing(self)
        self._table: dict[str, Callable[[Session, Request, Answer], Reply | None]] = {
            "read": self._read,
            "write": Writing(self).write,
            "execute": self.executing.execute,
            "subscribe": self._subscribing.subscribe,
            "unsubscribe": self._subscribing.unsubscribe,
            "cancel": self.executing.cancel,
            "discover": self._discover,
            "status": self._status,
            "ping": self._ping,
            "batch": Batching(self).batch,
            "hello": self._hello,
        }
        self.handle: Handler = self._admit
        self.quick = not interceptors
        """Whether nothing wants to see every request."""
        for wrap in reversed(interceptors or []):
            self.handle = wrap(self.handle)

    # -- who -----------------------------------------------------------------------------------

    def anonymous(self) -> Principal:
        """Return the principal of those who prove nothing.

        :raises Unauthenticated: the configuration gives them no role.
        """
        grants = self.config.anonymous.grants
        if not any(roles for _, roles in grants):
            raise Unauthenticated("this gateway serves nobody without a token")
        return Principal("anonymous", grants)

    def renewed(self, principal: Principal) -> Principal | None:
        """Return what a principal's proof is worth under the present configuration."""
        if principal.anonymous:
            with suppress(Unauthenticated):
                return self.anonymous()
            return None
        if principal.proof == "certificate":
            return self._certificates.renewed(principal)
        return self._keyring.renewed(principal) if principal.proof == "key" else principal

    @property
    def authenticates(self) -> bool:
        """Whether a plugin proves identities."""
        return self._authenticator is not None

    def authenticate(self, token: str | None, peer: Peer = UNKNOWN) -> Principal:
        """Return whom a bearer token proves, else the peer's certificate, else who is anonymous.

        A token never falls back on the certificate, and must not contradict it.

        :raises Unauthenticated: the token is not known, or the certificate is somebody else's.
        """
        certified = None
        if peer.certificate is not None:
            certified = self._certificates.find(peer.certificate)
        if token is None:
            return certified or self.anonymous()
        principal = self._by_token(token)
        if certified is not None and certified.name != principal.name:
            raise Unauthenticated(
                f"the token is that of '{principal.name}', the certificate that of "
                f"'{certified.name}'",
                remedy="Send the token of the certificate's owner, or none.",
            )
        return principal

    def revoke(self, serials: frozenset[Serial]) -> None:
        """Have client certificates count for nothing, in open sessions too."""
        if serials != self._certificates.revoked:
            self._certificates.revoked = serials
            self.sessions.review()
        self.leases.review()

    def _by_token(self, token: str) -> Principal:
        if self._authenticator is not None:
            principal = self._authenticator(token)
            if principal is not None:
                return principal
        return self._keyring.find(token)

    def tenants_of(self, principal: Principal) -> list[str]:
        """List the tenants that a principal acts in."""
        known = self.config.tenant_names
        return [t for t in known if "*" in principal.tenants or t in principal.tenants]

    def tenant_for(self, principal: Principal, wanted: str | None) -> str | None:
        """Return the tenant that relative paths mean.

        :raises Forbidden: the principal does not act in the wanted one.
        """
        tenants = self.tenants_of(principal)
        if wanted is None:
            return tenants[0] if tenants else None
        if wanted not in tenants:
            raise Forbidden(f"{principal.name} does not act in the tenant '{wanted[:64]}'")
        return wanted

    def check_sessions(self, count: int) -> None:
        """Refuse one session too many.

        :raises QueueFull: there are as many as allowed.
        """
        if count >= self.limits.sessions:
            raise QueueFull("the gateway holds as many sessions as it can already")

    # -- admit ---------------------------------------------------------------------------------

    def _admit(self, session: Session, request: Request, answer: Answer) -> None:
        started = perf_counter()
        try:
            meter = session.meter
            if meter is not None and not free(request) and not meter.take(started):
                raise meter.refusal(started)
            reply = self._table[request.type](session, request, answer)
        except Exception as error:
            told = crash(error, type=request.type, path=request.path)
            path = told.path or _full(request.path, session.tenant)
            reply = failure(told, request.type, request.id, path)
            reply.custom = request.custom
            if told.code in DENIALS or request.type in ACTS:
                answer = self.recording.refused(session, request, reply, answer)
        if reply is not None:
            self.conclude(session, reply, started)
            answer(reply)

    def conclude(self, session: Session, reply: Reply, started: float) -> None:
        """Count a final reply."""
        self.seconds.observe(perf_counter() - started)
        error = reply.error
        key = (session.transport, reply.type, "ok" if error is None else error["code"])
        try:
            self.counts[key] += 1
        except KeyError:
            self.counts[key] = 1

    def pay(self, session: Session) -> None:
        """Count a request that comes in no envelope.

        :raises RateLimited: a quota does not allow it now.
        """
        meter = session.meter
        if meter is not None and not meter.take(moment := perf_counter()):
            raise meter.refusal(moment)

    def count(self, transport: str, type_: str, code: str) -> None:
        """Count one request by its outcome."""
        key = (transport, type_, code)
        self.counts[key] = self.counts.get(key, 0) + 1

    def later(
        self,
        session: Session,
        request: Request,
        answer: Answer,
        work: Any,
        make: Callable[[Any], Reply],
        timeout: float,
        path: str | None,
        *,
        urgent: bool = False,
    ) -> None:
        """Answer a request when `work` is done, or its deadline passes.

        An urgent one (the e-stop) is past every limit.

        :raises DuplicateRequest: the request's id is in flight in this session.
        :raises QueueFull: too many requests are in flight.
        """
        started = perf_counter()
        try:
            key = f"\0{secrets.token_hex(8)}" if urgent else self.claim(session, request)
        except RcpError:
            work.close()
            raise

        def settle(result: Any, error: RcpError | None) -> None:
            session.inflight.pop(key, None)
            try:
                reply = make(result) if error is None else None
            except Exception as trouble:
                reply, error = None, crash(trouble, path=path)
            if reply is None:
                assert error is not None
                reply = failure(error, request.type, request.id, path)
            reply.custom = request.custom
            self.conclude(session, reply, started)
            answer(reply)

        pace = None if urgent else self._pace
        session.inflight[key] = Pending(self.loop, work, timeout, settle, path, pace)

    def claim(self, session: Session, request: Request) -> str:
        """Reserve a place among the session's unanswered requests.

        :raises DuplicateRequest: the id is in use.
        :raises QueueFull: there is no place left.
        """
        inflight = session.inflight
        if len(inflight) >= self.limits.in_flight:
            raise QueueFull(f"{len(inflight)} requests of this session are unanswered already")
        if request.id is None or session.stateless:
            key = f"\0{secrets.token_hex(8)}"
        else:
            key = request.id
            if key in inflight:
                raise DuplicateRequest(f"a request with the id '{key}' is still in flight")
        inflight[key] = None
        return key

    # -- resolve and check ---------------------------------------------------------------------

    def resolve(
        self, session: Session, path: str | None, operation: Operation, *, anyway: bool = False
    ) -> Entry:
        """Find the entry of a path and make sure that the session may do `operation` with it.

        `anyway`: conditions of the rules need not hold.

        :raises InvalidPath, UnknownPath, Forbidden, UnsupportedOperation: as they say.
        """
        if path is None:
            raise BadRequest("the envelope has no `path`", remedy="Name the path of a resource.")
        # A hidden path must cost what one costs that does not exist: the rights come first.
        full = path if path.startswith(_WHOLE) else parse_path(path, session.tenant)
        rights = session.rights
        known = rights.masks.get(full)
        mask = known or rights.weigh(full)
        entry = self.registry.entries.get(full)
        if entry is None or not mask:
            parse_path(full, None)
            raise UnknownPath(f"there is no resource {full}", path=full)
        if not known:
            rights.remember(full, mask)
        if not entry.operations & operation:
            offered = operation_names(entry.operations)
            wanted = operation_names(operation)[0]
            raise UnsupportedOperation(
                f"{entry.path} does not offer `{wanted}`; it offers {', '.join(offered)}",
                path=entry.path,
                details={"allowed": offered},
            )
        if not mask & operation and not (anyway and rights.depends(entry, operation)):
            self.check(session, entry, operation)
        return entry

    def check(self, session: Session, entry: Entry, operation: Operation) -> None:
        """Refuse an operation that the rules do not allow as things are.

        :raises Forbidden: they do not.
        """
        rights = session.rights
        if rights.permits(entry, operation):
            return
        wanted = operation_names(operation)[0]
        text = f"{session.principal.name} may not {wanted} {entry.path}"
        if not rights.depends(entry, operation):
            raise Forbidden(text, path=entry.path)
        hindrance = rights.hindrance(entry, operation)
        if hindrance is None or not rights.shows(hindrance, entry):
            raise Forbidden(f"{text} at present", path=entry.path, remedy="Try again later.")
        raise Forbidden(
            f"{text} at present: the rule hangs on the condition `{hindrance.text}`",
            path=entry.path,
            remedy="Bring about what the condition asks for, or have the rule changed.",
            details={"condition": hindrance.text},
        )

    def deadline(self, request: Request, entry: Entry) -> float:
        """Return the seconds a read or write may take."""
        own = entry.resource.timeout or self.limits.deadline
        return min(own, request.deadline) if request.deadline is not None else own

    # -- the operations ------------------------------------------------------------------------

    def _read(self, session: Session, request: Request, answer: Answer) -> Reply | None:
        path = request.path
        known = session.rights.masks.get(path, 0) & _READ
        entry = self.registry.entries.get(path) if known else None  # pyright: ignore[reportArgumentType]
        if (
            entry is not None
            and entry.live
            and (sample := entry.latest) is not None
            and not request.body
            and entry.owner.backend is not None
        ):
            return Reply(
                type="read",
                id=request.id,
                path=entry.path,
                body=sample,
                seq=sample.seq,
                source_timestamp=sample.time,
                # Its backend is there, so only its age can make it stale.
                state="stale" if entry.deadline is not None and entry.stale else "fresh",
                timestamp=iso(now()),
                custom=request.custom,
            )
        return self._reading.read(session, request, answer)

    def read_at_once(self, session: Session, request: Request) -> bytes | None:
        """Return the JSON reply to the read that nearly all reads are, or None for any other.

        The same answer as `_read` gives, spliced around what the sample has encoded already.
        """
        started = perf_counter()
        path = request.path
        if not session.rights.masks.get(path, 0) & _READ:
            return None
        entry = self.registry.entries.get(path)  # pyright: ignore[reportArgumentType]
        if (
            entry is None
            or not entry.live
            or (sample := entry.latest) is None
            or request.body
            or request.custom is not None
            or entry.owner.backend is None
        ):
            return None
        try:
            piece = sample.tails.get(READ_PIECE) or sample.read_piece()
        except RcpError:
            return None
        if (meter := session.meter) is not None and not meter.take(started):
            return None
        id_ = b"" if request.id is None else b'"id":%b,' % _to_json(request.id)
        state = b"stale" if entry.deadline is not None and entry.stale else b"fresh"
        reply = b'{"type":"read",%b%b%b","timestamp":"%b"}' % (
            id_,
            piece,
            state,
            iso(now()).encode(),
        )
        self.seconds.observe(perf_counter() - started)
        key = session.read_key
        self.counts[key] = self.counts.get(key, 0) + 1
        return reply

    def _discover(self, session: Session, request: Request, answer: Answer) -> Reply | None:
        body = self.discovery.answer(session.rights, session.tenant, request)
        return Reply(
            type="discover",
            id=request.id,
            path=request.path,
            body=body,
            timestamp=iso(now()),
            custom=request.custom,
        )

    def _status(self, session: Session, request: Request, answer: Answer) -> Reply | None:
        request.path = "/system/status"
        return self._reading.read(session, request, answer)

    def _ping(self, session: Session, request: Request, answer: Answer) -> Reply | None:
        return Reply(type="ping", id=request.id, timestamp=iso(now()), custom=request.custom)

    def _hello(self, session: Session, request: Request, answer: Answer) -> Reply | None:
        raise UnsupportedOperation(
            "there is no session to greet for here",
            remedy="Say `hello` as a message of its own over WebSocket; HTTP needs none.",
        )

    def check_open(self) -> None:
        """Refuse what would change something while the robots are brought to rest.

        :raises AdapterUnavailable: the gateway is closing.
        """
        if self.closing:
            raise AdapterUnavailable("the gateway is closing")

    def reconfigure(self, config: GatewayConfig) -> None:
        """Take over the rules, keys and limits of another configuration; open sessions feel it."""
        self.config = config
        self.limits = config.limits
        self.rules = Rules(config.roles, self.conditions)
        self._keyring = _keyring(config)
        self._certificates = Certificates(config.certificates, self._certificates)
        self.keeping.config = config.audit
        self.envelopes.configure(config.envelopes)
        self.sessions.review()

    def restore(self, session: Session, id_: str, texts: list[str], options: Options) -> None:
        """Start a subscription of an earlier run again."""
        self._subscribing.restore(session, id_, texts, options)

    def drop_forbidden(self, session: Session) -> None:
        """Unlink the feeds that a session's rights do not allow any more."""
        for subscription in session.subscriptions.values():
            self._subscribing.renew(session, subscription)

    # -- end -----------------------------------------------------------------------------------

    async def close(self) -> None:
        """Cancel what runs and stop all streams; the backends are still there."""
        self.closing = True
        self.leases.close()
        self.accounts.close()
        self.deadman.close()
        await self.commands.close()
        await self.hub.close()


def _full(path: str | None, tenant: str | None) -> str | None:
    """Return the full path or pattern that a refusal is about; what is none, as it came."""
    if path is None:
        return None
    try:
        return Pattern(path, tenant).text
    except RcpError:
        return path


def _keyring(config: GatewayConfig) -> Keyring:
    found: dict[str, Principal] = {}
    for key in config.keys:
        digest = key.sha256 or fingerprint(key.key or "")
        found[digest] = Principal(key.name, key.grants, "key", digest)
    return Keyring(found)
