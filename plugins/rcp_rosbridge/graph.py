"""A tenant's tree as a ROS graph: which resource is which topic, service, action or parameter.

A resource of a ROS 2 backend keeps its ROS name and type. What belongs to a profile gets the name and
type that ROS robots use. Everything else has its place in the tree as its name.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from rcp_kernel.model import BRANCHES
from rcp_ros_messages import ACTIONS, COMMANDS, TOPICS, ActionMapping, Command, Topic, full_name
from rcp_rosbridge.compatibility import has_bytes

__all__ = [
    "Facts",
    "Feed",
    "Graph",
    "RosAction",
    "RosParameter",
    "RosService",
    "RosTopic",
    "Target",
    "same_type",
]

Facts = dict[str, Any]
"""A resource as discovery describes it."""
_PLAIN = {
    "number": "std_msgs/msg/Float64",
    "integer": "std_msgs/msg/Int64",
    "boolean": "std_msgs/msg/Bool",
    "string": "std_msgs/msg/String",
}
_TRIGGER = "std_srvs/srv/Trigger"
_STAMPED = "geometry_msgs/msg/TwistStamped"  # of whose resource the values have no header


@dataclass(frozen=True, slots=True)
class Feed:
    """Where the messages of a topic come from."""

    path: str
    mapping: Topic | None = None
    """How a value becomes a message; None: it is one, or its field `data`."""
    beside: str | None = None
    """Path of the resource whose newest value goes into the same message."""
    wraps: bool = False
    """Whether the value becomes the field `data`."""
    native: bool = False
    """Whether the serialised form of a value is the message."""


@dataclass(frozen=True, slots=True)
class Target:
    """What messages published on a topic command."""

    path: str
    kind: str
    mapping: Command | None = None
    wraps: bool = False
    expires: bool = False
    """Whether a value holds for a time only, so that the newest one replaces those before."""


@dataclass(slots=True)
class RosTopic:
    """A topic: something to subscribe to, to publish on, or both."""

    name: str
    type: str
    feed: Feed | None = None
    target: Target | None = None
    schema: Facts = field(default_factory=Facts)
    """Of the values, where they are the messages."""
    has_bytes: bool = False
    """Whether they have bytes somewhere."""
    text: str | None = None
    """The definition of the type, where the robot has one."""
    publishers: list[str] = field(default_factory=list[str])
    subscribers: list[str] = field(default_factory=list[str])


@dataclass(frozen=True, slots=True)
class RosService:
    """A service that a client sees, and the resource behind it."""

    name: str
    type: str
    path: str
    node: str
    input: Facts | None
    output: Facts | None
    triggers: bool
    """Whether its response is that of a trigger: `success` and `message`."""
    texts: Mapping[str, str] = field(default_factory=dict[str, str])
    """The definitions of `input` and `output`, where the robot has them."""


@dataclass(frozen=True, slots=True)
class RosAction:
    """An action that a client sees, and the resource behind it."""

    name: str
    type: str
    path: str
    node: str
    mapping: ActionMapping | None
    schemas: Facts


@dataclass(frozen=True, slots=True)
class RosParameter:
    """A parameter; its name is `node:parameter`."""

    name: str
    path: str
    node: str
    writable: bool


class Graph:
    """The graph of what one session may see of its tenant."""

    def __init__(self, tenant: str | None, *, complete: bool = True) -> None:
        """Begin without `complete` where a backend may still declare more: it is opening, or looks."""
        self._tenant = tenant
        self.complete = complete
        self.topics: dict[str, RosTopic] = {}
        self.services: dict[str, RosService] = {}
        self.actions: dict[str, RosAction] = {}
        self.parameters: dict[str, RosParameter] = {}
        self.nodes: set[str] = set()
        self.offering: str | None = None
        """Path of the action by which clients offer services and actions; first choice: a ROS graph."""
        self._by_path: dict[str, Facts] = {}

    def build(self, resources: Iterable[Facts]) -> Iterator[None]:
        """Add all resources, in steps."""
        others: list[Facts] = []
        offered: list[Facts] = []
        for facts in resources:
            if facts["path"].startswith("/tenant/"):
                self._by_path[facts["path"]] = facts
                self.nodes.add(f"/{facts['backend']}")
        for facts in self._by_path.values():
            meta: Facts = facts.get("meta") or {}
            if "offers" in meta:
                self._add_offering(facts, meta["offers"])
            elif "offered" in meta:
                offered.append(facts)
            elif not self._add_own(facts):
                others.append(facts)
            yield
        taken: set[str] = set()
        for topic in TOPICS:
            for facts in others:
                if self._add_mapped(topic, facts):
                    taken.add(facts["path"])
            yield
        for facts in others:
            self._add_other(facts, covered=facts["path"] in taken)
            yield
        for facts in offered:  # last: no client takes the name of a robot's own
            self._add_offered(facts, facts["meta"]["offered"])
            yield

    def topic(self, name: str) -> RosTopic | None:
        """Return a topic by its name, or by its place in the tree."""
        found = self.topics.get(_slashed(name))
        if found is None and (facts := self._at(name)) is not None:
            found = self._place_topic(name, facts)
        return found

    def service(self, name: str) -> RosService | None:
        """Return a service by its name, or by its place in the tree."""
        found = self.services.get(_slashed(name))
        if found is None and (facts := self._at(name)) and facts["kind"] in ("service", "action"):
            found = _service(name, facts)
        return found

    def action(self, name: str) -> RosAction | None:
        """Return an action by its name, or by its place in the tree."""
        found = self.actions.get(_slashed(name))
        if found is None and (facts := self._at(name)) and facts["kind"] == "action":
            found = RosAction(name, f"rcp/action/{_camel(name)}", facts["path"], "", None, {})
        return found

    # -- adding --------------------------------------------------------------------------------

    def _add_own(self, facts: Facts) -> bool:
        """Add a resource that has a ROS name of its own; return whether it has."""
        meta: Facts = facts.get("meta") or {}
        kind, type_, node = facts["kind"], meta.get("type"), f"/{facts['backend']}"
        own: Facts = {name: item for name, item in meta.items() if isinstance(item, str)}
        if kind == "param" and "parameter" in own and "node" in own:
            self._add_parameter(facts, own["node"], own["parameter"])
            return True
        if not isinstance(type_, str):
            return False
        if "topic" in own and meta.get("field") is None and facts.get("native") == type_:
            self._add_ros_topic(facts, self._name(facts, own["topic"]), type_, node)
        elif kind == "service" and "service" in own:
            self._add_service(self._name(facts, own["service"]), facts, type_)
        elif kind == "action" and "action" in own:
            name = self._name(facts, own["action"])
            schemas = facts["schemas"]
            action = RosAction(name, type_, facts["path"], node, None, schemas)
            self.actions.setdefault(name, action)
        else:
            return False
        return True

    def _add_offering(self, facts: Facts, where: str) -> None:
        may = facts["kind"] == "action" and "execute" in facts["operations"]
        if may and (self.offering is None or where == "graph"):
            self.offering = facts["path"]

    def _add_offered(self, facts: Facts, offered: Facts) -> None:
        """Add what a client offers, by the name that it chose."""
        name = self._name(facts, offered["name"])
        type_ = offered["type"]
        if facts["kind"] == "service":
            type_ = type_ or f"rcp/srv/{_camel(name.rpartition('/')[2])}"
            self._add_service(name, facts, type_)
        elif "execute" in facts["operations"]:
            type_ = type_ or f"rcp/action/{_camel(name.rpartition('/')[2])}"
            node = f"/{facts['backend']}"
            action = RosAction(name, type_, facts["path"], node, None, facts["schemas"])
            self.actions.setdefault(name, action)

    def _add_ros_topic(self, facts: Facts, name: str, type_: str, node: str) -> None:
        topic = self.topics.get(name)
        if topic is None:
            text = facts.get("texts", {}).get("value")
            topic = self.topics[name] = RosTopic(name, type_, text=text)
        schema = facts["schemas"]["value"]
        if not topic.schema and not facts.get("profiles"):  # else these are the profile's fields
            topic.schema, topic.has_bytes = schema, has_bytes(schema)
        if facts["kind"] == "actuator":
            if "write" in facts["operations"] and topic.target is None:
                # A value of a profile is not the message, if that has a header.
                rest = self._split(facts["path"])[1]
                command = next((c for c in COMMANDS if c.target == rest), None)
                if command is not None and command.same and same_type(type_, command.type):
                    command = None
                mapping = command if facts.get("profiles") else None
                topic.target = Target(facts["path"], "actuator", mapping, expires=_expires(facts))
                topic.subscribers.append(node)
            if "subscribe" in facts["operations"] and topic.feed is None and type_ != _STAMPED:
                topic.feed = Feed(facts["path"])  # what was commanded last
        elif "subscribe" in facts["operations"] and topic.feed is None:
            topic.feed = Feed(facts["path"], native=True)
            topic.publishers.append(node)

    def _add_mapped(self, mapping: Topic, facts: Facts) -> bool:
        robot, rest = self._split(facts["path"])
        if rest != mapping.source or "subscribe" not in facts["operations"]:
            return False
        fields = _properties(facts["schemas"].get("value") or {})
        if not all(name in fields for name in mapping.needs):
            return False
        name = self._prefix(facts["path"]) + robot + "/" + mapping.name
        topic = self.topics.get(name)
        if topic is not None and topic.feed is not None:
            return topic.feed.mapping is not None
        beside = None
        if mapping.beside is not None:
            beside = self._beside(facts["path"], mapping.source, mapping.beside)
        node = f"/{facts['backend']}"
        feed = Feed(facts["path"], mapping, beside)
        self.topics[name] = RosTopic(name, mapping.type, feed, publishers=[node])
        return True

    def _beside(self, path: str, source: str, other: str) -> str | None:
        """Return the path of another resource of the same robot, if it can be subscribed to."""
        branch, _, rest = source.partition("/")
        other_branch, _, other_rest = other.partition("/")
        found = path.removesuffix(rest).replace(f"/{branch}/", f"/{other_branch}/", 1) + other_rest
        facts = self._by_path.get(found)
        return found if facts is not None and "subscribe" in facts["operations"] else None

    def _add_other(self, facts: Facts, *, covered: bool) -> None:
        kind, operations = facts["kind"], facts["operations"]
        robot, rest = self._split(facts["path"])
        start = self._prefix(facts["path"]) + robot + "/"
        commands = [c for c in COMMANDS if c.target == rest]
        allowed = {"actuator": "write", "action": "execute"}.get(kind)
        for command in commands:
            if allowed in operations:
                mapping = None if command.same else command
                target = Target(facts["path"], kind, mapping, expires=_expires(facts))
                name = start + command.name
                topic = self.topics.setdefault(name, RosTopic(name, command.type))
                if kind == "actuator" and "subscribe" in operations and topic.feed is None:
                    topic.feed = Feed(facts["path"])  # what was commanded last
                if topic.target is None:
                    topic.target = target
                    topic.subscribers.append(f"/{facts['backend']}")
        if kind == "param":
            node, _, name = facts["path"].rpartition("/param/")
            name = rest.partition("/")[2]
            node = self._prefix(facts["path"]) + robot or f"/{facts['backend']}"
            self._add_parameter(facts, node, name)
        elif kind == "service":
            self._add_service(start + rest.partition("/")[2], facts, None)
        elif kind == "action":
            self._add_actions(start, rest, facts)
        elif not covered and not commands:
            self._place_topic(self._relative(facts["path"]), facts, keep=True)

    def _add_actions(self, start: str, rest: str, facts: Facts) -> None:
        node = f"/{facts['backend']}"
        for mapping in ACTIONS:
            if mapping.target == rest:
                name = start + mapping.name
                action = RosAction(name, mapping.type, facts["path"], node, mapping, {})
                self.actions.setdefault(name, action)
        name = start + rest.partition("/")[2]
        type_ = f"rcp/action/{_camel(rest.rpartition('/')[2])}"
        action = RosAction(name, type_, facts["path"], node, None, facts["schemas"])
        self.actions.setdefault(name, action)

    def _add_service(self, name: str, facts: Facts, type_: str | None) -> None:
        if "execute" in facts["operations"]:
            service = _service(name, facts, type_)
            self.services.setdefault(name, service)

    def _add_parameter(self, facts: Facts, node: str, parameter: str) -> None:
        if "read" not in facts["operations"]:
            return
        name = f"{node}:{parameter}"
        writable = "write" in facts["operations"]
        self.parameters.setdefault(name, RosParameter(name, facts["path"], node, writable))
        self.nodes.add(node)

    def _place_topic(self, name: str, facts: Facts, *, keep: bool = False) -> RosTopic | None:
        """Return the topic of a resource whose place in the tree is its name."""
        if facts["kind"] in ("service", "action"):
            return None
        schema = facts["schemas"]["value"]
        type_ = _PLAIN.get(str(schema.get("type")))
        whole = type_ is None and _is_object(schema)
        wraps = not whole
        if type_ is None:
            type_ = f"rcp/msg/{_camel(self._split(facts['path'])[1].rpartition('/')[2])}"
        topic = RosTopic(name, type_, schema=schema, has_bytes=has_bytes(schema))
        node = f"/{facts['backend']}"
        if "subscribe" in facts["operations"]:
            topic.feed = Feed(facts["path"], wraps=wraps)
            topic.publishers.append(node)
        if "write" in facts["operations"]:
            expires = _expires(facts)
            topic.target = Target(facts["path"], facts["kind"], wraps=wraps, expires=expires)
            topic.subscribers.append(node)
        if topic.feed is None and topic.target is None:
            return None
        return self.topics.setdefault(name, topic) if keep else topic

    # -- names ---------------------------------------------------------------------------------

    def _at(self, name: str) -> Facts | None:
        """Return the resource whose place in the tree is the name."""
        slashed = _slashed(name)
        if slashed.partition("/")[2].partition("/")[0] in BRANCHES and self._tenant is not None:
            slashed = f"/tenant/{self._tenant}{slashed}"
        return self._by_path.get(slashed)

    def _name(self, facts: Facts, name: str) -> str:
        """Return a ROS name; with the robot in front where another backend has it already."""
        name = self._prefix(facts["path"]) + _slashed(name)
        held = self.topics.get(name) or self.services.get(name) or self.actions.get(name)
        node = f"/{facts['backend']}"
        if isinstance(held, RosTopic):
            return name if node in (*held.publishers, *held.subscribers) else node + name
        return name if held is None or held.node == node else node + name

    def _split(self, path: str) -> tuple[str, str]:
        """Return the robot of a resource (`""` or `/name`), and the resource's name without it."""
        _, _, _, branch, *names = path.split("/")
        rest = "/".join([branch, *names])
        if rest not in _STANDARD and len(names) > 1:
            without = "/".join([branch, *names[1:]])
            if without in _STANDARD:
                return f"/{names[0]}", without
        return "", rest

    def _prefix(self, path: str) -> str:
        """Return what goes in front of the names of another tenant than the session's."""
        tenant = path.split("/", 3)[2]
        return "" if tenant == self._tenant else f"/{tenant}"

    def _relative(self, path: str) -> str:
        """Return the place in the tree as the session's tenant has it."""
        return path.removeprefix(f"/tenant/{self._tenant}") if self._tenant else path


_STANDARD = frozenset(
    (
        *(topic.source for topic in TOPICS),
        *(command.target for command in COMMANDS),
        *("service/hold", "service/reset_system", "service/enable", "service/disable"),
        *("param/speed_limit", "action/arm", "action/disarm", "action/takeoff", "action/land"),
        *("action/return_home", "action/move_joints", "action/follow_trajectory"),
    )
)
"""Names of resources that every robot of a tenant may have, below its own name."""


def _service(name: str, facts: Facts, type_: str | None = None) -> RosService:
    schemas = facts["schemas"]
    input_ = schemas.get("input")
    triggers = type_ is None and (input_ is None or _may_be_null(input_))
    shown = type_ or (_TRIGGER if triggers else f"rcp/srv/{_camel(name.rpartition('/')[2])}")
    node = f"/{facts['backend']}"
    return RosService(
        name,
        shown,
        facts["path"],
        node,
        input_,
        schemas.get("output"),
        triggers=triggers,
        texts=facts.get("texts", {}),
    )


def _slashed(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"


def _expires(facts: Facts) -> bool:
    return facts.get("valid_for") is not None or facts.get("safe") is not None


def _camel(name: str) -> str:
    words = name.replace("/", "_").replace("-", "_").replace(".", "_").split("_")
    return "".join(word[:1].upper() + word[1:] for word in words) or "Value"


def _resolved(schema: Facts) -> Facts:
    ref = schema.get("$ref")
    if isinstance(ref, str):
        return (schema.get("$defs") or {}).get(ref.rpartition("/")[2]) or {}
    return schema


def _properties(schema: Facts) -> Facts:
    return _resolved(schema).get("properties") or {}


def _is_object(schema: Facts) -> bool:
    return _resolved(schema).get("type") == "object"


def _may_be_null(schema: Facts) -> bool:
    options = schema.get("anyOf") or schema.get("oneOf") or [schema]
    return any(option.get("type") == "null" for option in options) or not _resolved(schema).get(
        "required"
    )


def same_type(one: str, other: str) -> bool:
    """Return whether two names mean the same message type."""
    return full_name(one) == full_name(other)
