"""A page of history as the query's process has encoded it: nothing of it is decoded on the event loop."""

from __future__ import annotations

from typing import Any

from rcp_kernel.values import Encoding, dump, parse
from rcp_kernel.wire import Body

__all__ = ["Page"]


class Page(Body):
    """A page in the encoding of whoever asked; others have it converted."""

    __slots__ = ("_data", "_encoding")

    def __init__(self, data: bytes, encoding: Encoding) -> None:
        self._data = data
        self._encoding = encoding

    @property
    def value(self) -> Any:
        """The page as plain data."""
        return parse(self._data, self._encoding)

    def encoded(self, encoding: Encoding) -> bytes:
        """Return the page as bytes of the encoding."""
        return self._data if encoding is self._encoding else dump(self.value, encoding)
