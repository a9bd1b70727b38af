"""The hot path: admit → resolve → check → call. Every request of every client passes here.

A handler returns its reply, or None when the answer comes later; whatever goes wrong in between
becomes the one final reply of that request.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator
from time import perf_counter
from typing import Any

import msgspec

from rcp_kernel.access.acl import Rules
from rcp_kernel.access.approvals import Approvals
from rcp_kernel.access.conditions import Conditions
from rcp_kernel.access.identities import Identities
from rcp_kernel.access.identity import Principal
from rcp_kernel.access.quotas import QuotaTracker
from rcp_kernel.access.resolver import Resolver
from rcp_kernel.access.token_bucket import is_exempt
from rcp_kernel.access.visibility import Visibility
from rcp_kernel.clients.outbound import Outbound
from rcp_kernel.clients.resume import SessionResume
from rcp_kernel.clients.session import Answer, Handler, Session
from rcp_kernel.clients.sessions import Sessions
from rcp_kernel.clock import iso, now
from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.errors import (
    AdapterUnavailable,
    QueueFull,
    RcpError,
    UnsupportedOperation,
)
from rcp_kernel.model import Operation, Pattern
from rcp_kernel.motion.latches import Latches
from rcp_kernel.motion.leases import Leases
from rcp_kernel.motion.motion_limits import MotionLimits
from rcp_kernel.motion.safety import Deadman
from rcp_kernel.operations.admission import Admission
from rcp_kernel.operations.batch import BatchHandler
from rcp_kernel.operations.catalogue import CataloguePage
from rcp_kernel.operations.commands import Commands
from rcp_kernel.operations.discovery import Discovery
from rcp_kernel.operations.execute import EstopLane, ExecuteHandler, Service
from rcp_kernel.operations.idempotency import Keys
from rcp_kernel.operations.inflight import InFlight
from rcp_kernel.operations.interceptors import intercepted
from rcp_kernel.operations.pages import room
from rcp_kernel.operations.parts import expected
from rcp_kernel.operations.pending import to_internal_error
from rcp_kernel.operations.read import ReadHandler
from rcp_kernel.operations.subscribe import SubscribeHandler
from rcp_kernel.operations.write import WriteHandler
from rcp_kernel.plans.resource import PATH as PLANS
from rcp_kernel.plans.resource import Plans
from rcp_kernel.process.metrics import Histogram
from rcp_kernel.record.audit import Audit
from rcp_kernel.record.audit_writer import ACTS, DENIALS, AuditWriter, Recorded
from rcp_kernel.record.disclosure import Disclosure
from rcp_kernel.record.history import History
from rcp_kernel.record.retention import Retention
from rcp_kernel.record.store import Store
from rcp_kernel.registry import Entry, Registry
from rcp_kernel.safety.partners import Partners
from rcp_kernel.safety.stop import StopController
from rcp_kernel.streaming.conditional import ConditionalSubscriptions
from rcp_kernel.streaming.filters import Options
from rcp_kernel.streaming.hub import Hub
from rcp_kernel.streaming.samples import READ_PIECE
from rcp_kernel.turns import Turns
from rcp_kernel.wire import Reply, Request, failure

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
        self.config, self.limits, self.loop = config, config.limits, loop
        self.registry, self.turns = Registry(), Turns(loop)
        self.hub = Hub(self.registry, loop, config.limits.pattern_value)
        self.conditions, self.visibility = Conditions(self.hub), Visibility(self.registry)
        self.admission = Admission(self)
        self.store = store or Store()
        """What survives the process."""
        self.audit = Audit(self.store, loop, config.audit)
        self.disclosure = Disclosure(self.visibility, lambda: self.rules.roles)
        self.retention = Retention(self.audit, self.store, loop, config.audit)
        self.audit_writer = AuditWriter(self)
        history = self.history = History(self.store)
        self.commands = Commands(self.admission.confirm, Recorded(self.audit_writer, history))
        self.rules = Rules(config.roles, self.conditions)
        self.commands.remember(history.load())
        self.outbound = Outbound(loop, config.limits)
        self.quota_tracker, self.sessions = QuotaTracker(self), Sessions(self)
        self.conditional_subscriptions = ConditionalSubscriptions(self.hub)
        self.deadman, self.partners = Deadman(loop), Partners(self.registry)
        self.deadman.note = self.audit_writer.dead_man
        self.deadman.untaken = self.partners.halt
        self.envelopes = MotionLimits(self)
        self.discovery = Discovery(self.registry, self.envelopes)
        self.closing = False
        self.counts: dict[tuple[str, str, str], int] = {}
        """Requests by transport, type and code."""
        self.seconds, self.identities = Histogram(), Identities(self, authenticator)
        resolver, inflight = Resolver(self.registry), InFlight(self)
        self.resolve, self.check = resolver.resolve, resolver.check
        self.later, self.claim, self.place = inflight.later, inflight.claim, inflight.place
        self.keys = Keys(self.store, loop)
        self.keys.load(self.commands.find)
        self.session_resume = SessionResume(self)
        self.views: dict[str, Callable[[Session], Any]] = {}
        """Resources whose value depends on who asks, by path."""
        self.visibility_filters: dict[str, Callable[[Session, Any], Any]] = {}
        """Resources of whose samples everybody sees their own only, and what they see of them: by
        path, what returns None for a sample that is hidden."""
        self.estop: EstopLane | None = None
        self.services: dict[str, Service] = {}
        """What else of the gateway's own branch can be executed, by path."""
        self.latches, self.leases = Latches(self.store), Leases(self)
        self.stops = StopController(loop, self.audit_writer.stop_step)
        self.approvals, self.plans = Approvals(self), Plans(self)
        self.executing, self._subscribing = ExecuteHandler(self), SubscribeHandler(self)
        self._reading, self._writing = ReadHandler(self), WriteHandler(self)
        self._table: dict[str, Callable[[Session, Request, Answer], Reply | None]] = {
            "read": self._read,
            "write": self._writing.write,
            "execute": self.executing.execute,
            "unsubscribe": self._subscribing.unsubscribe,
            "cancel": self.executing.cancel,
            "status": self._status,
            "ping": self._ping,
            "batch": BatchHandler(self, self.turns).batch,
            "hello": self._hello,
        }
        self.handle: Handler = intercepted(interceptors, self._admit)
        self.quick = not interceptors
        """Whether nothing wants to see every request."""

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
            meter = session.token_bucket
            if (
                meter is not None
                and not is_exempt(request)
                and not meter.take(started)
                # Its parts pay for themselves, and one may be a stop.
                and request.type != "batch"
                and not self._stops(session, request)
            ):
                raise meter.refusal(started)
            if _dear(request):
                work = self._slowly(session, request, answer, started)
                self.turns.run(session.principal.identity, work, len(bytes(request.body)))
                return
            reply = self._table[request.type](session, request, answer)
        except Exception as error:
            reply, answer = self._refuse(session, request, answer, error)
        if reply is not None:
            self.conclude(session, reply, started)
            answer(reply)

    def _slowly(
        self, session: Session, request: Request, answer: Answer, started: float
    ) -> Generator[None]:
        """Handle a request that takes long, when its turn has come."""
        try:
            if request.type == "execute":
                yield from self.plans.read_conditions(session, request)
            if request.type == "discover":
                reply = yield from self._discover(session, request)
            elif request.type == "subscribe":
                reply = yield from self._subscribing.subscribe(session, request)
            else:
                reply = self._table[request.type](session, request, answer)
        except Exception as error:
            reply, answer = self._refuse(session, request, answer, error)
        if reply is not None:
            self.conclude(session, reply, started)
            answer(reply)

    def _stops(self, session: Session, request: Request) -> bool:
        """Tell whether a request brings something to rest, which no rate may keep it from."""
        return self._writing.stops(session, request) or self.executing.stops(session, request)

    def _refuse(
        self, session: Session, request: Request, answer: Answer, error: Exception
    ) -> tuple[Reply, Answer]:
        """Make a refusal's reply, in a frame that the error's traceback does not lead to.

        One that kept the error would be a cycle: for a flood of refusals, garbage without end.
        """
        told = to_internal_error(error, type=request.type, path=request.path)
        path = told.path or _full(request.path, session.tenant)
        reply = failure(told, request.type, request.id, path)
        reply.custom = request.custom
        if told.code in DENIALS or request.type in ACTS:
            answer = self.audit_writer.refused(session, request, reply, answer)
        return reply, answer

    def conclude(self, session: Session, reply: Reply, started: float) -> None:
        """Count a final reply."""
        self.seconds.observe(perf_counter() - started)
        error = reply.error
        key = (session.transport, reply.type, "ok" if error is None else error["code"])
        try:
            self.counts[key] += 1
        except KeyError:
            self.counts[key] = 1

    def charge(self, session: Session) -> None:
        """Count a request that comes in no envelope.

        :raises RateLimited: a quota does not allow it now.
        """
        meter = session.token_bucket
        if meter is not None and not meter.take(moment := perf_counter()):
            raise meter.refusal(moment)

    def check_pace(self, session: Session) -> None:
        """Refuse a request that is too long to be one that stops something, before it is read.

        It counts for nothing yet: that comes when it is handled.

        :raises RateLimited: a quota does not allow one now.
        """
        meter = session.token_bucket
        if meter is not None and not meter.allows(moment := perf_counter()):
            raise meter.refusal(moment)

    def count(self, transport: str, type_: str, code: str) -> None:
        """Count one request by its outcome."""
        key = (transport, type_, code)
        self.counts[key] = self.counts.get(key, 0) + 1

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
        if (meter := session.token_bucket) is not None and not meter.take(started):
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

    def _discover(self, session: Session, request: Request) -> Generator[None, None, Reply]:
        page, longest = CataloguePage(expected(session, request)), room(self.limits.message)
        yield from self.discovery.answer(session.rights, session.tenant, request, page, longest)
        return Reply(
            type="discover",
            id=request.id,
            path=request.path,
            body=page,
            truncated=page.cursor is not None,
            cursor=page.cursor,
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

    @property
    def moving(self) -> bool:
        """Whether a robot is driven, or carries something out."""
        return self.deadman.driving or bool(self.commands.running)

    def reconfigure(self, config: GatewayConfig) -> None:
        """Take over the rules, keys and limits of another configuration; open sessions feel it."""
        self.config = config
        self.limits = config.limits
        self.outbound.configure(config.limits)
        self.hub.pattern_value = config.limits.pattern_value
        self.rules = Rules(config.roles, self.conditions)
        self.identities.reconfigure(config)
        self.retention.config = config.audit
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
        self.stops.close()
        self.quota_tracker.close()
        self.sessions.relief.close()
        self.outbound.close()
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


def _dear(request: Request) -> bool:
    """Tell whether a request takes longer than a fraction of a millisecond, of all that it is."""
    path = request.path
    match request.type:
        case "discover" | "batch" | "subscribe" | "unsubscribe":
            return True
        case "read":
            return path is not None and ("*" in path or path.startswith("/system/"))
        case "execute":
            return path == PLANS
        case _:
            return False
