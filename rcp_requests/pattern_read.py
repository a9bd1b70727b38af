"""`read` of a pattern: a page of values, written piece by piece between other clients' requests."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Coroutine, Hashable
from itertools import islice
from typing import Any

from rcp_kernel.contract.internal_errors import to_internal_error
from rcp_kernel.errors import DeadlineExceeded
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.samples import Sample, project
from rcp_kernel.wire import NO_BODY, error_body
from rcp_protocol.timeouts import timeout
from rcp_requests.object_list import ObjectList
from rcp_scheduling.turns import Turns

__all__ = ["PatternRead"]

_AHEAD = 256  # values requested from robots at once
_CHUNK = 16  # values encoded or requested between two checks of the time


class PatternRead:
    """The read of one page: of `entries`, in their order, as far as there is room and time."""

    def __init__(
        self,
        entries: list[Entry],
        fields: tuple[str, ...] | None,
        *,
        at_hand: Callable[[Entry], Sample | None],
        fetch: Callable[[Entry], Coroutine[Any, Any, Sample]],
        shown: Callable[[Entry, Sample], Sample],
        page: ObjectList,
        longest: int,
    ) -> None:
        self._left = iter(entries)
        self._count = len(entries)
        self._fields = fields
        self._at_hand = at_hand
        self._fetch = fetch
        self._shown = shown
        self._page = page
        self._longest = longest
        self._asked: deque[tuple[Entry, Sample | asyncio.Task[Sample]]] = deque()

    async def run(self, turns: Turns, owner: Hashable, patience: float) -> ObjectList:
        """Return the page, with at least one item if there is one.

        It ends after `patience` seconds: values requested but not received by then are reported as
        such; the rest is left to the next page.
        """
        limit = timeout(patience)
        try:
            async with limit:
                await self._fill(turns, owner)
        except TimeoutError:
            if not limit.expired():
                raise
            self._give_up(patience)
        finally:
            for _, found in self._asked:
                if isinstance(found, asyncio.Task):
                    found.cancel()
        return self._page

    async def _fill(self, turns: Turns, owner: Hashable) -> None:
        while True:
            await turns.wait(owner)
            with turns.spending():
                self._ask()
            if len(self._asked) < min(_AHEAD, self._count - len(self._page)):
                continue
            await turns.wait(owner)
            with turns.spending():
                if not self._add_items():
                    return
            if self._asked and isinstance(self._asked[0][1], asyncio.Task):
                await asyncio.wait((self._asked[0][1],))

    def _ask(self) -> None:
        for entry in islice(self._left, min(_CHUNK, _AHEAD - len(self._asked))):
            found = self._at_hand(entry) or asyncio.create_task(self._fetch(entry))
            self._asked.append((entry, found))

    def _add_items(self) -> bool:
        """Encode some of the received values; return whether there is more, and room for it."""
        for _ in range(_CHUNK):
            if not self._asked:
                return len(self._page) < self._count
            entry, found = self._asked[0]
            if isinstance(found, asyncio.Task) and not found.done():
                return True
            if not self._item(entry, found):
                return False
            self._asked.popleft()
        return True

    def _item(self, entry: Entry, found: Sample | asyncio.Task[Sample]) -> bool:
        """Encode an item; return whether it fitted."""
        try:
            sample = found.result() if isinstance(found, asyncio.Task) else found
            sample = self._shown(entry, sample)
            facts = {
                "path": entry.path,
                "status": "completed",
                "seq": sample.seq,
                "timestamp": sample.time,
                "state": "stale" if entry.stale else "fresh",
            }
            body = project(sample.value, self._fields) if self._fields else sample
            return self._page.add(facts, body, self._room)
        except Exception as error:
            return self._failed(entry, error)

    def _failed(self, entry: Entry, error: Exception) -> bool:
        internal = to_internal_error(error, path=entry.path)
        facts = {"path": entry.path, "status": internal.status, "error": error_body(internal)}
        return self._page.add(facts, NO_BODY, self._room)

    @property
    def _room(self) -> int | None:
        return self._longest if len(self._page) else None

    def _give_up(self, patience: float) -> None:
        for entry, found in self._asked:
            if isinstance(found, asyncio.Task) and not found.done():
                why = f"no answer from {entry.path} within {patience:g} s"
                fits = self._failed(entry, DeadlineExceeded(why, path=entry.path))
            else:
                fits = self._item(entry, found)
            if not fits:
                return
