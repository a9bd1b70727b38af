"""What has changed since an earlier read: its values, kept under a mark."""

from __future__ import annotations

import secrets
from collections import OrderedDict
from typing import Any, TypeGuard

import msgspec

from rcp_kernel.errors import PreconditionFailed
from rcp_protocol.plain import is_list, is_map

__all__ = ["Changes", "compared", "packed"]

_MARKS = 256
_SIZE = 16_777_216  # bytes of values, in all
_SHARE = 0.02  # of a number: a smaller change is none
_LEAST = 0.01
_TIMES = frozenset(("timestamp", "stamp", "seq"))
Values = dict[str, Any]


class Changes:
    """The values of earlier reads; the oldest are dropped."""

    def __init__(self) -> None:
        self._kept: OrderedDict[tuple[Any, str], bytes] = OrderedDict()
        self._size = 0

    def keep(self, owner: Any, data: bytes) -> str:
        """Remember packed samples for their reader; return the mark."""
        mark = secrets.token_hex(4)
        self._kept[owner, mark] = data
        self._size += len(data)
        while len(self._kept) > 1 and (len(self._kept) > _MARKS or self._size > _SIZE):
            _, dropped = self._kept.popitem(last=False)
            self._size -= len(dropped)
        return mark

    def of(self, owner: Any, mark: str) -> bytes:
        """Return the packed samples of a mark.

        :raises PreconditionFailed: the mark is not known any more.
        """
        data = self._kept.get((owner, mark))
        if data is None:
            raise PreconditionFailed(
                f"the mark '{mark[:32]}' is unknown, or too old",
                remedy="Call `read` without `since`; its result has a new `mark`.",
            )
        return data


def packed(samples: list[dict[str, Any]]) -> bytes:
    """Return the values of samples, to be kept; any thread may call it."""
    return msgspec.msgpack.encode({one["path"]: one.get("value") for one in samples})


def compared(
    before: bytes, now: bytes, samples: list[dict[str, Any]]
) -> tuple[list[dict[str, Any]], list[str]]:
    """Return the samples that differ from packed ones, and the paths that have gone.

    `now` is the same samples, packed. Any thread may call it.
    """
    old: Values = msgspec.msgpack.decode(before)
    new: Values = msgspec.msgpack.decode(now)
    changed = [
        one
        for one in samples
        if one["path"] not in old or _differ(old[one["path"]], new[one["path"]])
    ]
    return changed, [path for path in old if path not in new]


def _differ(old: Any, new: Any) -> bool:
    """Return whether two values differ by more than noise."""
    if is_map(old) and is_map(new):
        keys = (old.keys() | new.keys()) - _TIMES
        return any(_differ(old.get(key), new.get(key)) for key in keys)
    if is_list(old) and is_list(new):
        return len(old) != len(new) or any(map(_differ, old, new))
    if _is_number(old) and _is_number(new):
        return abs(old - new) > max(_LEAST, _SHARE * abs(old))
    return old != new


def _is_number(value: Any) -> TypeGuard[float]:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
