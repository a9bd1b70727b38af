"""Zone sets from the fleet manager: one after another, checked beside the event loop."""

from __future__ import annotations

import asyncio

from rcp_vda5050.faults import Fault
from rcp_vda5050.work import Work
from rcp_vda5050.zone_messages import ZoneSet
from rcp_vda5050.zone_sets import ZoneSetRefused, loaded

__all__ = ["ZoneIntake"]

_MOST = 10  # sets that wait to be checked


class ZoneIntake:
    """Takes, enables and deletes the zone sets of one robot, in the order in which that is asked for."""

    def __init__(self, map_: str, work: Work) -> None:
        self._map, self._work = map_, work
        self._turn = asyncio.Lock()
        self._waiting = 0

    async def take(self, given: ZoneSet) -> None:
        """Keep a set; a wrong one is told in the state."""
        if self._waiting >= _MOST:
            text = f"{self._waiting} zone sets wait to be checked"
            hint = "Send it again when the state shows the others."
            self._work.refuse(Fault("memory", text, (("zoneSetId", given.zone_set_id),), hint))
            return
        self._waiting += 1
        sets = self._work.zones.sets
        try:
            async with self._turn:
                sets.room_for(given.zone_set_id)
                why_not = self._work.performer.why_not
                sets.add(await asyncio.to_thread(loaded, given, self._map, why_not))
        except ZoneSetRefused as refused:
            self._work.refuse(refused.fault)
        finally:
            self._waiting -= 1

    async def enable(self, id_: str | None) -> str | None:
        """Put a set in force; return why not."""
        async with self._turn:
            return _UNNAMED if id_ is None else self._work.zones.enable(id_)

    async def delete(self, id_: str | None) -> str | None:
        """Forget a set; return why not."""
        async with self._turn:
            return _UNNAMED if id_ is None else self._work.zones.sets.delete(id_)


_UNNAMED = "the parameter zoneSetId is missing"
