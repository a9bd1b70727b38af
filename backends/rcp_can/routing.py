"""Which part of the gateway takes which frames of a bus."""

from __future__ import annotations

from collections.abc import Generator, Hashable, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    import can

__all__ = ["Listener", "Route", "RoutingTable"]

_ROUTES = 4096  # identifiers whose listeners are cached


class Route(NamedTuple):
    """A set of identifiers: those with `id & mask == value`."""

    value: int
    mask: int = 0x7FF
    extended: bool = False

    def holds(self, identifier: int, *, extended: bool) -> bool:
        """Return whether an identifier is one of them."""
        return self.extended == extended and identifier & self.mask == self.value


class Listener(Protocol):
    """A receiver of frames."""

    def __call__(self, message: can.Message) -> None:
        """Handle one frame, on the event loop."""
        ...


class _Entry(NamedTuple):
    route: Route
    listener: Listener
    whose: str


class RoutingTable:
    """Listeners by identifier."""

    def __init__(self) -> None:
        self._entries: list[_Entry] = []
        self._known: dict[int, tuple[Listener, ...]] = {}

    def listen(self, listener: Listener, *routes: Route, whose: str = "") -> None:
        """Call `listener` with every frame that matches one of the routes; `whose` is told to people."""
        self._entries += [_Entry(route, listener, whose) for route in routes]
        self._known.clear()

    @contextmanager
    def overheard(self, listener: Listener, routes: Sequence[Route]) -> Generator[None]:
        """Call `listener` too with the frames of some routes, while entered."""
        more = [_Entry(route, listener, "") for route in routes]
        self._entries += more
        self._known.clear()
        try:
            yield
        finally:
            for each in more:
                self._entries.remove(each)
            self._known.clear()

    def listeners(self, message: can.Message) -> tuple[Listener, ...]:
        """Return who takes a frame."""
        identifier, extended = message.arbitration_id, message.is_extended_id
        key = identifier | (extended << 31)
        listeners = self._known.get(key)
        if listeners is None:
            listeners = self._find(identifier, extended=extended)
            if len(self._known) >= _ROUTES:
                self._known.clear()
            self._known[key] = listeners
        return listeners

    def _find(self, identifier: int, *, extended: bool) -> tuple[Listener, ...]:
        found: dict[Hashable, Listener] = {
            id(each.listener): each.listener
            for each in self._entries
            if each.route.holds(identifier, extended=extended)
        }
        return tuple(found.values())

    def takes(self, identifier: int, *, extended: bool) -> bool:
        """Return whether anything listens to an identifier."""
        return any(each.route.holds(identifier, extended=extended) for each in self._entries)

    def takers(self, identifier: int, *, extended: bool) -> list[str]:
        """Return the names of the motors, devices and nodes that take an identifier."""
        found = {
            each.whose
            for each in self._entries
            if each.whose and each.route.holds(identifier, extended=extended)
        }
        return sorted(found)
