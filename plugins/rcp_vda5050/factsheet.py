"""The factsheet, in the words of each version."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from rcp_vda5050.config import RobotConfig
from rcp_vda5050.zone_messages import MOST_ZONES
from rcp_vda5050.zone_sets import SUPPORTED

__all__ = ["factsheet", "own_actions"]

_OWN: Mapping[str, tuple[str, ...]] = {
    "cancelOrder": (), "startPause": (), "stopPause": (), "stateRequest": (), "factsheetRequest": (),
    "enableMap": ("mapId", "mapVersion"),
}  # fmt: skip
_OWN_NEWER: Mapping[str, tuple[str, ...]] = {
    **_OWN, "enableZoneSet": ("zoneSetId",), "deleteZoneSet": ("zoneSetId",), "clearInstantActions": (),
    "clearZoneActions": (), "cancelOrder": ("orderId",),
}  # fmt: skip
_AT_NODES = "enableMap", "enableZoneSet"
"""Those that are actions of nodes too: behind a lift another map or zone set holds."""
_OPTIONAL_KEYS = "orderId", "zoneSetHash"
_OPTIONAL = ("order.nodes.nodePosition.theta", "order.nodes.nodePosition.allowedDeviationXY")
_INTERVAL = 0.1  # s between two states


class _Words(NamedTuple):
    kinematics: str
    class_: str
    max_load: str
    free: str
    speed: tuple[str, str]
    acceleration: tuple[str, str]
    height: tuple[str, str]
    strings: str
    arrays: str
    intervals: tuple[str, str]
    actions: str
    geometry: str
    optional: tuple[str, ...]


_OLDER = _Words(
    "agvKinematic", "agvClass", "maxLoadMass", "AUTONOMOUS", ("speedMin", "speedMax"),
    ("accelerationMax", "decelerationMax"), ("heightMin", "heightMax"), "maxStringLens", "maxArrayLens",
    ("minOrderInterval", "minStateInterval"), "agvActions", "agvGeometry",
    ("order.edges.maxSpeed",),
)  # fmt: skip
_NEWER = _Words(
    "mobileRobotKinematics", "mobileRobotClass", "maximumLoadMass", "FREELY_NAVIGATING",
    ("minimumSpeed", "maximumSpeed"), ("maximumAcceleration", "maximumDeceleration"),
    ("minimumHeight", "maximumHeight"), "maximumStringLengths", "maximumArrayLengths",
    ("minimumOrderInterval", "minimumStateInterval"), "mobileRobotActions", "mobileRobotGeometry",
    ("order.edges.maximumSpeed", "zoneSet.zones.releaseLossBehavior"),
)  # fmt: skip
_KINEMATICS = {"DIFF": "DIFFERENTIAL", "OMNI": "OMNIDIRECTIONAL", "THREEWHEEL": "THREE_WHEEL"}
"""Of 3.0, by those of 2.1."""


def own_actions(config: RobotConfig) -> Mapping[str, tuple[str, ...]]:
    """Return the instant actions that every robot does, with the keys of their parameters."""
    own = _OWN_NEWER if config.version == "3.0" else _OWN
    if config.downloads and "downloadZoneSet" not in config.actions:
        own = {**own, "downloadZoneSet": ("zoneSetId", "zoneSetDownloadLink", "zoneSetHash")}
    if "enableMap" in config.actions:  # the robot has maps of its own
        return {name: keys for name, keys in own.items() if name != "enableMap"}
    return own


def factsheet(config: RobotConfig) -> dict[str, Any]:
    """Return the body of `factsheet`."""
    given, newer = config.factsheet, config.version == "3.0"
    words = _NEWER if newer else _OLDER
    scopes = ("INSTANT", "NODE", "EDGE", *(("ZONE",) if newer else ()))
    return {
        "typeSpecification": {
            "seriesName": given.series or config.serial,
            words.kinematics: _KINEMATICS[given.kinematics] if newer else given.kinematics,
            words.class_: given.class_,
            words.max_load: given.max_load,
            "localizationTypes": list(given.localization),
            "navigationTypes": [words.free],
            **({"supportedZones": list(SUPPORTED)} if newer else {}),
        },
        "physicalParameters": {
            words.speed[0]: 0.0,
            words.speed[1]: given.max_speed,
            words.acceleration[0]: given.max_acceleration,
            words.acceleration[1]: given.max_deceleration,
            words.height[0]: given.height,
            words.height[1]: given.height,
            "width": given.width,
            "length": given.length,
        },
        "protocolLimits": {
            words.strings: {},
            words.arrays: {
                "order.nodes": 1000,
                "order.edges": 1000,
                "node.actions": 1000,
                **({"zoneSet.zones": MOST_ZONES} if newer else {}),
            },
            "timing": dict.fromkeys(words.intervals, _INTERVAL),
        },
        "protocolFeatures": {
            "optionalParameters": [
                {"parameter": name, "support": "SUPPORTED"}
                for name in (*_OPTIONAL, *words.optional)
            ],
            words.actions: [
                *(
                    _offered(name, "", _scopes(name), keys, own=True, newer=newer)
                    for name, keys in own_actions(config).items()
                ),
                *(
                    _offered(name, what.description, scopes, what.parameters, newer=newer)
                    for name, what in config.actions.items()
                ),
            ],
        },
        words.geometry: {},
        "loadSpecification": {},
    }


def _scopes(name: str) -> tuple[str, ...]:
    return ("INSTANT", "NODE") if name in _AT_NODES else ("INSTANT",)


def _offered(
    name: str,
    text: str,
    scopes: Iterable[str],
    parameters: Iterable[str],
    *,
    newer: bool,
    own: bool = False,
) -> dict[str, Any]:
    found: dict[str, Any] = {
        "actionType": name,
        "actionDescription": text,
        "actionScopes": list(scopes),
        "actionParameters": [
            {
                "key": key,
                "valueDataType": "STRING" if own else "OBJECT",
                "isOptional": not own or key in _OPTIONAL_KEYS,
            }
            for key in parameters
        ],
    }
    # Required by 3.0: a pause lets actions end, and a cancel of the order cancels them.
    return found | ({"pauseAllowed": False, "cancelAllowed": not own} if newer else {})
