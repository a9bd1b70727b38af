"""The priority class of each message that a gateway sends."""

from __future__ import annotations

from rcp_gateway.api import Sample
from rcp_kernel.values import Encoding, parse
from rcp_kernel.wire import FINAL, peek_header
from rcp_zenoh.lane import WHOLE, Priority

__all__ = ["Classifier"]


class Classifier:
    """Knows which replies are those to e-stops, and which paths have long values."""

    __slots__ = ("_encoding", "_long", "_noted", "_stops")

    def __init__(self, encoding: Encoding) -> None:
        self._encoding = encoding
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
        _, id_ = peek_header(request, self._encoding)
        if id_ is not None:
            self._stops.add(id_)

    def is_stop(self, reply: bytes) -> bool:
        """Tell whether a message answers an e-stop."""
        if len(reply) > WHOLE:
            return False
        _, id_ = peek_header(reply, self._encoding)
        if id_ not in self._stops:
            return False
        if parse(reply, self._encoding).get("status") in FINAL:
            self._stops.discard(id_)
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
