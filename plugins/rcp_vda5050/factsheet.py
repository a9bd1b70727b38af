"""The factsheet, in the words of each version."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

from rcp_vda5050.config import RobotConfig

__all__ = ["OWN_ACTIONS", "factsheet"]

OWN_ACTIONS = ("cancelOrder", "startPause", "stopPause", "stateRequest", "factsheetRequest")
"""Instant actions of the standard that every robot does."""
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


_OLDER = _Words(
    "agvKinematic", "agvClass", "maxLoadMass", "AUTONOMOUS", ("speedMin", "speedMax"),
    ("accelerationMax", "decelerationMax"), ("heightMin", "heightMax"), "maxStringLens", "maxArrayLens",
    ("minOrderInterval", "minStateInterval"), "agvActions", "agvGeometry",
)  # fmt: skip
_NEWER = _Words(
    "mobileRobotKinematics", "mobileRobotClass", "maximumLoadMass", "FREELY_NAVIGATING",
    ("minimumSpeed", "maximumSpeed"), ("maximumAcceleration", "maximumDeceleration"),
    ("minimumHeight", "maximumHeight"), "maximumStringLengths", "maximumArrayLengths",
    ("minimumOrderInterval", "minimumStateInterval"), "mobileRobotActions", "mobileRobotGeometry",
)  # fmt: skip
_KINEMATICS = {"DIFF": "DIFFERENTIAL", "OMNI": "OMNIDIRECTIONAL", "THREEWHEEL": "THREE_WHEEL"}
"""Of 3.0, by those of 2.1."""


def factsheet(config: RobotConfig) -> dict[str, Any]:
    """Return the body of `factsheet`."""
    given, newer = config.factsheet, config.version == "3.0"
    words = _NEWER if newer else _OLDER
    return {
        "typeSpecification": {
            "seriesName": given.series or config.serial,
            words.kinematics: _KINEMATICS[given.kinematics] if newer else given.kinematics,
            words.class_: given.class_,
            words.max_load: given.max_load,
            "localizationTypes": list(given.localization),
            "navigationTypes": [words.free],
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
            words.arrays: {"order.nodes": 1000, "order.edges": 1000, "node.actions": 1000},
            "timing": dict.fromkeys(words.intervals, _INTERVAL),
        },
        "protocolFeatures": {
            "optionalParameters": [
                {"parameter": f"order.nodes.nodePosition.{name}", "support": "SUPPORTED"}
                for name in ("theta", "allowedDeviationXY")
            ],
            words.actions: [
                *(_offered(name, "", ("INSTANT",), ()) for name in OWN_ACTIONS),
                *(
                    _offered(name, what.description, ("INSTANT", "NODE", "EDGE"), what.parameters)
                    for name, what in config.actions.items()
                ),
            ],
        },
        words.geometry: {},
        "loadSpecification": {},
    }


def _offered(
    name: str, text: str, scopes: Iterable[str], parameters: Iterable[str]
) -> dict[str, Any]:
    return {
        "actionType": name,
        "actionDescription": text,
        "actionScopes": list(scopes),
        "actionParameters": [
            {"key": key, "valueDataType": "OBJECT", "isOptional": True} for key in parameters
        ],
    }
