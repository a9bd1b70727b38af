"""Robot descriptions in the graph (URDF): a robot's name, and the limits of its joints."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple
from xml.etree import ElementTree as ET

import structlog

from rcp_ros2.config import Qos
from rcp_ros2.graph import Graph
from rcp_ros2.link import RosLink

__all__ = ["Description", "Descriptions", "JointLimits", "parse"]

log = structlog.get_logger("rcp.ros2")
_STRING = "std_msgs/msg/String"
_TOPIC = "/robot_description"
_LATCHED = Qos(depth=1)
_TYPES = ("revolute", "continuous", "prismatic")


class JointLimits(NamedTuple):
    """The limits of one joint, rad or m; None where the description has none."""

    low: float | None = None
    high: float | None = None
    speed: float | None = None
    continuous: bool = False
    """Whether it turns without end: positions a whole turn apart are the same."""


class Description(NamedTuple):
    """What is used of a description."""

    name: str | None
    joints: dict[str, JointLimits]


def parse(text: str) -> Description:
    """Read a description.

    :raises ValueError: it is not a URDF.
    """
    if "<!DOCTYPE" in text or "<!ENTITY" in text:  # nodes are not trusted
        raise ValueError("a document type is not accepted")
    try:
        root = ET.fromstring(text)  # noqa: S314 - without a document type there are no entities
    except ET.ParseError as error:
        raise ValueError(str(error)) from None
    if root.tag != "robot":
        raise ValueError(f"<{root.tag}> is not a <robot>")
    joints = {joint.get("name", ""): joint for joint in root.findall("joint")}
    known = {name: _limits(one) for name, one in joints.items() if one.get("type") in _TYPES}
    return Description(root.get("name") or None, known)


def _limits(joint: ET.Element) -> JointLimits:
    limit, continuous = joint.find("limit"), joint.get("type") == "continuous"
    if limit is None:
        return JointLimits(continuous=continuous)
    low, high = _number(limit, "lower"), _number(limit, "upper")
    if continuous or low is None or high is None or low > high:
        low = high = None
    speed = _number(limit, "velocity")
    return JointLimits(low, high, speed if speed is not None and speed > 0 else None, continuous)


def _number(limit: ET.Element, name: str) -> float | None:
    try:
        found = float(limit.get(name, ""))
    except ValueError:
        return None
    return found if math.isfinite(found) else None


class Descriptions:
    """The latest description of each namespace."""

    def __init__(self, link: RosLink, matters: Callable[[str], bool]) -> None:
        """Use the descriptions whose topic `matters`."""
        self._link = link
        self._matters = matters
        self._followed: set[str] = set()
        self._known: dict[str, Description] = {}

    def update(self, graph: Graph) -> None:
        """Subscribe to new descriptions; called on the event loop."""
        for topic, type_ in graph.topics.items():
            new = topic.endswith(_TOPIC) and topic not in self._followed
            if new and type_ == _STRING and graph.publishers.get(topic) and self._matters(topic):
                self._followed.add(topic)
                take = partial(self._take, topic)
                key = f"{topic} limits"
                self._link.ros.post(self._link.listen, topic, _STRING, key, take, _LATCHED)

    def of(self, space: str) -> Description | None:
        """Return the description in a namespace, if it has been received."""
        return self._known.get(f"{space}{_TOPIC}")

    def is_awaited(self, space: str) -> bool:
        """Return whether the description in a namespace is still to be received."""
        topic = f"{space}{_TOPIC}"
        return topic in self._followed and topic not in self._known

    def _take(self, topic: str, text: Any) -> None:
        try:
            found = parse(text.data)
        except ValueError as error:
            log.warning("ros_description_unusable", topic=topic, detail=str(error))
            return
        self._link.host.call_soon(self._learn, topic, found)

    def _learn(self, topic: str, found: Description) -> None:
        if self._known.get(topic) != found:
            self._known[topic] = found
            self._link.refresh()
