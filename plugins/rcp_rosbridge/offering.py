"""Services and actions that a client offers to others, while it is connected."""

from __future__ import annotations

from typing import Any

import msgspec

from rcp_kernel.errors import AlreadyRunning, BadRequest, NotImplementedByRobot, RcpError
from rcp_kernel.wire import Reply, Request
from rcp_rosbridge.context import Context
from rcp_rosbridge.graph import Graph
from rcp_rosbridge.offered_calls import OfferedCalls
from rcp_rosbridge.operations import (
    AdvertiseAction,
    AdvertiseService,
    UnadvertiseAction,
    UnadvertiseService,
)
from rcp_rosbridge.replies import complaint, plain
from rcp_rosbridge.status import sentence

__all__ = ["Offering"]

_MOST = 256  # services and actions that a client offers
_AGAIN = 0.25  # s between two attempts at a name of a client that may just have gone
_ATTEMPTS = 8
_OPENING = 1.0  # s between two looks for where to offer, while backends open
_Key = tuple[str, str]


class _Offer:
    """A service or action of the client."""

    __slots__ = ("attempts", "command", "key", "type", "waited", "withdrawn")

    def __init__(self, key: _Key, type_: str) -> None:
        self.key = key
        self.type = type_
        self.command: str | None = None
        self.attempts = 0
        self.waited = False
        self.withdrawn = False


class Offering:
    """What one client offers."""

    def __init__(self, context: Context, calls: OfferedCalls) -> None:
        self._context = context
        self._calls = calls
        self._known: dict[_Key, _Offer] = {}

    def advertise_service(self, op: AdvertiseService) -> None:
        """Offer a service."""
        self._offer(("service", op.service), op.type or "", op.id_)

    def advertise_action(self, op: AdvertiseAction) -> None:
        """Offer an action."""
        self._offer(("action", op.action), op.type or "", op.id_)

    def unadvertise_service(self, op: UnadvertiseService) -> None:
        """Offer a service no more."""
        self._withdraw(("service", op.service))

    def unadvertise_action(self, op: UnadvertiseAction) -> None:
        """Offer an action no more."""
        self._withdraw(("action", op.action))

    def _offer(self, key: _Key, type_: str, id_: object) -> None:
        held = self._known.get(key)
        if held is not None and held.type == type_:
            return  # a page says so again when it has rendered again
        if held is not None:
            raise AlreadyRunning(
                f"you offer {key[1]} with the type {held.type} already",
                remedy="Unadvertise it first.",
            )
        if len(self._known) >= _MOST:
            raise BadRequest(f"a client offers at most {_MOST} services and actions")
        offer = self._known[key] = _Offer(key, type_)
        self._begin(offer, None if id_ is None else str(id_))

    def _begin(self, offer: _Offer, id_: str | None) -> None:
        if offer.withdrawn or self._context.connection.closed:
            self._forget(offer)
            return

        def use(graph: Graph) -> None:
            if graph.offering is None and not graph.complete:
                self._wait(offer, id_)
                return
            try:
                self._execute(offer, graph, id_)
            except AlreadyRunning as error:
                self._taken(offer, error, id_)

        self._context.with_graph(use, lambda error: self._failed(offer, sentence(error), id_))

    def _execute(self, offer: _Offer, graph: Graph, id_: str | None) -> None:
        kind, name = offer.key
        if graph.offering is None:
            raise NotImplementedByRobot(
                "clients cannot offer services or actions here",
                remedy="Ask the operator for a backend `clients`, and for the right to execute its "
                "action `offer`.",
            )
        slashed = name if name.startswith("/") else f"/{name}"
        if slashed in (graph.services if kind == "service" else graph.actions):
            raise AlreadyRunning(f"{name} exists already", remedy="Offer it by another name.")
        body = {"name": name, "kind": kind, "type": offer.type}
        request = Request(
            type="execute",
            path=graph.offering,
            body=msgspec.Raw(msgspec.json.encode(body)),
        )
        place = graph.offering.replace("/action/", "/service/", 1).rpartition("/")[0]

        def answer(reply: Reply) -> None:
            if reply.final:
                self._ended(offer, reply, id_)
                return
            offer.command = reply.command
            if offer.withdrawn:
                self._cancel(offer)
            elif reply.status == "in_progress" and (waiting := plain(reply)) is not None:
                self._calls.renew(offer.key, offer.type, place, waiting)

        self._context.request(request, answer)

    def _ended(self, offer: _Offer, reply: Reply, id_: str | None) -> None:
        error = reply.error
        if offer.withdrawn or error is None:
            self._forget(offer)
        elif error["code"] == AlreadyRunning.code:
            self._taken(offer, complaint(reply), id_)
        else:
            self._failed(offer, complaint(reply), id_)

    def _wait(self, offer: _Offer, id_: str | None) -> None:
        """Try again when more backends are open: the page came back before the gateway had all of them."""
        if not offer.waited:
            offer.waited = True
            text = f"{offer.key[1]}: nothing here takes offers yet, but not all backends are open: it is offered as soon as one takes it"
            self._context.status.warning(text, id_, f"offer {offer.key[1]}")
        self._context.client_api.loop.call_later(_OPENING, self._begin, offer, id_)

    def _taken(self, offer: _Offer, error: RcpError | str, id_: str | None) -> None:
        """Try again soon: the page that had the name may have been loaded again."""
        offer.attempts += 1
        if offer.attempts < _ATTEMPTS:
            self._context.client_api.loop.call_later(_AGAIN, self._begin, offer, id_)
        else:
            text = error if isinstance(error, str) else sentence(error)
            self._failed(offer, text, id_)

    def _failed(self, offer: _Offer, text: str, id_: str | None) -> None:
        self._forget(offer)
        self._context.status.error(f"{offer.key[1]}: {text}", id_, f"offer {offer.key[1]}")

    def _forget(self, offer: _Offer) -> None:
        if self._known.get(offer.key) is offer:
            del self._known[offer.key]

    def _withdraw(self, key: _Key) -> None:
        offer = self._known.pop(key, None)
        if offer is None:
            self._context.status.warning(f"{key[1]} was not advertised")
            return
        offer.withdrawn = True
        self._cancel(offer)

    def _cancel(self, offer: _Offer) -> None:
        if offer.command is not None:
            request = Request(type="cancel", command=offer.command)
            self._context.request(request, _ignore)


def _ignore(_reply: Any) -> None:
    """Ignore a reply: what follows from it is told by another one."""
