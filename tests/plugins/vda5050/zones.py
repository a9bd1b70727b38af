"""Zones and zone sets of a fleet manager, and what the published schemas of 3.0 say of them in a state."""

from __future__ import annotations

from typing import Any

__all__ = ["box", "check_state", "keep", "request", "zone_set"]

_STATUSES = {"zoneSets": {"ENABLED", "DISABLED"}, "maps": {"ENABLED", "DISABLED"}}
_REQUESTS = {"REQUESTED", "GRANTED", "REVOKED", "EXPIRED"}
_ACTIONS = {"WAITING", "INITIALIZING", "RUNNING", "PAUSED", "RETRIABLE", "FINISHED", "FAILED"}
_LEVELS = {"WARNING", "URGENT", "CRITICAL", "FATAL"}


def box(id_: str, kind: str, left: float, right: float, **more: Any) -> dict[str, Any]:
    """Return a zone across the robot's way, between two places on it."""
    corners = [(left, -1.0), (right, -1.0), (right, 1.0), (left, 1.0)]
    vertices = [{"x": x, "y": y} for x, y in corners]
    return {"zoneId": id_, "zoneType": kind, "vertices": vertices, **more}


def zone_set(id_: str, *zones: dict[str, Any], map_: str = "hall") -> dict[str, Any]:
    """Return the body of a message `zoneSet`."""
    return {"zoneSet": {"mapId": map_, "zoneSetId": id_, "zones": list(zones)}}


async def keep(master: Any, id_: str, *zones: dict[str, Any]) -> None:
    """Send a zone set, and put it in force."""
    await master.send("r1", "zoneSet", **zone_set(id_, *zones))
    await master.instant("r1", "enableZoneSet", zoneSetId=id_)
    await master.until("r1", lambda s: (id_, "ENABLED") in listed(s))


def listed(state: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the zone sets of a state with their status."""
    return [(each["zoneSetId"], each["zoneSetStatus"]) for each in state["zoneSets"]]


def request(state: dict[str, Any], zone: str, status: str) -> dict[str, Any] | None:
    """Return the request for a zone, if it has a status."""
    found = (each for each in state["zoneRequests"] if each["zoneId"] == zone)
    return next((each for each in found if each["requestStatus"] == status), None)


def check_state(state: dict[str, Any]) -> None:
    """Check what a state says of zones by the rules of the published schema."""
    for name, statuses in _STATUSES.items():
        key = "zoneSetId" if name == "zoneSets" else "mapVersion"
        for each in state[name]:
            assert each.keys() == {key, "mapId", "zoneSetStatus" if key == "zoneSetId" else "mapStatus"}  # fmt: skip
            assert {each.get("zoneSetStatus"), each.get("mapStatus")} - {None} <= statuses
        enabled = [each for each in state[name] if "ENABLED" in each.values()]
        assert len(enabled) <= 1
    ids = [each["requestId"] for each in state["zoneRequests"]]
    assert len(set(ids)) == len(ids)
    for each in state["zoneRequests"]:
        assert each.keys() == {"requestId", "requestType", "zoneId", "zoneSetId", "requestStatus"}
        assert each["requestType"] == "ACCESS"
        assert each["requestStatus"] in _REQUESTS
    for each in state["zoneActionStates"]:
        assert each["actionStatus"] in _ACTIONS
        assert isinstance(each["actionId"], str)
    for each in state["errors"]:
        assert each["errorLevel"] in _LEVELS
        assert all(r.keys() == {"referenceKey", "referenceValue"} for r in each["errorReferences"])
