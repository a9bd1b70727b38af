"""The paths that the configuration requests from a graph, by map and patterns."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from collections.abc import Set as AbstractSet
from typing import NamedTuple

import msgspec

from rcp_ros2.config import Mapping, Ros2Config
from rcp_ros2.definitions import TF_MESSAGE
from rcp_ros2.diagnostics import ARRAY
from rcp_ros2.graph import Graph
from rcp_ros2.names import absolute, allows, is_internal
from rcp_ros2.naming import COMMANDS, Naming, nice

__all__ = ["Wanted", "type_of"]

_NEEDED = ("/clock",)  # names queried without any mapping


class _Found(NamedTuple):
    path: str
    mapping: Mapping
    own: str | None
    """An alternative name if the path is taken; None omits the name."""


class Wanted:
    """The paths requested by a configuration."""

    def __init__(self, config: Ros2Config, naming: Naming, needed: AbstractSet[str]) -> None:
        self._naming = naming
        self._needed = needed
        """Names that are relevant for another reason."""
        self._nice = config.nice_names
        below = [*config.robots] or [config.namespace]
        each = tuple(absolute(p, space) for p in config.expose for space in below)
        not_ = tuple(absolute(p, space) for p in config.hide for space in below)
        exposed, hidden = allows(each), allows(not_)
        self.exposes = lambda n: exposed(n) and not hidden(n) and not is_internal(n)
        """Whether a name is exposed."""
        every = config.nice_names and not config.expose and not config.map
        self.is_conventional = lambda n: (
            config.nice_names and (every or exposed(n)) and not hidden(n) and not is_internal(n)
        )
        """Whether a name may be a profile's: exposed, or any if the configuration names none."""
        self.exposes_log = lambda n: exposed(n) and not hidden(n)
        self._each: dict[str, Mapping] = {}
        """Mappings that apply to each robot."""
        self.mapped: dict[str, Mapping] = {}
        """Mappings that apply once, with absolute ROS names."""
        for path, mapping in config.map.items():
            relative = config.robots and not mapping.target.startswith("/")
            if relative:
                self._each[path.removeprefix("/")] = mapping
            else:
                self.mapped[path.removeprefix("/")] = _within(mapping, config.namespace)
        self._targets = {m.target for m in self.mapped.values()}
        self._rests = {f"/{m.target}" for m in self._each.values()}
        self._transforms = {path.removeprefix("/") for path in config.tf.names}
        self._spoken: set[str] = set()
        """Topics that have been actuators: they remain so when other nodes publish too."""
        self._commanded: set[tuple[str, ...]] = set()
        """Mapped command targets: a second path to one of them would bypass its limits."""

    def offers_parameter(self, node: str, parameter: str) -> bool:
        """Return whether an exposed node's parameter is offered, unless the map already does."""
        return ("param", node, parameter) not in self._commanded

    def matters(self, name: str) -> bool:
        """Return whether a name is mapped or exposed; called in the ROS thread."""
        if name in self._targets or name in _NEEDED or name in self._needed or self.exposes(name):
            return True
        if self.is_conventional(name):
            return True
        return bool(self._rests) and self._naming.split(name)[2] in self._rests

    def free(self, graph: Graph) -> Callable[[str, Mapping], bool]:
        """Return whether a path of a convention takes no other's name, and is no second command path."""
        mapped = self.mapped | self._of_robots(graph)
        commanded = set(filter(None, map(_command, mapped.items())))
        named = {one.path: one.mapping for one in self._exposed(graph) if one.path == one.own}

        def is_free(path: str, mapping: Mapping) -> bool:
            other = named.get(path, mapping)
            own = path in mapped or path in self._transforms or other.target != mapping.target
            return not own and _command((path, mapping)) not in commanded

        return is_free

    def found(self, graph: Graph, reserved: dict[str, Mapping]) -> dict[str, Mapping]:
        """Return the paths that depend on the graph, besides the fixed ones of the map.

        Those in `reserved` are made by others. A topic that one of them commands gets no second
        actuator: the dead-man, limits and commander of each would not apply to the other.
        """
        of_robots = self._of_robots(graph)
        self._commanded = set(filter(None, map(_command, (self.mapped | of_robots).items())))
        driven = {path: m for path, m in reserved.items() if path.startswith("actuator/")}
        self._commanded |= set(filter(None, map(_command, driven.items())))
        taken = of_robots.keys() | self.mapped.keys()
        found: dict[str, Mapping] = {}
        rivals: list[_Found] = []
        for one in self._exposed(graph):
            if one.path in reserved or _command((one.path, one.mapping)) in self._commanded:
                continue
            if one.path == one.own:
                found.setdefault(one.path, one.mapping)
            else:
                rivals.append(one)
        for one in rivals:  # a configured name takes precedence over a generated one
            path = one.path if one.path not in taken and one.path not in found else one.own
            if path is not None:
                found.setdefault(path, one.mapping)
        return {path: m for path, m in found.items() if path not in taken} | of_robots

    def _of_robots(self, graph: Graph) -> dict[str, Mapping]:
        if not self._each:
            return {}
        topics = (t for t in graph.topics if t not in graph.publishers or graph.has("topic", t))
        names = (*topics, *graph.services, *graph.nodes)  # without the gateway's own topics
        robots = {robot: space for robot, space, _ in map(self._naming.split, names) if robot}
        return {
            self._naming.below(path, robot): _within(mapping, space)
            for robot, space in sorted(robots.items())
            for path, mapping in self._each.items()
        }

    def _exposed(self, graph: Graph) -> Iterator[_Found]:
        for topic in sorted(filter(self.exposes, graph.topics)):
            type_ = graph.topics[topic]
            if not _is_taken(type_):
                yield from self._topic(topic, type_, graph)
        for service in sorted(filter(self.exposes, graph.services)):
            if not _is_taken(graph.services[service]):
                yield self._plain("service", service, Mapping(service=service))
        for action in sorted(filter(self.exposes, graph.actions)):
            yield from self._named("action", action, graph.actions[action], Mapping(action=action))

    def _topic(self, topic: str, type_: str, graph: Graph) -> Iterator[_Found]:
        published = bool(graph.publishers.get(topic))
        if published:
            yield from self._named("sensor", topic, type_, _observed(topic, type_))
        if not graph.subscribers.get(topic):
            return
        if not published or type_ in COMMANDS or topic in self._spoken:
            self._spoken.add(topic)
            yield from self._named("actuator", topic, type_, Mapping(topic=topic))

    def _plain(self, branch: str, name: str, mapping: Mapping) -> _Found:
        own = self._naming.path(branch, name)
        return _Found(own, mapping, own)

    def _named(self, branch: str, name: str, type_: str, mapping: Mapping) -> Iterator[_Found]:
        plain = self._plain(branch, name, mapping)
        whole = True
        for other, field in nice(branch, name, type_) if self._nice else ():
            path = self._naming.path(branch, other)
            if field is None:
                whole = False
                yield _Found(path, mapping, plain.path)
            else:
                yield _Found(path, msgspec.structs.replace(mapping, field=field), None)
        if whole:
            yield plain


def type_of(mapping: Mapping, graph: Graph) -> str | None:
    """Return the type of a path's target, from the configuration or the graph."""
    if mapping.type is not None:
        return mapping.type
    match mapping.noun:
        case "topic":
            return graph.topics.get(mapping.target)
        case "service":
            return graph.services.get(mapping.target)
        case "action":
            return graph.actions.get(mapping.target)
        case _:
            return "parameter" if mapping.target in graph.nodes else None


def _command(item: tuple[str, Mapping]) -> tuple[str, ...] | None:
    """Return the target that a path commands, or None for a read-only one."""
    path, mapping = item
    branch = path.partition("/")[0]
    if branch in ("actuator", "service", "action"):
        return (branch, mapping.target)
    if branch == "param" and mapping.parameter is not None:
        return (branch, mapping.target, mapping.parameter)
    return None


def _within(mapping: Mapping, namespace: str) -> Mapping:
    key = mapping.noun
    return msgspec.structs.replace(mapping, **{key: absolute(mapping.target, namespace)})


def _observed(topic: str, type_: str) -> Mapping:
    """Return the mapping of an exposed topic; a robot description is reduced to its text."""
    if topic.endswith("/robot_description") and type_ == "std_msgs/msg/String":
        return Mapping(topic=topic, field="data", description="The robot's description, as URDF.")
    return Mapping(topic=topic)


def _is_taken(type_: str) -> bool:
    """Return whether a construct provides topics or services of this type in its own form."""
    return type_.startswith("lifecycle_msgs/") or type_ in (ARRAY, TF_MESSAGE)
