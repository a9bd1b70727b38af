"""Parameters: read, written and followed."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import count
from typing import Any

import msgspec

from rcp_foxglove.offers import ParameterOffer
from rcp_foxglove.operations import Parameter
from rcp_foxglove.renderings import of_parameter
from rcp_foxglove.requests import UNREAD, Requests
from rcp_foxglove.statuses import WARNING, Statuses, refusal_text
from rcp_foxglove.views import View
from rcp_gateway.api import Connection
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Reply, Request, encode_body

__all__ = ["Parameters"]

_PART = 100  # parameters in one message
_BYTES = 262_144  # of their values, beyond which a message has no more


class Parameters:
    """The parameters of one client's view."""

    def __init__(
        self,
        requests: Requests,
        connection: Connection,
        statuses: Statuses,
    ) -> None:
        self._requests = requests
        self._connection = connection
        self._statuses = statuses
        self._next = count(1)
        self._followed: dict[str, tuple[str, str]] = {}
        """The path and the gateway's subscription of each followed parameter."""
        self._all = False
        """Whether parameters that appear are followed too."""

    def get(self, names: list[str], id_: str | None, view: View) -> None:
        """Send the values of parameters."""
        self._requests.begin(self._send(self._wanted(names, view), id_))

    def set(self, wishes: list[Parameter], id_: str | None, view: View) -> None:
        """Write parameters, one after the other; then send what they are now, if asked to."""
        self._requests.begin(self._set(wishes, id_, view))

    def follow(self, names: list[str], view: View) -> None:
        """Send each new value of parameters from now on."""
        self._all |= not names
        for one in self._wanted(names, view):
            if one.name not in self._followed:
                self._follow(one)

    def unfollow(self, names: list[str]) -> None:
        """Send no more values of parameters; without names, of none."""
        self._all &= bool(names)
        for name in names or list(self._followed):
            if (known := self._followed.pop(name, None)) is not None:
                self._end(known[1])

    def renew(self, view: View) -> None:
        """Apply another view of the tree."""
        for name, (path, id_) in list(self._followed.items()):
            offer = view.parameters.get(name)
            if offer is None or offer.path != path:
                del self._followed[name]
                self._end(id_)
        if self._all:
            self.follow([], view)

    def _wanted(self, names: list[str], view: View) -> list[ParameterOffer]:
        if not names:
            return list(view.parameters.values())
        known = (view.parameters.get(name) for name in dict.fromkeys(names))
        return [one for one in known if one is not None]

    async def _send(self, offers: Iterable[ParameterOffer], id_: str | None) -> None:
        found: list[dict[str, Any]] = []
        size, sent = 0, False
        for one in offers:
            reply = await self._requests.request(Request(type="read", path=one.path))
            if reply.error is None:
                found.append(_facts(one, reply))
                size += len(found[-1]["value"])
            if len(found) == _PART or size > _BYTES:
                if not self._values(found, id_, answered=sent):
                    return
                found, size, sent = [], 0, True
        if found or not sent:
            self._values(found, id_, answered=sent)

    def _values(self, found: list[dict[str, Any]], id_: str | None, *, answered: bool) -> bool:
        facts: dict[str, Any] = {"op": "parameterValues", "parameters": found}
        if id_ is not None:
            facts["id"] = id_
        room = self._requests.reply(msgspec.json.encode(facts))
        if not room:
            if id_ is not None and not answered:  # it may wait for the id
                self._requests.reply(msgspec.json.encode(facts | {"parameters": []}))
            self._statuses.tell(f"Values of parameters were dropped because {UNREAD}.")
        return room

    async def _set(self, wishes: list[Parameter], id_: str | None, view: View) -> None:
        known: list[ParameterOffer] = []
        for wish in wishes:
            offer = view.parameters.get(wish.name)
            if offer is None:
                self._statuses.tell(f"There is no parameter {wish.name!r}.", WARNING)
                continue
            known.append(offer)
            if (refusal := await self._write(offer, wish)) is not None:
                self._statuses.tell(f"{wish.name}: {refusal}")
        if id_ is not None:
            await self._send(known, id_)

    async def _write(self, offer: ParameterOffer, wish: Parameter) -> str | None:
        """Write a parameter; return why it was refused."""
        if wish.value is msgspec.UNSET or wish.value is None:
            return "A parameter cannot be removed. Set a value."
        body = msgspec.Raw(msgspec.json.encode(wish.value))
        request = Request(type="write", path=offer.path, body=body)
        reply = await self._requests.request(request)
        return None if reply.error is None else refusal_text(reply)

    def _follow(self, one: ParameterOffer) -> None:
        id_ = f"p{next(self._next)}"
        self._followed[one.name] = (one.path, id_)
        outbox = self._connection.outbox
        outbox.render(id_, of_parameter(one.name, one.mark))
        body = msgspec.Raw(b'{"encoding":"json","on":"change","initial":false}')
        request = Request(type="subscribe", id=id_, path=one.path, body=body)

        def answer(reply: Reply) -> None:
            if reply.error is not None:
                outbox.render(id_, None)
                self._statuses.tell(f"{one.name}: {refusal_text(reply)}", WARNING)

        self._requests.client_api.submit(self._connection.session, request, answer)

    def _end(self, id_: str) -> None:
        self._connection.outbox.render(id_, None)
        body = msgspec.Raw(msgspec.json.encode({"subscription": id_}))
        request = Request(type="unsubscribe", body=body)
        self._requests.client_api.submit(self._connection.session, request, _ignore)


def _facts(one: ParameterOffer, reply: Reply) -> dict[str, Any]:
    value = msgspec.Raw(encode_body(reply.body, Encoding.JSON))
    facts: dict[str, Any] = {"name": one.name, "value": value}
    if one.mark is not None:
        facts["type"] = one.mark
    return facts


def _ignore(_reply: Reply) -> None:
    """Ignore a reply: there is nobody to tell it to."""
