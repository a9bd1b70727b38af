"""Fragments: parts of the text of a long message, in both directions."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable

import msgspec

from rcp_kernel.errors import BadRequest, PayloadTooLarge, QueueFull, SegmentMissing
from rcp_rosbridge.operations import Fragment

__all__ = ["Assembly", "split"]

_TRANSFERS = 16  # incomplete messages of one client
_PARTS = 65_536  # fragments of one message, and of all that are incomplete
_LEAST = 64  # bytes of a fragment: a client that asks for less would get more heads than text
_numbers = itertools.count(1)


def split(message: bytes, size: int) -> list[bytes]:
    """Return a text message as it is, or as fragments with at most `size` characters of it each."""
    size = max(size, _LEAST)
    if len(message) <= size:
        return [message]
    text = message.decode()
    parts = [text[at : at + size] for at in range(0, len(text), size)]
    id_ = f"fragment:{next(_numbers)}"
    return [
        msgspec.json.encode(
            {"op": "fragment", "id": id_, "data": part, "num": num, "total": len(parts)}
        )
        for num, part in enumerate(parts)
    ]


class _Transfer:
    __slots__ = ("parts", "size", "timer", "total")

    def __init__(self, total: int) -> None:
        self.total = total
        self.parts: dict[int, str] = {}
        self.size = 0
        self.timer: asyncio.TimerHandle | None = None


class Assembly:
    """The incomplete messages of one client. Fragments may come in any order."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        timeout: float,
        lost: Callable[[str, SegmentMissing], None],
    ) -> None:
        """Call `lost` with the id of a message whose fragments stay away for `timeout` s."""
        self._loop = loop
        self._timeout = timeout
        self._lost = lost
        self._transfers: dict[str, _Transfer] = {}

    @property
    def held(self) -> int:
        """Characters of all incomplete messages."""
        return sum(transfer.size for transfer in self._transfers.values())

    def take(self, fragment: Fragment, limit: int) -> str | None:
        """Return the whole message with its last fragment, None before.

        :raises BadRequest: it does not fit the others, or makes no sense.
        :raises PayloadTooLarge: the message has more than `limit` characters, or too many fragments.
        :raises QueueFull: there are too many incomplete messages, or fragments of them.
        """
        id_ = None if fragment.id_ is None else str(fragment.id_)
        num, total = int(fragment.num), int(fragment.total)
        if id_ is None or num != fragment.num or total != fragment.total:
            raise BadRequest("a fragment needs an id, and whole numbers as num and total")
        if total > _PARTS:
            raise PayloadTooLarge(f"a message has at most {_PARTS} fragments, not {total}")
        if not 0 <= num < total:
            raise BadRequest(f"fragment {num} of a message with {total} fragments")
        transfer = self._transfers.get(id_)
        if transfer is None:
            if len(self._transfers) >= _TRANSFERS:
                raise QueueFull(f"{_TRANSFERS} messages are already incomplete")
            transfer = self._transfers[id_] = _Transfer(total)
        if transfer.total != total:
            self._drop(id_)
            raise BadRequest(f"'{id_}' had {transfer.total} fragments, and now has {total}")
        if num in transfer.parts:
            self._drop(id_)
            raise BadRequest(f"fragment {num} of '{id_}' came twice; the message was dropped")
        if sum(len(each.parts) for each in self._transfers.values()) >= _PARTS:
            self._drop(id_)
            raise QueueFull(f"the incomplete messages have {_PARTS} fragments already")
        if self.held + len(fragment.data) > limit:
            self._drop(id_)
            raise PayloadTooLarge(f"the fragments have more than {limit} characters together")
        transfer.parts[num] = fragment.data
        transfer.size += len(fragment.data)
        if len(transfer.parts) == total:
            self._drop(id_)
            return "".join(transfer.parts[at] for at in range(total))
        self._wait(id_, transfer)
        return None

    def _wait(self, id_: str, transfer: _Transfer) -> None:
        if transfer.timer is not None:
            transfer.timer.cancel()
        transfer.timer = self._loop.call_later(self._timeout, self._expire, id_)

    def _expire(self, id_: str) -> None:
        transfer = self._transfers[id_]
        self._drop(id_)
        missing = transfer.total - len(transfer.parts)
        text = (
            f"no fragment of '{id_[:64]}' came for {self._timeout:g} s, and {missing} are missing"
        )
        self._lost(id_, SegmentMissing(text, remedy="Send the message again."))

    def _drop(self, id_: str) -> None:
        timer = self._transfers.pop(id_).timer
        if timer is not None:
            timer.cancel()

    def close(self) -> None:
        """Drop everything."""
        for id_ in list(self._transfers):
            self._drop(id_)
