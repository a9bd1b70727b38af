"""`subscribe` and `unsubscribe`: from an envelope to feeds linked to the tree, and back."""

from __future__ import annotations

import secrets
import sys
from collections.abc import Callable, Container, Generator, Mapping
from functools import partial
from itertools import chain
from typing import Any
from weakref import WeakValueDictionary

import msgspec

from rcp_conditions.filters import Change, parse_where
from rcp_kernel.access.acl import Rights, reach
from rcp_kernel.clock import iso, now
from rcp_kernel.config.settings import Settings
from rcp_kernel.errors import (
    AdapterUnavailable,
    BadRequest,
    DuplicateRequest,
    FilterUnsupported,
    PayloadTooLarge,
    QueueFull,
    RcpError,
    UnknownPath,
    UnsupportedOperation,
)
from rcp_kernel.features.resource import Filter, View
from rcp_kernel.model import Operation, Pattern
from rcp_kernel.sessions.notices import notice
from rcp_kernel.sessions.outbox import Outbox
from rcp_kernel.sessions.resume import SessionResume
from rcp_kernel.sessions.session import Answer, Session
from rcp_kernel.sessions.sessions import Sessions
from rcp_kernel.tree.entry import Entry
from rcp_kernel.values import Encoding, ValueType, value_type
from rcp_kernel.wire import Reply, Request, error_body
from rcp_requests.admission import Resolver
from rcp_requests.object_list import is_listing, listed
from rcp_requests.pages import MOST, MOST_BYTES, cursor_of
from rcp_scheduling.turns import Work
from rcp_streams.conditional import ConditionalSubscriptions
from rcp_streams.frames import FrameConverter, FrameView
from rcp_streams.hub import Hub
from rcp_streams.links import SubscriptionLinker
from rcp_streams.options import Options, check_fields, seconds
from rcp_streams.path_subscription import PathSubscription
from rcp_streams.shared_update import SharedUpdate
from rcp_streams.subscription import Subscription, subscriptions_of

__all__ = ["SubscribeHandler"]


class _Which(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    subscription: str | None = None


_LONGEST = 131_072  # bytes of a subscription's options
_STEP = 32  # resources that are matched at once
_OPTIONS = value_type(Options | None)
_WHICH = value_type(_Which | None)


class SubscribeHandler:
    """The handlers of both requests."""

    def __init__(
        self,
        resolver: Resolver,
        hub: Hub,
        links: SubscriptionLinker,
        conditional: ConditionalSubscriptions,
        resume: SessionResume,
        sessions: Sessions,
        *,
        views: Mapping[str, View],
        by_rights: Container[str],
        filters: Mapping[str, Filter],
        frames: FrameConverter,
        settings: Settings,
    ) -> None:
        self._resolver = resolver
        self._hub = hub
        self._links = links
        self._registry = hub.registry
        self._conditional = conditional
        self._resume = resume
        self._views = views
        self._by_rights = by_rights
        self._updates: WeakValueDictionary[str, SharedUpdate] = WeakValueDictionary()
        """The updates that subscribers still build, the newest by path."""
        self._filters = filters
        self._frames = frames
        self._settings = settings
        sessions.on_renewal.append(self._renew_all)

    def subscribe(
        self, session: Session, request: Request, answer: Answer
    ) -> Generator[None, None, Reply]:
        """Start a subscription in steps; its id is the request's.

        :raises RcpError: a path, right or option is wrong; nothing is subscribed then.
        """
        connection = session.connection
        if connection is None:
            raise UnsupportedOperation(
                "this transport does not support subscriptions",
                remedy="Subscribe over WebSocket, or GET /rcp/v1/events for SSE.",
            )
        if len(bytes(request.body)) > _LONGEST:
            raise PayloadTooLarge(
                f"the options of a subscription are limited to {_LONGEST} bytes",
                remedy="Use fewer paths, use patterns, or split it into several subscriptions.",
                details={"limit": _LONGEST},
            )
        options: Options = request.decode_body(_OPTIONS, "subscribe") or Options()
        id_ = request.id or "sub-" + secrets.token_hex(4)
        self._check_room(session, id_)
        patterns = self._patterns(session, request, options)
        entries = yield from self._entries(session, patterns, options)
        if session.connection is not connection:  # the client has disconnected or resumed meanwhile
            raise AdapterUnavailable("the connection was lost", remedy="Subscribe again.")
        self._check_room(session, id_)
        subscription = self._begin(session, id_, patterns, options)
        paths = [entry.path for entry in entries]
        cut = len(paths) > MOST
        if cut:  # in the order of discovery, whose cursor then leads to the rest
            paths = sorted(paths)[:MOST]
        reply = Reply(
            type="subscribe",
            id=request.id,
            path=patterns[0].text,
            body={"subscription": id_, "paths": paths, "count": len(entries)},
            truncated=cut,
            cursor=cursor_of(paths[-1]) if cut else None,
            message=f"Subscribed to {len(entries)} paths.",
            timestamp=iso(now()),
            custom=request.custom,
        )
        # Control messages leave before updates, so the client knows the id before it sees one.
        self._links.add(subscription, entries)
        return reply

    def _check_room(self, session: Session, id_: str) -> None:
        if id_ in session.subscriptions or id_ in session.inflight:
            raise DuplicateRequest(f"the id '{id_}' is already in use in this session")
        if len(session.subscriptions) >= self._settings.limits.subscriptions:
            raise QueueFull(
                f"a session holds at most {self._settings.limits.subscriptions} subscriptions"
            )
        if (account := session.account) is not None:
            account.check_subscription()

    def restore(self, session: Session, id_: str, row: dict[str, Any]) -> None:
        """Restore a subscription of an earlier run; resources that appear later join it."""
        patterns = [Pattern(text, session.tenant) for text in row["paths"]]
        options = msgspec.convert(row["options"], Options)
        subscription = self._begin(
            session, id_, patterns, msgspec.structs.replace(options, history=None)
        )
        found = chain.from_iterable(map(self._registry.match, patterns))
        self._links.search(subscription, found)

    def _begin(
        self, session: Session, id_: str, patterns: list[Pattern], options: Options
    ) -> Subscription:
        connection = session.connection
        assert connection is not None

        def may(entry: Entry) -> bool:
            mask = reach(session.rights.mask(entry.path))
            subscribable = bool(entry.operations & mask & Operation.SUBSCRIBE)
            return subscribable and (options.frame is None or self._frames.converts(entry))

        def framed(entry: Entry) -> FrameView | None:
            frame = options.frame
            return None if frame is None else self._frames.view(session, entry, frame)

        def end(subscription: Subscription, reason: str, error: RcpError | None) -> None:
            self._ended(session, subscription, reason, error)

        def view(entry: Entry) -> OwnView | None:
            shown = self._views.get(entry.path)
            if shown is None:
                return None
            shares = entry.path in self._by_rights
            update = partial(self._update, entry.path) if shares else None
            return OwnView(shown, session, self._links, update)

        def visibility_filter(entry: Entry) -> Callable[[Any], Any] | None:
            shown = self._filters.get(entry.path)
            return None if shown is None else partial(shown, session)

        subscription = Subscription(
            self._hub,
            self._links,
            id_,
            patterns,
            options,
            connection.outbox,
            owner=session.principal.identity,
            may=may,
            end=end,
            view=view,
            visibility_filter=visibility_filter,
            framed=framed,
            placed=partial(self._conditional.place, session),
        )
        session.subscriptions[id_] = subscription
        self._resume.subscribed(session, subscription)
        return subscription

    def _update(self, path: str, seq: int) -> SharedUpdate:
        update = self._updates.get(path)
        if update is None or update.seq != seq:
            update = self._updates[path] = SharedUpdate(seq)
        return update

    def _patterns(self, session: Session, request: Request, options: Options) -> list[Pattern]:
        texts = [request.path, *options.paths] if request.path is not None else [*options.paths]
        if not texts:
            raise BadRequest("`path` is missing", remedy="Send `path`, or `paths` in the body.")
        if len(texts) > self._settings.limits.subscriptions:
            raise PayloadTooLarge("too many paths in one subscription")
        return [Pattern(text, session.tenant) for text in texts]

    def _entries(
        self, session: Session, patterns: list[Pattern], options: Options
    ) -> Generator[None, None, list[Entry]]:
        """Return the current matches of the patterns; a plain path must exist and be allowed."""
        if options.where is not None:
            parse_where(options.where)
        if isinstance(options.history, str):
            seconds(options.history)
        if options.deadband is not None:
            Change(options.deadband, options.fields)
        found: dict[str, Entry] = {}
        plain = options.frame is None
        for pattern in patterns:
            if pattern.literal:
                entry = self._resolver.resolve(session, pattern.text, Operation.SUBSCRIBE)
                check_fields(options, entry, self._type(session, entry, options))
                found[entry.path] = entry
                continue
            for number, entry in enumerate(self._registry.match(pattern), 1):
                mask = entry.operations & reach(session.rights.mask(entry.path))
                if mask & Operation.SUBSCRIBE and (plain or self._frames.converts(entry)):
                    found[entry.path] = entry
                if not number % _STEP:
                    yield
        held = sum(len(one.feeds) + len(one.awaited) for one in subscriptions_of(session).values())
        if held + len(found) > self._settings.limits.paths:
            raise PayloadTooLarge(
                f"the patterns match {len(found)} paths and the session already has {held}; its "
                f"subscriptions have at most {self._settings.limits.paths} together",
                remedy="Use narrower patterns, or unsubscribe from what you no longer need.",
                details={"limit": self._settings.limits.paths},
            )
        return list(found.values())

    def _type(self, session: Session, entry: Entry, options: Options) -> ValueType:
        """Return the type of what a subscription sends of a path.

        :raises FilterUnsupported, InvalidValue: not in the frame of the options.
        """
        if options.frame is None:
            return entry.value_type
        view = self._frames.view(session, entry, options.frame)
        if view.remote and options.history:
            raise FilterUnsupported(
                f"this gateway keeps no history of {entry.path} in other frames",
                path=entry.path,
                remedy="Omit `history`, or `frame`.",
            )
        view.check()
        return view.value_type

    def _renew_all(self, session: Session) -> None:
        """Apply the new rights of a session to its subscriptions, in steps.

        No update is sent before all forbidden paths are removed: no sample of them may follow.
        """
        connection = session.connection
        outbox = None if connection is None else connection.outbox
        for subscription in subscriptions_of(session).values():
            if outbox is not None:
                outbox.pause()
            self._links.begin(subscription, self._renew(session, subscription, outbox))

    def _renew(self, session: Session, subscription: Subscription, outbox: Outbox | None) -> Work:
        """Take out what is forbidden now, let the rest be sent, and link what is allowed now."""
        rights = session.rights
        for number, feed in enumerate(tuple(subscription.feeds.values()), 1):
            if session.rights is not rights:  # it has come under others, which hold it too
                break
            if subscription.feeds.get(feed.entry.path) is feed:
                self._renew_feed(session, subscription, feed)
            if not number % _STEP:
                yield
        if outbox is not None:
            outbox.resume()
        if session.rights is rights:
            yield from self._join(subscription)

    def _join(self, subscription: Subscription) -> Work:
        """Add the paths that a subscription may now have."""
        found = chain.from_iterable(map(self._registry.match, subscription.patterns))
        for number, entry in enumerate(found, 1):
            if subscription not in self._hub.subscriptions:  # it has ended
                return
            known = entry.path in subscription.feeds or entry.path in subscription.awaited
            if not known and subscription.may(entry):
                self._hub.join(subscription, entry)
            if not number % _STEP:
                yield

    def _renew_feed(
        self, session: Session, subscription: Subscription, feed: PathSubscription
    ) -> None:
        if subscription.may(feed.entry):
            self._conditional.place(session, feed)
            if feed.remote and feed in feed.entry.framed:
                feed.follow()  # with the current rights
            return
        self._hub.drop(feed)
        notice(
            subscription.outbox,
            "resource_removed",
            id=subscription.id,
            path=feed.entry.path,
            message="the access rules have changed",
        )

    def unsubscribe(
        self, session: Session, request: Request, answer: Answer
    ) -> Generator[None, None, Reply]:
        """End a subscription, named by `body.subscription`, by the request's `id`, or by its path.

        It is done in steps; nothing of it is sent after the reply.

        :raises UnknownPath: this session has no such subscription.
        """
        body = request.decode_body(_WHICH, "unsubscribe")
        found = self._find(session, request, body.subscription if body is not None else None)
        for subscription in found:
            # It may have ended by itself meanwhile.
            if session.subscriptions.get(subscription.id) is subscription:
                del session.subscriptions[subscription.id]
                self._resume.unsubscribed(session, subscription.id)
                yield from self._links.remove(subscription)
        return Reply(
            type="unsubscribe",
            id=request.id,
            path=found[0].patterns[0].text,
            body={"subscriptions": [subscription.id for subscription in found]},
            message="Unsubscribed.",
            timestamp=iso(now()),
            custom=request.custom,
        )

    def _find(self, session: Session, request: Request, named: str | None) -> list[Subscription]:
        known = subscriptions_of(session)
        for id_ in (named, request.id if named is None else None):
            if id_ is not None and id_ in known:
                return [known[id_]]
        if named is None and request.path is not None:
            text = Pattern(request.path, session.tenant).text
            found = [s for s in known.values() if any(p.text == text for p in s.patterns)]
            if found:
                return found
        raise UnknownPath(
            "this session has no such subscription",
            path=request.path,
            remedy='Send {"subscription": "<id of the subscribe>"} in the body.',
            details={"subscriptions": list(known)[:20]},
        )

    def _ended(
        self, session: Session, subscription: Subscription, reason: str, error: RcpError | None
    ) -> None:
        if session.subscriptions.pop(subscription.id, None) is None:
            return
        self._resume.unsubscribed(session, subscription.id)
        facts: dict[str, Any] = {"id": subscription.id, "reason": reason}
        if error is not None:
            self._hub.dropped["overrun"] += 1
            facts |= {"error": error_body(error), "message": error.message}

        def on_end() -> None:
            code = reason if error is not None else "subscription_ended"
            notice(subscription.outbox, code, **facts)

        # Queued updates are sent before the notice of the end.
        self._links.end(subscription, _send_rest if error is None else None, on_end)


class OwnView:
    """What a path shows a session."""

    def __init__(
        self,
        shown: View,
        session: Session,
        links: SubscriptionLinker,
        update: Callable[[int], SharedUpdate] | None,
    ) -> None:
        self._shown = shown
        self._session = session
        self._links = links
        self._update = update

    @property
    def sees(self) -> Rights:
        """Its rights."""
        return self._session.rights

    def shared(self, seq: int) -> SharedUpdate | None:
        """Return what subscribers share of an update, by the number of its sample."""
        return None if self._update is None else self._update(seq)

    def make(self, encoding: Encoding) -> Generator[None, None, Any]:
        """Make the value; of a list as much as fits in one page, in steps."""
        value = self._shown(self._session)
        if is_listing(value):
            return (yield from listed(value, encoding, MOST_BYTES))
        return value

    def begin(self, work: Work) -> None:
        """Do work beside the client's requests."""
        self._links.begin_for(self._session.principal.identity, work)


def _send_rest(feed: PathSubscription) -> None:
    """Send the queued updates of a path as control messages, so that none follows the end."""
    outbox = feed.outbox
    if outbox is None or not feed.waiting:
        return
    out: list[bytes] = []
    # Whole messages, not frames: they are framed with the other control messages.
    framing, outbox.framing = outbox.framing, None
    feed.drain(out, sys.maxsize, None, None)
    outbox.framing = framing
    for data in out:
        outbox.put(data)
