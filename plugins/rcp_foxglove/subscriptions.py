"""Subscriptions of channels: the numbers of a client, and the gateway's subscriptions behind them."""

from __future__ import annotations

from itertools import count

import msgspec

from rcp_foxglove.config import FoxgloveConfig
from rcp_foxglove.offers import Channel
from rcp_foxglove.operations import Wish
from rcp_foxglove.renderings import of_subscription
from rcp_foxglove.statuses import ERROR, WARNING, Statuses, refusal_text
from rcp_foxglove.views import View
from rcp_gateway.api import Connection
from rcp_gateway.client_api import ClientApi
from rcp_kernel.wire import Reply, Request

__all__ = ["Subscriptions"]


class _Subscription:
    def __init__(self, id_: str, channel: Channel) -> None:
        self.id = id_
        """The gateway's id: the client's number may be used again before the gateway has ended it."""
        self.channel = channel


class Subscriptions:
    """The subscriptions of one client."""

    def __init__(
        self,
        client_api: ClientApi,
        connection: Connection,
        statuses: Statuses,
        config: FoxgloveConfig,
    ) -> None:
        self._client_api = client_api
        self._connection = connection
        self._statuses = statuses
        self._config = config
        self._next = count(1)
        self._known: dict[int, _Subscription] = {}
        self._channels: dict[int, int] = {}
        """The subscription of each channel: a client has one at most."""

    @property
    def topics(self) -> set[str]:
        """The topics that the client has subscribed to."""
        return {one.channel.topic for one in self._known.values()}

    def topic_of(self, id_: str) -> str | None:
        """Return the topic of one of the gateway's subscriptions."""
        return next((s.channel.topic for s in self._known.values() if s.id == id_), None)

    def begin(self, wish: Wish, view: View) -> None:
        """Begin a subscription, unless the client errs: then it is told why."""
        channel = view.channels.get(wish.channel_id)
        if channel is None:
            self._statuses.tell(f"Channel {wish.channel_id} does not exist.", WARNING)
        elif wish.id in self._known:
            self._statuses.tell(
                f"The id {wish.id} is already in use for a subscription of "
                f"{self._known[wish.id].channel.topic}.",
                WARNING,
            )
        elif channel.id in self._channels:
            self._statuses.tell(
                f"{channel.topic} is already subscribed to, with the id {self._channels[channel.id]}.",
                WARNING,
            )
        else:
            self._begin(wish.id, channel)

    def _begin(self, number: int, channel: Channel) -> None:
        one = _Subscription(f"m{next(self._next)}", channel)
        self._known[number] = one
        self._channels[channel.id] = number
        rendering = of_subscription(number, channel.tail, self._config.write_interval)
        self._connection.outbox.render(one.id, rendering)
        options = {"encoding": "cbor", "qos": {"depth": self._config.depth}}  # binary messages
        request = Request(
            type="subscribe",
            id=one.id,
            path=channel.path,
            body=msgspec.Raw(msgspec.json.encode(options)),
        )

        def answer(reply: Reply) -> None:
            if reply.error is None:
                return
            self._forget(number, one)
            self._statuses.tell(f"{channel.topic}: {refusal_text(reply)}", ERROR)

        self._client_api.submit(self._connection.session, request, answer)

    def end(self, number: int) -> None:
        """End a subscription."""
        one = self._known.get(number)
        if one is None:
            self._statuses.tell(f"There is no subscription {number}.", WARNING)
            return
        self._forget(number, one)
        request = Request(
            type="unsubscribe",
            body=msgspec.Raw(msgspec.json.encode({"subscription": one.id})),
        )
        self._client_api.submit(self._connection.session, request, _ignore)

    def keep(self, channels: set[int]) -> None:
        """End the subscriptions of all other channels: they do not exist any more."""
        for channel, number in list(self._channels.items()):
            if channel not in channels:
                self.end(number)

    def lost(self, id_: str, reason: str) -> None:
        """Tell that the gateway has ended a subscription by itself."""
        for number, one in list(self._known.items()):
            if one.id == id_:
                self._forget(number, one)
                self._statuses.tell(f"{one.channel.topic}: {reason}", ERROR)

    def _forget(self, number: int, one: _Subscription) -> None:
        self._connection.outbox.render(one.id, None)
        if self._known.get(number) is one:
            del self._known[number]
            self._channels.pop(one.channel.id, None)
            self._statuses.remove(f"paused:{one.channel.topic}")


def _ignore(_reply: Reply) -> None:
    """Ignore a reply: there is nobody to tell it to."""
