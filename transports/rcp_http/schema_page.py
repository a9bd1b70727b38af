"""The schemas that a caller may see, encoded one by one."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import msgspec
from msgspec import Raw

from rcp_gateway.api.pages import EncodedBody
from rcp_kernel.values import Encoding, dump

__all__ = ["written"]


def written(
    search: Generator[None, None, dict[str, dict[str, Any]]], encoding: Encoding
) -> Generator[None, None, Any]:
    """Encode the schemas found, in steps."""
    found = yield from search
    if encoding is Encoding.CBOR:  # whose library cannot embed encoded bytes
        return found
    pieces: dict[str, Raw] = {}
    for id_, schema in found.items():
        pieces[id_] = Raw(dump(schema, encoding))
        yield
    module = msgspec.json if encoding is Encoding.JSON else msgspec.msgpack
    return EncodedBody(found, encoding, module.encode(pieces))
