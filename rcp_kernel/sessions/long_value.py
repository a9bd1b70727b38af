"""A long value that is written several times: in the reply, the record and the history."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import suppress
from typing import Any

from rcp_kernel.errors import InvalidValue
from rcp_kernel.values import Encoding, ValueType, dump, to_plain
from rcp_kernel.wire import Body

__all__ = ["SCALARS", "LongValue", "checked", "plain"]

SCALARS = (float, int, bool, type(None))
"""Types of values that are never long, and plain as they are."""


class LongValue(Body):
    """Written once in each encoding."""

    __slots__ = ("_value", "_written")

    def __init__(self, value: Any, json: bytes | None = None) -> None:
        self._value = value
        self._written: dict[Encoding, bytes] = {} if json is None else {Encoding.JSON: json}

    @property
    def value(self) -> Any:
        """The value itself."""
        return self._value

    @property
    def size(self) -> int:
        """Number of bytes of its encodings."""
        return sum(map(len, self._written.values()))

    def encoded(self, encoding: Encoding) -> bytes:
        """Return the value as bytes of the encoding."""
        data = self._written.get(encoding)
        if data is None:
            data = self._written[encoding] = dump(self._value, encoding)
        return data


def checked(type_: ValueType, value: Any) -> Generator[None, None, LongValue]:
    """Validate a long value and write it, in steps.

    :raises InvalidValue: it does not fit the type.
    """
    value, json = yield from type_.check_in_steps(value)
    yield
    long = LongValue(value, json)
    with suppress(InvalidValue):  # an integer of more than 64 bits, which only JSON can carry
        long.encoded(Encoding.MSGPACK)
    return long


def plain(value: Any) -> Any:
    """Turn a value that may be a long one into plain data."""
    return to_plain(value.value if isinstance(value, Body) else value)
