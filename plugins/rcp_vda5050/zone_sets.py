"""The zone sets that a robot keeps: checked as a whole, then enabled, one at a time.

VDA 5050 3.0 section 6.4.2.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from rcp_geometry import Corner, Polygon
from rcp_vda5050.faults import Fault, FaultKind
from rcp_vda5050.zone_messages import Zone, ZoneAction, ZoneSet

__all__ = ["SUPPORTED", "UNKNOWN", "Area", "LoadedSet", "ZoneSetRefused", "ZoneSets", "loaded"]

SUPPORTED = ("BLOCKED", "RELEASE", "SPEED_LIMIT", "ACTION")
"""Types of zones that the gateway can enforce."""
_KNOWN = (*SUPPORTED, "LINE_GUIDED", "COORDINATED_REPLANNING", "PRIORITY", "PENALTY", "DIRECTED", "BIDIRECTED")  # fmt: skip
UNKNOWN = "?"
"""Stands for a set that was enabled if it cannot be read which one that was."""
_LOSSES = ("STOP", "CONTINUE")
_MOST_SETS = 20
_MOST_CORNERS = 10_000  # of all zones of a set

Refuses = Callable[[ZoneAction], str | None]
"""Tells why an action cannot be done; None: it can."""


class ZoneSetRefused(Exception):
    """A zone set is refused as a whole."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault.text)
        self.fault = fault


class Area(NamedTuple):
    """A zone and its shape."""

    zone: Zone
    shape: Polygon

    def near(self, start: Corner, end: Corner, reach: float) -> bool:
        """Return whether a robot of a radius touches it on a straight way."""
        return self.shape.near(start, end, reach)


class LoadedSet(NamedTuple):
    """A zone set that passed its checks."""

    id: str
    map_id: str
    areas: tuple[Area, ...]


class ZoneSets:
    """The zone sets of one robot; at most one is enabled, because it has one map."""

    def __init__(self) -> None:
        self._sets: dict[str, LoadedSet] = {}
        self.enabled: LoadedSet | None = None
        self.lost: dict[str, str] = {}
        """Sets that an earlier run kept and this one cannot use, with the reason."""
        self.lost_in_force: str | None = None
        """The one of them that was enabled: nobody knows where the robot may drive."""

    def listed(self) -> list[dict[str, str]]:
        """Return `zoneSets` of the state."""
        return [
            {
                "zoneSetId": each.id,
                "mapId": each.map_id,
                "zoneSetStatus": "ENABLED" if each is self.enabled else "DISABLED",
            }
            for each in self._sets.values()
        ]

    def room_for(self, id_: str) -> None:
        """Check that another set may be kept.

        :raises ZoneSetRefused: its id is there already, or there are too many.
        """
        if id_ in self._sets:
            hint = "Another content needs another zoneSetId."
            raise _refused("duplicate_zone_set", f"there is a zone set {id_} already", id_, hint=hint)  # fmt: skip
        if len(self._sets) >= _MOST_SETS:
            text = f"{len(self._sets)} zone sets are kept already"
            raise _refused("memory", text, id_, hint="Delete one with deleteZoneSet.")

    def add(self, given: LoadedSet) -> None:
        """Keep a set, not enabled."""
        self._sets[given.id] = given
        self.lost.pop(given.id, None)

    def enable(self, id_: str) -> str | None:
        """Put a set in force instead of the one that is; return why not."""
        if id_ not in self._sets:
            return self._unknown(id_)
        self.enabled, self.lost_in_force = self._sets[id_], None
        return None

    def delete(self, id_: str) -> str | None:
        """Forget a set; return why not."""
        if id_ in self.lost or id_ == self.lost_in_force:
            self.lost.pop(id_, None)
            if self.lost_in_force == id_:
                self.lost_in_force = None
            if id_ not in self._sets:
                return None
        if id_ not in self._sets:
            return self._unknown(id_)
        if self.enabled is self._sets[id_]:
            return f"the zone set {id_} is enabled; enable another one first"
        del self._sets[id_]
        return None

    def faults(self) -> list[Fault]:
        """Return what is wrong with sets of earlier runs."""
        found = list[Fault]()
        for id_, why in self.lost.items():
            text, hint = f"the zone set {id_} is lost: {why}", "Send it again, or delete it with deleteZoneSet."  # fmt: skip
            if id_ != self.lost_in_force:
                found.append(Fault("zone_set_lost", text, (("zoneSetId", id_),), hint))
        if (fault := self.fault()) is not None:
            found.append(fault)
        return found

    def fault(self, *references: tuple[str, str]) -> Fault | None:
        """Return why no order can be accepted: the zones are not known that hold."""
        if (id_ := self.lost_in_force) is None:
            return None
        why = "it is there again, and not enabled"
        if id_ == UNKNOWN:
            why = "its row in the store, which named it, is damaged"
        why = self.lost.get(id_, why)
        text = f"the zone set {id_} was enabled before the restart, and is lost: {why}"
        hint = "Send it again and enable it, enable another one, or delete it with deleteZoneSet."
        return Fault("zones_lost", text, (("zoneSetId", id_), *references), hint)

    def _unknown(self, id_: str) -> str:
        there = ", ".join(self._sets) or "none"
        return f"there is no zone set {id_}; there are: {there}"


def loaded(given: ZoneSet, map_: str, refuses: Refuses) -> LoadedSet:
    """Check a zone set; may take a second.

    :raises ZoneSetRefused: something of it is wrong or not supported.
    """
    id_ = given.zone_set_id
    if given.map_id != map_:
        raise _refused("map", f"there is no map {given.map_id}, but {map_}", id_, ("mapId", given.map_id))  # fmt: skip
    corners = sum(len(zone.vertices) for zone in given.zones)
    if corners > _MOST_CORNERS:
        raise _refused("memory", f"{corners} vertices are more than {_MOST_CORNERS}", id_)
    seen = set[str]()
    areas = list[Area]()
    for zone in given.zones:
        if zone.zone_id in seen:
            raise _refused("malformed", f"two zones are {zone.zone_id}", id_, ("zoneId", zone.zone_id))  # fmt: skip
        seen.add(zone.zone_id)
        if (reason := _fault_of(zone, refuses)) is not None:
            text = f"zone {zone.zone_id} {reason}"
            raise _refused("malformed", text, id_, ("zoneId", zone.zone_id))
        try:
            shape = Polygon([(each.x, each.y) for each in zone.vertices])
        except ValueError as error:
            text = f"zone {zone.zone_id} {error}"
            raise _refused("malformed", text, id_, ("zoneId", zone.zone_id)) from error
        areas.append(Area(zone, shape))
    return LoadedSet(id_, given.map_id, tuple(areas))


def _fault_of(zone: Zone, refuses: Refuses) -> str | None:
    """Return what is wrong with the fields of a zone's type; None: nothing."""
    kind = zone.zone_type
    if kind not in _KNOWN:
        return f"has the unknown type {kind}"
    if kind not in SUPPORTED:
        return f"has the type {kind}; supported are: {', '.join(SUPPORTED)}"
    if kind == "SPEED_LIMIT" and zone.maximum_speed is None:
        return "has no maximumSpeed"
    if kind == "RELEASE" and (zone.release_loss_behavior or "STOP") not in _LOSSES:
        return f"has releaseLossBehavior {zone.release_loss_behavior}; supported are: {', '.join(_LOSSES)}"  # fmt: skip
    if kind != "ACTION":
        return None
    lists = (zone.entry_actions, zone.during_actions, zone.exit_actions)
    if None in lists:
        return "needs entryActions, duringActions and exitActions"
    return next(
        (reason for each in lists for action in each or () if (reason := refuses(action))), None
    )


def _refused(
    kind: FaultKind, text: str, id_: str, *references: tuple[str, str], hint: str = ""
) -> ZoneSetRefused:
    return ZoneSetRefused(Fault(kind, text, (("zoneSetId", id_), *references), hint))
