"""The priority class of each message that a gateway sends."""

from __future__ import annotations

import msgspec

from rcp_kernel.api import Sample
from rcp_kernel.values import Encoding
from rcp_kernel.wire import peek_header
from rcp_zenoh.lane import WHOLE, Priority

__all__ = ["Classifier"]

_FINAL = frozenset(("completed", "failed", "rejected", "cancelled"))


class _Header(msgspec.Struct):
    id: str | None = None
    status: str = ""


_HEADER = msgspec.msgpack.Decoder(_Header)


class Classifier:
    """Knows which replies are those to e-stops, and which paths have long values."""

    __slots__ = ("_long", "_noted", "_stops")

    def __init__(self) -> None:
        self._stops: set[str] = set()
        """Requests whose replies go first."""
        self._long: set[str] = set()
        """Paths with a value sent in parts: later ones must not overtake it."""
        self._noted: list[Priority] = []

    @property
    def expects(self) -> bool:
        """Whether the reply to an e-stop is missing."""
        return bool(self._stops)

    def expect(self, request: bytes) -> None:
        """Note an e-stop."""
        _, id_ = peek_header(request, Encoding.MSGPACK)
        if id_ is not None:
            self._stops.add(id_)

    def is_stop(self, reply: bytes) -> bool:
        """Tell whether a message answers an e-stop."""
        if len(reply) > WHOLE:
            return False
        header = _HEADER.decode(reply)
        if header.id not in self._stops:
            return False
        if header.status in _FINAL:
            self._stops.discard(header.id)
        return True

    def note(self, data: bytes, sample: Sample | None) -> bytes:
        """Note the class of a message that is collected; `noted` lists them."""
        self._noted.append(self._class_of(data, sample))
        return data

    def noted(self) -> list[Priority]:
        """Return the classes noted since the last time."""
        noted, self._noted = self._noted, []
        return noted

    def _class_of(self, data: bytes, sample: Sample | None) -> Priority:
        if sample is None:
            stop = self._stops and self.is_stop(data)
            return Priority.STOP if stop else Priority.CONTROL
        path = sample.entry.path
        if len(data) > WHOLE:
            self._long.add(path)
        return Priority.BULK if path in self._long else Priority.UPDATES
