"""Zone sets from the fleet manager: one after another, checked beside the event loop, and stored."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

import msgspec
from msgspec.structs import replace

from rcp_vda5050.faults import DownloadFailed, Fault
from rcp_vda5050.messages import Action
from rcp_vda5050.work import Work
from rcp_vda5050.zone_messages import ZoneSet
from rcp_vda5050.zone_sets import LoadedSet, ZoneSetRefused, loaded
from rcp_vda5050.zone_store import ZoneStore

__all__ = ["Fetch", "ZoneIntake"]

Fetch = Callable[[str, str | None], Awaitable[bytes]]
"""Downloads from a link a document that has a digest, or raises DownloadFailed."""
_MOST = 10  # sets that wait to be checked, and downloads that wait for others


class ZoneIntake:
    """Takes, enables and deletes the zone sets of one robot, in the order in which that is asked for.

    `changed` is called when another set is there.
    """

    def __init__(
        self,
        map_: str,
        work: Work,
        store: ZoneStore,
        fetch: Fetch | None,
        changed: Callable[[], None],
    ) -> None:
        self._map, self._work, self._store = map_, work, store
        self._fetch, self._changed = fetch, changed
        self._turn, self._download = asyncio.Lock(), asyncio.Lock()
        self._waiting = self._downloads = 0

    async def restore(self, rows: Mapping[str, Any]) -> None:
        """Have the sets of earlier runs, and the one in force that was; before any order comes."""
        kept = self._store.restore(rows)
        sets, why_not = self._work.zones.sets, self._work.performer.why_not
        sets.lost.update(kept.lost)
        for each in kept.sets:
            try:
                sets.add(await asyncio.to_thread(loaded, each, self._map, why_not))
            except ZoneSetRefused as refused:  # the configuration has changed
                sets.lost[each.zone_set_id] = refused.fault.text
        if kept.enabled is not None and (
            kept.was_lost or self._work.zones.enable(kept.enabled) is not None
        ):
            sets.lost_in_force = kept.enabled

    async def take(self, given: ZoneSet) -> None:
        """Keep a set; a wrong one is told in the state."""
        try:
            await self._keep(given.zone_set_id, lambda: given)
        except ZoneSetRefused as refused:
            self._work.refuse(refused.fault)

    async def download(self, action: Action) -> Fault | None:
        """Keep a set from a link; return why not."""
        assert self._fetch is not None  # otherwise it is not offered
        references: tuple[tuple[str, str], ...] = (("actionId", action.action_id),)
        given = {each.key: each.value for each in action.action_parameters}
        id_, link, digest = (given.get(f"zoneSet{key}") for key in ("Id", "DownloadLink", "Hash"))
        if not (isinstance(id_, str) and isinstance(link, str) and isinstance(digest, str | None)):
            text = "downloadZoneSet needs the texts zoneSetId and zoneSetDownloadLink; zoneSetHash is one"
            return Fault("instant_action", text, references)
        references += (("zoneSetId", id_),)
        if self._downloads >= _MOST:  # otherwise they would hold up other instant actions
            text = f"{self._downloads} zone sets are being downloaded, or wait for that"
            hint = "Send it again, with another actionId, when the state shows that one has ended."
            return Fault("memory", text, references, hint)
        self._downloads += 1
        try:
            async with self._download:
                self._work.zones.sets.room_for(id_)
                data = await self._fetch(link, digest)
            await self._keep(id_, lambda: _read(data, id_))
        except DownloadFailed as failed:
            return Fault("work", f"downloadZoneSet: {failed}", references)
        except ZoneSetRefused as refused:
            fault = refused.fault
            return replace(fault, references=(*references[:1], *fault.references))
        finally:
            self._downloads -= 1
        return None

    async def _keep(self, id_: str, read: Callable[[], ZoneSet]) -> None:
        """Keep a set, which may have to be read first, beside the event loop.

        :raises ZoneSetRefused: it is wrong.
        """
        if self._waiting >= _MOST:
            text = f"{self._waiting} zone sets wait to be checked"
            hint = "Send it again when the state shows the others."
            raise ZoneSetRefused(Fault("memory", text, (("zoneSetId", id_),), hint))
        self._waiting += 1
        sets, why_not = self._work.zones.sets, self._work.performer.why_not

        def check() -> tuple[ZoneSet, LoadedSet]:
            given = read()
            return given, loaded(given, self._map, why_not)

        try:
            async with self._turn:
                sets.room_for(id_)
                given, found = await asyncio.to_thread(check)
                sets.add(found)
                if id_ == sets.lost_in_force:
                    self._store.mark_lost(id_)
                self._store.put(given)
        finally:
            self._waiting -= 1
        self._changed()
        await self._store.confirm()

    async def enable(self, id_: str | None) -> str | None:
        """Put a set in force; return why not."""
        if id_ is None:
            return _UNNAMED
        async with self._turn:
            why_not = self._work.zones.enable(id_)
            if why_not is None:
                self._store.enable(id_)
        await self._store.confirm()
        return why_not

    async def delete(self, id_: str | None) -> str | None:
        """Forget a set; return why not."""
        if id_ is None:
            return _UNNAMED
        sets = self._work.zones.sets
        async with self._turn:
            was_in_force = id_ == sets.lost_in_force
            why_not = sets.delete(id_)
            if why_not is None:
                self._store.delete(id_)
                if was_in_force:
                    self._store.disable()
        await self._store.confirm()
        return why_not

    def faults(self) -> list[Fault]:
        """Return what is wrong with the store."""
        if not self._store.late:
            return []
        text = "what was sent of zone sets is in force, and not in the gateway's store yet: after a restart it would be lost"  # fmt: skip
        return [Fault("not_stored", text, (), "Look at the disk of the gateway.")]


_UNNAMED = "the parameter zoneSetId is missing"


def _read(data: bytes, id_: str) -> ZoneSet:
    """Read a file: a zone set, alone or in a message.

    :raises ZoneSetRefused: it is none, or another one.
    """
    references = (("zoneSetId", id_),)
    try:
        parts = msgspec.json.decode(data, type=dict[str, msgspec.Raw])
        found = msgspec.json.decode(parts.get("zoneSet", data), type=ZoneSet)
    except (msgspec.MsgspecError, RecursionError) as error:
        text = f"what was downloaded is no zone set: {error}"
        raise ZoneSetRefused(Fault("malformed", text, references)) from error
    if found.zone_set_id != id_:
        text = f"what was downloaded is the zone set {found.zone_set_id}"
        raise ZoneSetRefused(Fault("malformed", text, references))
    return found
