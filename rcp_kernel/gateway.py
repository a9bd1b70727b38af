"""The hot path: admit → resolve → check → call. Every request of every client passes here.

A handler returns its reply, or None when the answer comes later; whatever goes wrong in between
becomes the one final reply of that request.
"""

from __future__ import annotations

import asyncio
import hashlib
import secrets
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from functools import partial
from time import perf_counter
from typing import Any

import msgspec

from rcp_kernel._plain import is_map
from rcp_kernel.acl import Rules
from rcp_kernel.clock import iso, now
from rcp_kernel.commands import Command, Commands, Keeper
from rcp_kernel.config import GatewayConfig, role_names
from rcp_kernel.discovery import Discovery
from rcp_kernel.errors import (
    BadRequest,
    DuplicateRequest,
    Forbidden,
    QueueFull,
    RcpError,
    Unauthenticated,
    UnknownPath,
    UnsupportedOperation,
)
from rcp_kernel.hub import Hub
from rcp_kernel.identity import Keyring, Principal, fingerprint
from rcp_kernel.metrics import Histogram
from rcp_kernel.model import Kind, Operation, operation_names, parse_path
from rcp_kernel.pending import Pending, crash
from rcp_kernel.reading import Reading
from rcp_kernel.registry import Entry, Registry
from rcp_kernel.safety import Deadman, check_age, check_motion, safe_value
from rcp_kernel.sessions import Answer, Handler, Session, Sessions
from rcp_kernel.subscribing import Subscribing
from rcp_kernel.values import Encoding, value_type
from rcp_kernel.wire import NO_BODY, Reply, Request, decode_request, failure

__all__ = ["Gateway"]

_READ = int(Operation.READ)
_SERVICE_TIMEOUT = 10.0  # s for a service that declares none
_KEYS = 20_000  # idempotency keys remembered


class _Cancel(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    command: str | None = None


_CANCEL = value_type(_Cancel | None)
_BATCH = value_type(list[Any])


class Gateway:
    """The kernel at work: registry, rules, sessions, commands and streams behind one `handle`."""

    def __init__(
        self,
        config: GatewayConfig,
        loop: asyncio.AbstractEventLoop,
        *,
        keeper: Keeper | None = None,
        authenticator: Callable[[str], Principal | None] | None = None,
        interceptors: list[Callable[[Handler], Handler]] | None = None,
    ) -> None:
        self.config = config
        self.limits = config.limits
        self.loop = loop
        self.registry = Registry()
        self.hub = Hub(self.registry, loop)
        self.commands = Commands(keeper)
        self.rules = Rules(config.roles)
        self.sessions = Sessions(self)
        self.discovery = Discovery(self.registry)
        self.deadman = Deadman(loop)
        self.closing = False
        self.counts: dict[tuple[str, str, str], int] = {}
        """Requests by transport, type and code."""
        self.seconds = Histogram()
        self._authenticator = authenticator
        self._keyring = _keyring(config)
        self._keys: OrderedDict[tuple[str, str], tuple[bytes, Any]] = OrderedDict()
        self.views: dict[str, Callable[[Session], Any]] = {}
        """Resources whose value depends on who asks, by path."""
        self.estop: Callable[[Session, Any], Awaitable[Any]] | None = None
        """The e-stop's own lane, past every queue and limit."""
        self._reading = Reading(self)
        self._subscribing = Subscribing(self)
        self._table: dict[str, Callable[[Session, Request, Answer], Reply | None]] = {
            "read": self._read,
            "write": self._write,
            "execute": self._execute,
            "subscribe": self._subscribing.subscribe,
            "unsubscribe": self._subscribing.unsubscribe,
            "cancel": self._cancel,
            "discover": self._discover,
            "status": self._status,
            "ping": self._ping,
            "batch": self._batch,
        }
        self.handle: Handler = self._admit
        for wrap in reversed(interceptors or []):
            self.handle = wrap(self.handle)

    # -- who -----------------------------------------------------------------------------------

    def anonymous(self) -> Principal:
        """Return the principal of those who prove nothing.

        :raises Unauthenticated: the configuration gives them no role.
        """
        rule = self.config.anonymous
        if rule.role is None:
            raise Unauthenticated("this gateway serves nobody without a token")
        return Principal("anonymous", rule.tenants, (rule.role,))

    def anonymous_or_none(self) -> Principal | None:
        """Return the anonymous principal, if there is one."""
        return self.anonymous() if self.config.anonymous.role is not None else None

    @property
    def authenticates(self) -> bool:
        """Whether a plugin proves identities."""
        return self._authenticator is not None

    def authenticate(self, token: str | None) -> Principal:
        """Return whom a bearer token proves, or the anonymous principal for none.

        :raises Unauthenticated: the token is not known.
        """
        if token is None:
            return self.anonymous()
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
            raise QueueFull(f"the gateway holds {count} sessions already")

    # -- admit ---------------------------------------------------------------------------------

    def _admit(self, session: Session, request: Request, answer: Answer) -> None:
        started = perf_counter()
        try:
            reply = self._table[request.type](session, request, answer)
        except Exception as error:
            told = crash(error, type=request.type, path=request.path)
            reply = failure(told, request.type, request.id, told.path or request.path)
            reply.custom = request.custom
        if reply is not None:
            self.conclude(session, reply, started)
            answer(reply)

    def conclude(self, session: Session, reply: Reply, started: float) -> None:
        """Count a final reply."""
        self.seconds.observe(perf_counter() - started)
        code = "ok" if reply.error is None else reply.error["code"]
        key = (session.transport, reply.type, code)
        self.counts[key] = self.counts.get(key, 0) + 1

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
    ) -> None:
        """Answer a request when `work` is done, or its deadline passes.

        :raises DuplicateRequest: the request's id is in flight in this session.
        :raises QueueFull: too many requests are in flight.
        """
        started = perf_counter()
        try:
            key = self.claim(session, request)
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

        session.inflight[key] = Pending(self.loop, work, timeout, settle, path)

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

    def resolve(self, session: Session, path: str | None, operation: Operation) -> Entry:
        """Find the entry of a path and make sure that the session may do `operation` with it.

        :raises InvalidPath, UnknownPath, Forbidden, UnsupportedOperation: as they say.
        """
        if path is None:
            raise BadRequest("the envelope has no `path`", remedy="Name the path of a resource.")
        entry = self.registry.entries.get(path)
        if entry is None:
            entry = self.registry.entries.get(parse_path(path, session.tenant))
        mask = 0 if entry is None else session.rights.mask(entry.path)
        if entry is None or not mask:
            full = parse_path(path, session.tenant)
            raise UnknownPath(f"there is no resource {full}", path=full)
        if not entry.operations & operation:
            offered = operation_names(entry.operations)
            wanted = operation_names(operation)[0]
            raise UnsupportedOperation(
                f"{entry.path} does not offer `{wanted}`; it offers {', '.join(offered)}",
                path=entry.path,
                details={"allowed": offered},
            )
        if not mask & operation:
            wanted = operation_names(operation)[0]
            raise Forbidden(
                f"{session.principal.name} may not {wanted} {entry.path}", path=entry.path
            )
        return entry

    def deadline(self, request: Request, entry: Entry) -> float:
        """Return the seconds a read or write may take."""
        own = entry.resource.timeout or self.limits.deadline
        return min(own, request.deadline) if request.deadline is not None else own

    # -- the operations ------------------------------------------------------------------------

    def _read(self, session: Session, request: Request, answer: Answer) -> Reply | None:
        entry = self.registry.entries.get(request.path)  # pyright: ignore[reportArgumentType]
        if (
            entry is not None
            and entry.live
            and (sample := entry.latest) is not None
            and not request.body
            and entry.owner.backend is not None
            and session.rights.mask(entry.path) & _READ
        ):
            return Reply(
                type="read",
                id=request.id,
                path=entry.path,
                body=sample,
                seq=sample.seq,
                source_timestamp=sample.time,
                state="stale" if entry.stale else "fresh",
                timestamp=iso(now()),
                custom=request.custom,
            )
        return self._reading.read(session, request, answer)

    def _write(self, session: Session, request: Request, answer: Answer) -> Reply | None:
        entry = self.resolve(session, request.path, Operation.WRITE)
        value = request.decode_body(entry.value_type, entry.label)
        known = self._known(session, request, entry)
        if known is not None:
            return self._again(known, request)
        check_age(entry, request)
        check_motion(entry, entry.owner.latch)
        window = self.deadman.window(entry, request)
        if entry.owner.backend is None:
            raise entry.owner.unavailable()
        if request.dry_run:
            return self._would(request, entry, {"write": value, "valid_for": window})
        done = partial(self._written, session, request, entry, value)
        work = self._do_write(entry, value, window)
        self.later(session, request, answer, work, done, self.deadline(request, entry), entry.path)
        return None

    async def _do_write(self, entry: Entry, value: Any, window: float | None) -> Any:
        backend = entry.owner.backend
        if backend is None:
            raise entry.owner.unavailable()
        started = perf_counter()
        superseded = self.deadman.begin(entry) if window is not None else False
        try:
            actual = await backend.write(entry.name, value)
        except BaseException:
            if superseded:
                self.deadman.arm(entry, 0)
            raise
        entry.owner.latency = perf_counter() - started
        if window is not None and value != safe_value(entry):
            self.deadman.arm(entry, window)
        return entry.publish(value if actual is None else actual, None)

    def _written(
        self, session: Session, request: Request, entry: Entry, value: Any, sample: Any
    ) -> Reply:
        reply = Reply(
            type="write",
            id=request.id,
            path=entry.path,
            body=sample,
            message=f"{entry.path} written.",
            seq=sample.seq,
            timestamp=iso(now()),
        )
        self._remember(session, request, reply)
        return reply

    def _would(self, request: Request, entry: Entry, what: dict[str, Any]) -> Reply:
        return Reply(
            type=request.type,
            id=request.id,
            path=entry.path,
            body={key: item for key, item in what.items() if item is not None},
            message=f"Dry run: {entry.path} would accept this; nothing was changed.",
            dry_run=True,
            timestamp=iso(now()),
            custom=request.custom,
        )

    def _execute(self, session: Session, request: Request, answer: Answer) -> Reply | None:
        started = perf_counter()
        entry = self.resolve(session, request.path, Operation.EXECUTE)
        value = self._input(request, entry)
        if entry.path == "/system/estop":
            return self._execute_estop(session, request, answer, entry, value)
        known = self._known(session, request, entry)
        if isinstance(known, Command):
            self._follow(session, request, known, answer, started)
            return None
        check_age(entry, request)
        check_motion(entry, entry.owner.latch)
        if entry.owner.backend is None:
            raise entry.owner.unavailable()
        self.commands.admit(entry)
        if request.dry_run:
            return self._would(request, entry, {"execute": value})
        command = Command(
            id="cmd-" + secrets.token_hex(8),
            path=entry.path,
            principal=session.principal.name,
            tenant=entry.tenant,
            request_id=request.id,
            custom=request.custom,
            input=value,
            session=session.id,
            entry=entry,
        )
        self._remember(session, request, command)
        self._follow(session, request, command, answer, started)
        self.commands.start(command, entry, value, self._timeout(request, entry))
        return None

    def _execute_estop(
        self, session: Session, request: Request, answer: Answer, entry: Entry, value: Any
    ) -> Reply | None:
        assert self.estop is not None
        if request.dry_run:
            return self._would(request, entry, {"execute": value})

        def done(state: Any) -> Reply:
            text = "E-stop latched." if state.active else "E-stop released."
            now_ = iso(now())
            return Reply(
                type="execute",
                id=request.id,
                path=entry.path,
                body=state,
                message=text,
                timestamp=now_,
            )

        work = self.estop(session, value or entry.input_type.convert({}))
        self.later(session, request, answer, work, done, entry.resource.timeout or 6.0, entry.path)
        return None

    def _input(self, request: Request, entry: Entry) -> Any:
        if entry.resource.input is None and bytes(request.body) in (b"", b"{}", b"null", b"\x80"):
            return None
        return request.decode_body(entry.input_type, f"input of {entry.label}")

    def _timeout(self, request: Request, entry: Entry) -> float:
        default = _SERVICE_TIMEOUT if entry.kind is Kind.SERVICE else self.limits.action_timeout
        own = entry.resource.timeout or default
        return min(own, request.deadline) if request.deadline is not None else own

    def _follow(
        self, session: Session, request: Request, command: Command, answer: Answer, started: float
    ) -> None:
        """Have the request answered by the command's replies, those of its past included."""
        key = self.claim(session, request)
        if not session.stateless:
            session.commands[command.id] = command
            if len(session.commands) > 256:
                _forget_finished(session.commands)

        def told(reply: Reply) -> None:
            reply.id = request.id
            if reply.final:
                session.inflight.pop(key, None)
                self.conclude(session, reply, started)
            answer(reply)

        if command.history and command.final:
            told(command.reply())
            return
        command.followers.append(told)
        if command.history:
            told(command.reply())

    def _cancel(self, session: Session, request: Request, answer: Answer) -> Reply | None:
        body = request.decode_body(_CANCEL, "cancel")
        wanted = request.command or (body.command if body is not None else None)
        if wanted is not None:
            found = [self.command(session, wanted)]
        else:
            entry = self.resolve(session, request.path, Operation.EXECUTE)
            found = [c for c in self.commands.running.values() if c.path == entry.path]
        entry = self.resolve(session, found[0].path if found else request.path, Operation.EXECUTE)
        live = [command for command in found if not command.final]
        for command in live:
            self.commands.cancel(command, f"{session.principal.name} asked for it")
        text = f"Cancel of {entry.path} sent." if live else f"Nothing is running on {entry.path}."
        return Reply(
            type="cancel",
            id=request.id,
            path=entry.path,
            body={"cancelled": [command.id for command in live]},
            message=text,
            timestamp=iso(now()),
            custom=request.custom,
        )

    def command(self, session: Session, id_: str) -> Command:
        """Return a command that the session may see.

        :raises UnknownPath: there is none, or not for this principal.
        """
        command = self.commands.find(id_)
        if command is None or not session.rights.mask(command.path) & Operation.EXECUTE:
            raise UnknownPath(f"there is no command '{id_[:64]}'", remedy="List `commands`.")
        return command

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

    # -- batch ---------------------------------------------------------------------------------

    def _batch(self, session: Session, request: Request, answer: Answer) -> Reply | None:
        parts = request.decode_body(_BATCH, "batch")
        if len(parts) > self.limits.batch:
            raise BadRequest(f"a batch holds at most {self.limits.batch} envelopes")
        work = self._do_batch(session, parts)
        timeout = request.deadline or self.limits.deadline

        def done(replies: list[Reply]) -> Reply:
            body = [_as_plain(reply) for reply in replies]
            return Reply(type="batch", id=request.id, body=body, timestamp=iso(now()))

        self.later(session, request, answer, work, done, timeout, None)
        return None

    async def _do_batch(self, session: Session, parts: list[Any]) -> list[Reply]:
        return await asyncio.gather(*(self._do_part(session, part) for part in parts))

    async def _do_part(self, session: Session, part: Any) -> Reply:
        final: asyncio.Future[Reply] = self.loop.create_future()

        def answer(reply: Reply) -> None:
            if reply.final and not final.done():
                final.set_result(reply)

        type_ = part.get("type", "error") if is_map(part) else "error"
        id_ = part.get("id") if is_map(part) else None
        try:
            request = plain_request(part)
            if request.type in ("batch", "hello"):
                raise BadRequest(f"`{request.type}` cannot stand in a batch")
        except RcpError as error:
            return failure(error, str(type_), id_ if isinstance(id_, str) else None)
        self.handle(session, request, answer)
        return await final

    # -- idempotency ---------------------------------------------------------------------------

    def _known(self, session: Session, request: Request, entry: Entry) -> Any:
        """Return the first outcome of a key that was seen before.

        :raises DuplicateRequest: the key was used for something else.
        """
        if request.idempotency_key is None:
            return None
        found = self._keys.get((session.principal.name, request.idempotency_key))
        if found is None:
            return None
        if found[0] != _digest(request, entry.path):
            raise DuplicateRequest(
                "the idempotency key was used for another request", path=entry.path
            )
        return found[1]

    def _again(self, known: Reply, request: Request) -> Reply:
        known.id = request.id
        return known

    def _remember(self, session: Session, request: Request, outcome: Any) -> None:
        if request.idempotency_key is None:
            return
        path = outcome.path
        key = (session.principal.name, request.idempotency_key)
        self._keys[key] = (_digest(request, path), outcome)
        while len(self._keys) > _KEYS:
            self._keys.popitem(last=False)

    def reconfigure(self, config: GatewayConfig) -> None:
        """Take over the rules, keys and limits of another configuration; open sessions feel it."""
        self.config = config
        self.limits = config.limits
        self.rules = Rules(config.roles)
        self._keyring = _keyring(config)
        known = {*self._keyring.principals, self.anonymous_or_none()}
        self.sessions.review(known)

    def drop_forbidden(self, session: Session) -> None:
        """Unlink the feeds that a session's rights do not allow any more."""
        for subscription in session.subscriptions.values():
            self._subscribing.renew(session, subscription)

    # -- end -----------------------------------------------------------------------------------

    async def close(self) -> None:
        """Cancel what runs and stop all streams; the backends are still there."""
        self.closing = True
        self.deadman.close()
        await self.commands.close()
        await self.hub.close()


def plain_request(part: Any) -> Request:
    """Read a request envelope that is plain data already: a part of a batch, an adapter's call.

    :raises BadRequest: as `wire.decode_request` does.
    """
    try:
        data = msgspec.msgpack.encode(part)
    except (TypeError, OverflowError, RecursionError) as error:
        raise BadRequest(f"not an envelope: {error}") from None
    return decode_request(data, Encoding.MSGPACK)


def _as_plain(reply: Reply) -> dict[str, Any]:
    out = {
        name: getattr(reply, name)
        for name in reply.__struct_fields__
        if name not in ("custom", "body") and getattr(reply, name) not in (None, False)
    }
    if reply.body is not NO_BODY:
        body = reply.body
        out["body"] = body.value if hasattr(body, "value") else body
    return out | (reply.custom or {})


def _digest(request: Request, path: str) -> bytes:
    text = b"\0".join((request.type.encode(), path.encode(), bytes(request.body)))
    return hashlib.sha256(text).digest()


def _forget_finished(commands: dict[str, Command]) -> None:
    for id_ in [id_ for id_, command in commands.items() if command.final][:128]:
        del commands[id_]


def _keyring(config: GatewayConfig) -> Keyring:
    return Keyring(
        {
            key.sha256 or fingerprint(key.key or ""): Principal(
                key.name, key.tenants, role_names(key.role), "key"
            )
            for key in config.keys
        }
    )
