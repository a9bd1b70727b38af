"""Which paths one write names in its body, and whether their robot can write them as one."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
from msgspec import Raw

from rcp_kernel.errors import BadRequest, NotImplementedByRobot, PayloadTooLarge
from rcp_kernel.tree.entry import Entry
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Request
from rcp_protocol.structure import LONG

__all__ = ["MOST", "check_group", "values_by_path"]

MOST = 64
"""Paths in one write: all are checked, and checked again, in one turn of the event loop."""
_from_json = msgspec.json.Decoder(dict[str, Raw])
_from_msgpack = msgspec.msgpack.Decoder(dict[str, Raw])


def values_by_path(request: Request) -> dict[str, Raw]:
    """Split the body into values that are still encoded.

    :raises BadRequest: it does not map paths to values, or has none.
    :raises PayloadTooLarge: there are too many, or they are too long.
    """
    body = bytes(request.body)
    if len(body) > LONG:
        raise PayloadTooLarge(
            f"a write of several paths has at most {LONG} bytes; this one has {len(body)}",
            remedy="Write long values each on its own, with `path`.",
            details={"limit": LONG},
        )
    decode = _from_json if request.encoding is Encoding.JSON else _from_msgpack
    try:
        parts = decode.decode(body or b"{}")
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        parts = {}
    if not parts or not all(path.startswith("/") for path in parts):
        raise BadRequest(
            "`path` is missing, and the body does not map paths to values",
            remedy="Send `path` with the path of a resource, or a body that maps each path to its "
            "value.",
        )
    if len(parts) > MOST:
        raise PayloadTooLarge(
            f"a write has at most {MOST} paths; this one has {len(parts)}",
            remedy="Write fewer paths as one.",
            details={"limit": MOST},
        )
    return parts


def check_group(entries: Sequence[Entry]) -> None:
    """Check that a backend can write all of them as one.

    :raises NotImplementedByRobot: they are not of one group of one robot.
    """
    if len(entries) == 1:
        return
    groups = {(e.owner.name, e.unit.name, e.resource.atomic) for e in entries}
    if len(groups) == 1 and entries[0].resource.atomic is not None:
        return
    named = {entry.path: entry.resource.atomic for entry in entries}
    alone = next((path for path, group in named.items() if group is None), None)
    why = "they are of different groups or robots" if alone is None else f"{alone} has no group"
    raise NotImplementedByRobot(
        f"these paths cannot be written as one: {why}",
        path=alone or entries[0].path,
        remedy="Write paths with the same `atomic` group of one robot (see `discover`), or send a "
        "write for each path.",
        details={"groups": named},
    )
