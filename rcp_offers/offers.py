"""All that clients offer in one place."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager

from rcp_offers.call import Call
from rcp_offers.messages import Answer, Offer, Take, Taken, Waiting
from rcp_offers.offered import Offered, Owner
from rcp_protocol.errors import AlreadyRunning, QueueFull, UnknownPath

__all__ = ["Offers"]


class Offers:
    """What clients offer, by kind and name."""

    def __init__(self, *, most: int, most_of_one: int, waiting: int) -> None:
        """Keep `most` offers, `most_of_one` of one principal, with `waiting` calls each."""
        self._most = most
        self._most_of_one = most_of_one
        self._waiting = waiting
        self._known: dict[tuple[str, str], Offered] = {}

    @contextmanager
    def offering(
        self, offer: Offer, owner: Owner, tell: Callable[[Waiting], None]
    ) -> Generator[Offered]:
        """Offer something while entered.

        :raises AlreadyRunning: a client offers that name.
        :raises QueueFull: there are too many offers.
        """
        key = (offer.kind, offer.name.strip("/"))
        if key in self._known:
            raise AlreadyRunning(
                f"{offer.name} is offered by another client",
                remedy="Choose another name, or wait until it is withdrawn.",
            )
        own = sum(one.owner == owner for one in self._known.values())
        if len(self._known) >= self._most or own >= self._most_of_one:
            raise QueueFull(
                f"clients offer {len(self._known)} services and actions, of which {own} are yours; "
                f"at most {self._most}, and {self._most_of_one} of one client, are possible",
                remedy="Withdraw others first.",
            )
        made = self._known[key] = Offered(offer, owner, tell, self._waiting)
        try:
            yield made
        finally:
            del self._known[key]
            made.close()

    def find(self, kind: str, name: str) -> Offered | None:
        """Return what is offered under a name."""
        return self._known.get((kind, name))

    def take(self, take: Take, owner: Owner) -> Taken:
        """Begin with a call, for the principal that offers it.

        :raises UnknownPath: there is no such call, or it has begun.
        """
        offered, call = self._call(take.call, owner)
        if call.taken:
            raise UnknownPath(f"the call {take.call} was taken before")
        offered.take(call)
        return Taken(call=call.id, name=offered.offer.name, input=call.input)

    def respond(self, answer: Answer, owner: Owner) -> None:
        """Pass on what the principal that offers it says of a call.

        :raises UnknownPath: there is no such call: it may have been cancelled, or timed out.
        """
        offered, call = self._call(answer.call, owner)
        offered.settle(call, answer)

    def _call(self, id_: str, owner: Owner) -> tuple[Offered, Call]:
        for offered in self._known.values():
            call = offered.calls.get(id_)
            if call is not None and offered.owner == owner:
                return offered, call
        raise UnknownPath(
            f"the call {id_} has ended: who called may have cancelled it, or not have waited",
            remedy="Forget it.",
        )
