"""Commands that have ended: so many are remembered, and no more than fit in so many bytes."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rcp_kernel.sessions.long_value import SCALARS, LongValue
from rcp_kernel.values import Encoding, dump
from rcp_kernel.wire import NO_BODY

if TYPE_CHECKING:
    from rcp_kernel.sessions.command import Command

__all__ = ["Finished"]

_KEPT = 1000
_BYTES = 32 * 1024 * 1024  # of inputs, feedback and results
_EMPTY = 1024  # bytes that any command counts for, numbers included


class Finished:
    """The most recent ones, by id; `forget` is called for each that is removed."""

    def __init__(self, forget: Callable[[Command], None]) -> None:
        self._forget = forget
        self._known: OrderedDict[str, Command] = OrderedDict()
        self._sizes: dict[str, int] = {}
        self._bytes = 0

    def get(self, id_: str) -> Command | None:
        """Return a command by the gateway's id."""
        return self._known.get(id_)

    def newest_first(self) -> list[Command]:
        """Return all of them."""
        return list(reversed(self._known.values()))

    def add(self, command: Command) -> None:
        """Remember a command, at the cost of the oldest."""
        size = _EMPTY
        if not isinstance(command.input, SCALARS):
            size += _length(command.input)
        for step in command.history:
            if step.body is not NO_BODY and not isinstance(step.body, SCALARS):
                size += _length(step.body)
        self._known[command.id] = command
        self._sizes[command.id] = size
        self._bytes += size
        while len(self._known) > _KEPT or (self._bytes > _BYTES and len(self._known) > 1):
            id_, oldest = self._known.popitem(last=False)
            self._bytes -= self._sizes.pop(id_)
            self._forget(oldest)


def _length(value: Any) -> int:
    if isinstance(value, LongValue):
        return value.size
    try:
        return len(dump(value, Encoding.MSGPACK))
    except Exception:  # what cannot be encoded is not shown to clients either
        return _EMPTY
