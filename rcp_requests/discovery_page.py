"""A page of discovery, written resource by resource: most of each has been written before."""

from __future__ import annotations

from typing import Any

import msgspec
from msgspec import Raw

from rcp_kernel.values import Encoding, dump
from rcp_kernel.wire import Body

__all__ = ["Description", "DiscoveryPage"]


class Description:
    """The constant part of a resource's description, and its encoding."""

    __slots__ = ("_written", "facts")

    def __init__(self, facts: dict[str, Any]) -> None:
        self.facts = facts
        self._written: dict[Encoding, dict[str, Any]] = {}

    def written(self, encoding: Encoding) -> dict[str, Any]:
        """Return the facts as bytes of JSON or MessagePack."""
        known = self._written.get(encoding)
        if known is None:
            known = {key: Raw(dump(fact, encoding)) for key, fact in self.facts.items()}
            self._written[encoding] = known
        return known


class DiscoveryPage(Body):
    """The body of an answer to `discover`."""

    __slots__ = ("_encoding", "_pieces", "_resources", "_size", "complete", "cursor", "generation")

    def __init__(self, encoding: Encoding) -> None:
        # The CBOR library cannot splice bytes: encode once, at the end.
        self._encoding = encoding
        self._resources: list[dict[str, Any]] = []
        self._pieces: list[bytes] = []
        self._size = 1  # of a bracket
        self.generation = 0
        self.complete = True
        """Whether robots that are still starting cannot add resources."""
        self.cursor: str | None = None

    def __len__(self) -> int:
        return len(self._resources)

    def add(
        self, description: Description, leave: tuple[str, ...], facts: dict[str, Any], longest: int
    ) -> bool:
        """Add a resource, without the facts in `leave`; return whether it fitted."""
        encoding = Encoding.MSGPACK if self._encoding is Encoding.CBOR else self._encoding
        written = {k: v for k, v in description.written(encoding).items() if k not in leave}
        written |= {key: Raw(dump(fact, encoding)) for key, fact in facts.items()}
        module = msgspec.json if encoding is Encoding.JSON else msgspec.msgpack
        piece = module.encode(written)
        if self._pieces and self._size + len(piece) >= longest:
            return False
        self._size += len(piece) + 1  # and a comma
        self._pieces.append(piece)
        kept = {k: v for k, v in description.facts.items() if k not in leave}
        self._resources.append(kept | facts)
        return True

    @property
    def value(self) -> dict[str, Any]:
        """The page as plain data."""
        return {"resources": self._resources, **self._tail()}

    def _tail(self) -> dict[str, Any]:
        cursor = {} if self.cursor is None else {"cursor": self.cursor}
        whole = {} if self.complete else {"complete": False}
        return {**cursor, "generation": self.generation, **whole}

    def encoded(self, encoding: Encoding) -> bytes:
        """Return the page as bytes of the encoding."""
        if encoding is not self._encoding or encoding is Encoding.CBOR:
            return dump(self.value, encoding)
        module = msgspec.json if encoding is Encoding.JSON else msgspec.msgpack
        return module.encode({"resources": list(map(Raw, self._pieces)), **self._tail()})
