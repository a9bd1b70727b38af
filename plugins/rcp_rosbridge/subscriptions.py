"""The subscriptions of one client: one of the gateway's for each topic."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable
from typing import Any

import msgspec

from rcp_kernel.errors import BadRequest, RcpError
from rcp_kernel.wire import Reply, Request
from rcp_rosbridge.context import Context, Packing
from rcp_rosbridge.dialects import Dialect
from rcp_rosbridge.graph import Graph, RosTopic, same_type
from rcp_rosbridge.operations import Compression, Subscribe, Unsubscribe
from rcp_rosbridge.status import sentence

__all__ = ["MARK", "Subscriptions"]

MARK = 0
"""First byte of messages that are packed before they are sent; four bytes with the number follow."""
_AGAIN = 0.25  # s between two looks for topics that do not exist yet
_TELL = 1.0  # s between two looks for what a client missed
_DEEPEST = 1024
_MOST = 1000  # topics of one client, which need not exist
_IDS = 4096  # subscriptions of one client to all its topics
_SLOWEST = 3_600_000.0  # ms
_DIALECTS: dict[Compression, Dialect] = {"cbor": "cbor", "cbor-raw": "cbor-raw"}
_ORDER: tuple[Compression, ...] = ("png", "cbor", "cbor-raw", "none")


class _Subscribed:
    """All subscriptions of the client to one topic."""

    __slots__ = ("ids", "key", "missed", "number", "packing", "requests", "strong", "waits")

    def __init__(self, number: int) -> None:
        self.number = number
        self.requests: dict[str | None, Subscribe] = {}
        self.ids: list[str] = []
        """Of the gateway's subscriptions: the topic's, and that of the resource beside it."""
        self.key: Any = None
        self.packing = Packing()
        self.missed = 0
        self.strong: list[object] = []
        self.waits = False
        """Whether the topic does not exist yet."""


class Subscriptions:
    """Subscribes, and renews subscriptions when topics appear."""

    def __init__(self, context: Context, changed: Callable[[], None]) -> None:
        """Call `changed` when messages begin or cease to be packed."""
        self._context = context
        self._changed = changed
        self._topics: dict[str, _Subscribed] = {}
        self._count = 0
        """Number of subscriptions to all topics."""
        self._numbers = itertools.count(1)
        self._packed: dict[int, _Subscribed] = {}
        self._looking: asyncio.TimerHandle | None = None
        self._telling: asyncio.TimerHandle | None = None

    @property
    def packs(self) -> bool:
        """Whether messages of some topic are packed."""
        return bool(self._packed)

    def subscribe(self, op: Subscribe) -> None:
        """Subscribe, or change a subscription.

        :raises BadRequest: there are too many.
        """
        subscribed = self._topics.get(op.topic)
        if subscribed is None and len(self._topics) >= _MOST:
            raise BadRequest(f"a client subscribes to at most {_MOST} topics")
        id_ = None if op.id_ is None else str(op.id_)
        if subscribed is None or id_ not in subscribed.requests:
            if self._count >= _IDS:
                raise BadRequest(f"a client has at most {_IDS} subscriptions")
            self._count += 1
        if subscribed is None:
            subscribed = self._topics[op.topic] = _Subscribed(next(self._numbers))
        subscribed.requests[id_] = op
        self._update(op.topic)

    def unsubscribe(self, op: Unsubscribe) -> None:
        """End one subscription of the client to a topic, or all."""
        subscribed = self._topics.get(op.topic)
        id_ = None if op.id_ is None else str(op.id_)
        if subscribed is None or (id_ is not None and id_ not in subscribed.requests):
            self._context.status.warning(f"there is no subscription to {op.topic}", id_)
            return
        if id_ is None:
            self._count -= len(subscribed.requests)
            subscribed.requests.clear()
        else:
            self._count -= 1
            del subscribed.requests[id_]
        if subscribed.requests:
            self._update(op.topic)
        else:
            del self._topics[op.topic]
            self._end(subscribed)

    def renew(self) -> None:
        """Subscribe again to all topics, in the session that the client has now."""
        for topic, subscribed in list(self._topics.items()):
            for id_ in subscribed.ids:
                self._context.connection.outbox.render(id_, None)
            subscribed.ids, subscribed.key = [], None
            self._update(topic)

    def close(self) -> None:
        """Stop looking for topics, and for what was missed."""
        for timer in (self._looking, self._telling):
            if timer is not None:
                timer.cancel()
        self._topics.clear()

    def pack(self, message: bytes) -> list[bytes]:
        """Return what is sent for a marked message."""
        subscribed = self._packed.get(int.from_bytes(message[1:5], "big"))
        return [] if subscribed is None else subscribed.packing.pack(message[5:])

    def note_missed(self) -> None:
        """Look soon for what the client missed because it does not read fast enough."""
        if self._telling is None and self._topics:
            self._telling = self._context.client_api.loop.call_later(_TELL, self._tell_missed)

    def _tell_missed(self) -> None:
        self._telling = None
        known = self._context.connection.session.subscriptions
        for topic, subscribed in self._topics.items():
            first = known.get(subscribed.ids[0]) if subscribed.ids else None
            if first is None or first.skipped <= subscribed.missed:
                continue
            count, subscribed.missed = first.skipped - subscribed.missed, first.skipped
            self._context.status.warning(
                f"{count} messages of {topic} were skipped, because this connection does not read "
                "them fast enough. Ask for fewer with `throttle_rate`."
            )

    # -- changes -------------------------------------------------------------------------------

    def _update(self, topic: str) -> None:
        def failed(error: RcpError) -> None:
            self._wait(topic)
            self._context.status.error(f"{topic}: {sentence(error)}", kind=f"graph {error.code}")

        self._context.with_graph(lambda graph: self._apply(topic, graph), failed)

    def _apply(self, name: str, graph: Graph) -> None:
        subscribed = self._topics.get(name)
        if subscribed is None:
            return
        topic = graph.topic(name)
        if topic is None or topic.feed is None:
            if not subscribed.waits:
                self._context.status.tell("info", f"nobody publishes {name} yet", None)
            self._end(subscribed)
            self._wait(name)
            return
        subscribed.waits = False
        self._check_types(topic, subscribed)
        wish = _merged(list(subscribed.requests.values()), self._context.config.queue)
        key = (topic.type, topic.feed, wish)
        if key != subscribed.key:
            self._end(subscribed)
            subscribed.key = key
            self._begin(topic, subscribed, wish)

    def _check_types(self, topic: RosTopic, subscribed: _Subscribed) -> None:
        for id_, op in subscribed.requests.items():
            if op.type and not same_type(op.type, topic.type):
                text = f"{topic.name} has the type {topic.type}, not {op.type}"
                self._context.status.warning(text, id_, f"type {topic.name}")

    def _begin(self, topic: RosTopic, subscribed: _Subscribed, wish: _Wish) -> None:
        feed = topic.feed
        assert feed is not None
        context = self._context
        packing = Packing(wish.fragment, wish.png)
        mark = b""
        if not packing.plain:
            mark = bytes((MARK,)) + subscribed.number.to_bytes(4, "big")
            self._packed[subscribed.number] = subscribed
        subscribed.packing, subscribed.missed = packing, 0
        self._changed()
        rendering = context.renderings.of(topic, feed, wish.dialect, mark)
        subscribed.strong = [rendering]
        if (beside := context.renderings.companion(feed)) is not None and feed.beside:
            subscribed.strong.append(beside)
        id_ = f"topic-{subscribed.number}-{next(self._numbers)}"
        encoding = "json" if wish.dialect == "json" else "cbor"
        subscribed.ids = [id_]
        if beside is not None and feed.beside:
            # Ahead of the other, so that the first message has its value.
            subscribed.ids.append(f"{id_}-beside")
            context.connection.outbox.render(subscribed.ids[1], beside)
            self._request(topic.name, subscribed.ids[1], feed.beside, _Wish(), encoding)
        context.connection.outbox.render(id_, rendering)
        self._request(topic.name, id_, feed.path, wish, encoding)

    def _request(self, topic: str, id_: str, path: str, wish: _Wish, encoding: str) -> None:
        options: dict[str, Any] = {"encoding": encoding, "qos": {"depth": wish.depth}}
        if wish.rate is not None:
            options["rate"] = wish.rate
        body = msgspec.Raw(msgspec.json.encode(options))
        request = Request(type="subscribe", path=path, id=id_, body=body)

        def answer(reply: Reply) -> None:
            if reply.error is not None:
                self._refused(topic, id_, reply)

        self._context.request(request, answer)

    def _refused(self, topic: str, id_: str, reply: Reply) -> None:
        self._context.connection.outbox.render(id_, None)
        subscribed = self._topics.get(topic)
        if subscribed is None or id_ not in subscribed.ids:
            return
        assert reply.error is not None
        text = f"cannot subscribe to {topic}: {reply.error['message']}"
        self._context.status.error(text, next(iter(subscribed.requests), None), f"sub {topic}")
        self._end(subscribed)
        if reply.error.get("retryable"):
            delay = max(_AGAIN, reply.error.get("retry_after") or 1.0)
            self._context.client_api.loop.call_later(delay, self._retry, topic)
        elif reply.error["code"] == "unknown_path":
            self._wait(topic)

    def _end(self, subscribed: _Subscribed) -> None:
        """End the gateway's subscriptions to a topic."""
        for id_ in subscribed.ids:
            body = msgspec.Raw(msgspec.json.encode({"subscription": id_}))
            request = Request(type="unsubscribe", id=f"{id_}-end", body=body)
            self._context.request(request, lambda _: None)
            self._context.connection.outbox.render(id_, None)
        subscribed.ids, subscribed.key = [], None
        if self._packed.pop(subscribed.number, None) is not None:
            self._changed()

    def _retry(self, topic: str) -> None:
        subscribed = self._topics.get(topic)
        if subscribed is not None and not subscribed.ids and not self._context.connection.closed:
            self._update(topic)

    # -- topics that do not exist yet ----------------------------------------------------------

    def _wait(self, topic: str) -> None:
        subscribed = self._topics.get(topic)
        if subscribed is not None:
            subscribed.waits = True
        if self._looking is None:
            generation = self._context.client_api.generation(self._context.connection.session)
            self._look_later(generation)

    def _look_later(self, generation: int) -> None:
        loop = self._context.client_api.loop
        self._looking = loop.call_later(_AGAIN, self._look, generation)

    def _look(self, generation: int) -> None:
        self._looking = None
        waiting = [topic for topic, one in self._topics.items() if one.waits]
        if not waiting or self._context.connection.closed:
            return
        now = self._context.client_api.generation(self._context.connection.session)
        self._look_later(now)
        if now != generation:
            for topic in waiting:
                self._update(topic)


class _Wish(msgspec.Struct, frozen=True):
    """What all subscriptions of a client to a topic want together."""

    dialect: Dialect = "json"
    rate: float | None = None
    depth: int = 1
    fragment: int | None = None
    png: bool = False


def _merged(requests: list[Subscribe], queue: int) -> _Wish:
    """Return the fastest rate, the longest queue and the smallest fragments of several."""
    throttle = min((op.throttle_rate or 0.0) for op in requests)
    lengths = [int(op.queue_length or 0) for op in requests]
    depth = queue if 0 in lengths else min(max(lengths), _DEEPEST)
    sizes = [int(op.fragment_size) for op in requests if op.fragment_size]
    wanted = {op.compression or "none" for op in requests}
    compression: Compression = next(one for one in _ORDER if one in wanted)
    dialect: Dialect = _DIALECTS.get(compression, "json")
    return _Wish(
        dialect,
        rate=min(10_000.0, 1000.0 / min(throttle, _SLOWEST)) if throttle else None,
        depth=depth,
        fragment=min(sizes) if sizes and dialect == "json" else None,
        png=compression == "png",
    )
