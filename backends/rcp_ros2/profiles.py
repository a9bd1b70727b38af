"""The profiles of a graph's robots: what each offers by convention or map, and what that claims."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from collections.abc import Mapping as Named
from functools import partial
from typing import NamedTuple

import msgspec
import structlog
from msgspec import structs

from rcp_kernel.errors import AdapterUnavailable, ConfigError, PluginError, RcpError
from rcp_kernel.types import PoseStamped
from rcp_profiles import STANDARD, claim
from rcp_profiles import messages as m
from rcp_ros2.arm import FollowTrajectory, JointMotion, MoveJoints
from rcp_ros2.arms import ARM, Arms
from rcp_ros2.binding import Binding, Offer, Shared
from rcp_ros2.config import Mapping
from rcp_ros2.conventions import CONVENTIONS, LIMIT_TOPIC, LIMITS, SPEED_LIMIT, Convention, rank_of
from rcp_ros2.going import Going, located
from rcp_ros2.graph import Graph
from rcp_ros2.idl import load
from rcp_ros2.parameters import Described, Events, NodeParameters
from rcp_ros2.services import Called
from rcp_ros2.speed_limit import NavigatorLimit
from rcp_ros2.standard import Driven, SpeedLimit, observed
from rcp_ros2.wanted import Wanted

__all__ = ["Profiles"]

log = structlog.get_logger("rcp.ros2")
_CLAIMED = ("drive", "mobile", "arm", "battery", "camera", "lidar", "power")
_FRAMES = frozenset({"map", "odom"})


class _Choice(NamedTuple):
    """What a resource of a robot is made of."""

    standard: str
    robot: str | None
    mapping: Mapping
    type: str
    joints: tuple[str, ...] = ()
    """Of joint states: those of one arm of several."""


class Profiles:
    """Finds the conventional names of each robot, and tags what its profiles claim."""

    def __init__(
        self,
        shared: Shared,
        wanted: Wanted,
        bindings: Named[str, Binding],
        events: Events,
        frames: Callable[[str], frozenset[str]],
        arms: Arms,
    ) -> None:
        """Tell with `frames` the known frames of a namespace."""
        self._arms = arms
        self._shared = shared
        self._is_conventional = wanted.is_conventional
        self._free = wanted.free
        self._bindings = bindings
        self._events = events
        self._frames = frames
        self._chosen: dict[str, _Choice] = {}
        self._tagged_of: dict[tuple[str | None, str], frozenset[tuple[str, int]]] = {}
        """The bindings for which the claims of each part were computed."""
        self.limits: dict[str, tuple[NodeParameters, Described]] = {}
        """The parameter that is a speed limit, of each node that has one; set by the catalog."""

    # -- by convention ---------------------------------------------------------------------------

    def find(self, graph: Graph) -> dict[str, Offer]:
        """Return the resources of profiles that the graph has, or that a robot claims."""
        free = self._free(graph)
        found = {
            path: choice
            for path, choice in self._found(graph).items()
            if free(path, choice.mapping)
        }
        present = {choice.robot for choice in found.values()} | {None}
        """The robots that are there; that of the whole backend is configured, and never leaves."""
        offered = {(choice.standard, choice.mapping.target) for choice in found.values()}
        for path, choice in self._chosen.items():
            binding = self._bindings.get(path)
            claimed = binding is not None and binding.standard and binding.resource.profiles
            moved = (choice.standard, choice.mapping.target) in offered  # to a path of its own
            if path not in found and claimed and choice.robot in present and not moved:
                found[path] = choice  # degraded, until it is back
        self._chosen = found
        return {path: self._offer(path, choice) for path, choice in found.items()}

    @property
    def reserved(self) -> dict[str, Mapping]:
        """The paths found at the last poll, with their mappings."""
        return {path: choice.mapping for path, choice in self._chosen.items()}

    def _found(self, graph: Graph) -> dict[str, _Choice]:
        found: dict[str, _Choice] = {}
        for convention in CONVENTIONS:
            each: dict[str | None, list[tuple[int, str, str]]] = {}
            for name, type_ in self._offered(convention, graph):
                robot, _, rest = self._shared.naming.split(name)
                rank = rank_of(convention, rest)
                if rank is not None:
                    each.setdefault(robot, []).append((rank, name, type_))
            for robot, options in each.items():
                found |= self._picked(convention, robot, sorted(options))
        return found | self._found_limits(graph) | self._found_states(found)

    def _found_states(self, found: dict[str, _Choice]) -> dict[str, _Choice]:
        """Return the joint states of each arm, where a robot has several."""
        parts: dict[str, _Choice] = {}
        for path, choice in found.items():
            before, whole, after = path.rpartition("move_joints")
            place = before.replace("action/", "sensor/", 1)
            states = self._shared.naming.below("sensor/joint_states", choice.robot)
            own = f"{place}joint_states"
            if whole and not after and own != states and states in found:
                joints = self._arms.joints.get(choice.mapping.target, ())
                parts[own] = found[states]._replace(joints=joints)
        return parts

    def _offered(self, convention: Convention, graph: Graph) -> Iterator[tuple[str, str]]:
        match convention.noun:
            case "topic":
                heard = convention.resource.startswith("actuator/")
                ends = graph.subscribers if heard else graph.publishers
                names = {name: graph.topics[name] for name, count in ends.items() if count}
            case "service":
                names = graph.services
            case "action":
                names = graph.actions
        for name, type_ in names.items():
            if type_ in convention.types and self._is_conventional(name):
                yield name, type_

    def _picked(
        self, convention: Convention, robot: str | None, options: list[tuple[int, str, str]]
    ) -> dict[str, _Choice]:
        """Return the option by its rank; of parts each is taken, under its own name if several."""
        found: dict[str, _Choice] = {}
        branch, _, leaf = convention.resource.partition("/")
        parted = convention.names[0].startswith("*/")
        for _, name, type_ in options if parted else options[:1]:
            if convention.resource in ARM and not self._arms.is_known(name):
                continue
            path = convention.resource
            if parted and len(options) > 1:
                _, _, rest = self._shared.naming.split(name)
                part = rest.removesuffix(convention.names[0][1:]).strip("/") or leaf
                path = f"{branch}/{part}/{leaf}"
            path = self._shared.naming.below(path, robot)
            mapping = msgspec.convert({convention.noun: name}, Mapping)
            found[path] = _Choice(convention.resource, robot, mapping, type_)
        return found

    def _found_limits(self, graph: Graph) -> dict[str, _Choice]:
        """Return the speed limit of each robot: a base's own, Nav2's topic, or a controller's."""
        found: dict[str, tuple[float, _Choice]] = {}
        for rank, target, mapping, type_ in self._limits_in(graph):
            robot = self._shared.naming.split(target)[0]
            path = self._shared.naming.below(SPEED_LIMIT, robot)
            if path not in found or rank < found[path][0]:
                found[path] = rank, _Choice(SPEED_LIMIT, robot, mapping, type_)
        return {path: choice for path, (_, choice) in found.items()}

    def _limits_in(self, graph: Graph) -> Iterator[tuple[float, str, Mapping, str]]:
        for node, (_, described) in sorted(self.limits.items()):
            if node in graph.nodes:
                mapping = Mapping(node=node, parameter=described.name)
                yield LIMITS.index(described.name), node, mapping, ""
        name, type_ = LIMIT_TOPIC
        for topic, found in filter(
            lambda item: self._is_conventional(item[0]), graph.topics.items()
        ):
            taken = found == type_ and graph.subscribers.get(topic)
            if taken and self._shared.naming.split(topic)[2] == name:
                yield 0.5, topic, Mapping(topic=topic), type_

    async def _ceiling(self, topic: str) -> float | None:
        """Return the highest speed of the controller that a topic limits; None if unknown."""
        robot = self._shared.naming.split(topic)[0]
        for name, (node, described) in sorted(self.limits.items()):
            if described.name != LIMITS[0] and self._shared.naming.split(name)[0] == robot:
                with contextlib.suppress(RcpError):
                    return await node.get(described.name, described.kind)
        return None

    def _offer(self, path: str, choice: _Choice) -> Offer:
        key = f"{choice.standard} {choice.type} {choice.mapping.target} {choice.joints}"
        if choice.standard in ARM:
            joints = self._arms.of(choice.mapping.target)
            binding = self._bindings.get(path)
            if isinstance(binding, JointMotion) and binding.is_busy:
                joints = binding.joints  # until its goal has ended
            key = f"{key} {joints}"
        return Offer(choice.mapping, partial(self._make, path, choice), key)

    def _make(self, path: str, choice: _Choice) -> Binding:
        if choice.mapping.node is not None:
            node, described = self.limits[choice.mapping.node]
            return SpeedLimit(
                self._shared, path, choice.standard, choice.mapping, node, described, self._events
            )
        if choice.joints:
            cls = load(choice.type)
            return observed(self._shared, path, choice.standard, choice.mapping, cls, choice.joints)
        return self.make(path, choice.standard, choice.mapping, choice.type)

    # -- bindings --------------------------------------------------------------------------------

    def make(self, path: str, standard: str, mapping: Mapping, type_: str) -> Binding:
        """Create the binding of a profile's resource; called in the ROS thread.

        :raises MissingType: the type is not installed.
        :raises ConfigError: this resource cannot be made of the type.
        """
        if standard == SPEED_LIMIT and type_ == LIMIT_TOPIC[1]:
            ceiling = partial(self._ceiling, mapping.target)
            cls = load(type_)
            return NavigatorLimit(self._shared, path, standard, mapping, cls, ceiling=ceiling)
        convention = next((c for c in CONVENTIONS if c.resource == standard), None)
        if convention is None or type_ not in convention.types:
            known = convention.types if convention else ()
            raise ConfigError(
                f"{standard} of a profile cannot be made of {type_}, but of {', '.join(known)}"
            )
        shared = self._shared
        match convention.noun:
            case "topic" if standard.startswith("actuator/"):
                return Driven(shared, path, standard, mapping, load(type_))
            case "topic":
                return observed(shared, path, standard, mapping, load(type_))
            case "service":
                made = Called(shared, path, mapping, load(type_, "srv"))
                made.standard = standard
                return made
            case "action" if standard in ARM:
                states = path.replace("action/", "sensor/", 1).rpartition("/")[0] + "/joint_states"
                return (MoveJoints if standard == "action/move_joints" else FollowTrajectory)(
                    shared,
                    path,
                    standard,
                    mapping,
                    load(type_, "action"),
                    joints=self._arms.of(mapping.target),
                    states=partial(self._joint_states, states),
                )
            case "action":
                pose = path.replace("action/", "sensor/", 1).removesuffix("move_to") + "pose"
                return Going(
                    shared,
                    path,
                    standard,
                    mapping,
                    load(type_, "action"),
                    locate=partial(self._locate, pose),
                    frames=partial(self._known_frames, mapping.target),
                )

    async def _joint_states(self, path: str) -> m.JointStates:
        binding = self._bindings.get(path)
        if binding is None or not binding.standard:
            raise AdapterUnavailable(f"the arm has no {path}")
        try:
            return await binding.read()
        except ValueError as error:
            raise AdapterUnavailable(f"{binding.mapping.target} cannot be read: {error}") from error

    async def _locate(self, path: str) -> PoseStamped | None:
        binding = self._bindings.get(path)
        return await located(binding.read if binding and binding.standard else None)

    def _known_frames(self, target: str) -> frozenset[str]:
        return self._frames(self._shared.naming.split(target)[1]) or _FRAMES

    # -- claims ----------------------------------------------------------------------------------

    def tag(self) -> Iterator[Binding]:
        """Set what profiles each binding is part of; yield those for which that changed."""
        robots: dict[str | None, dict[str, dict[str, Binding]]] = {}
        for path, binding in self._bindings.items():
            if binding.standard is not None:
                branch, _, leaf = binding.standard.partition("/")
                where = path.removeprefix(f"{branch}/").removesuffix(leaf)
                robot = robots.setdefault(binding.resource.robot, {})
                robot.setdefault(where, {})[binding.standard] = binding
        for robot, places in robots.items():
            for where, own in places.items():
                made_of = frozenset((standard, id(binding)) for standard, binding in own.items())
                if self._tagged_of.get((robot, where)) != made_of:
                    self._tagged_of[robot, where] = made_of
                    yield from self._tagged(own)

    def _tagged(self, own: dict[str, Binding]) -> Iterator[Binding]:
        tags = _tags(own)
        for standard, binding in own.items():
            profiles = tags.get(standard, ())
            if binding.resource.profiles != profiles:
                binding.resource = structs.replace(binding.resource, profiles=profiles)
                yield binding

    def missing(self, graph: Graph) -> str | None:
        """Describe what robots claim and nobody offers now."""
        lost = [
            f"nobody offers {binding.mapping.target}, of which {', '.join(binding.resource.profiles)} "
            f"has {path}"
            for path, binding in sorted(self._bindings.items())
            if binding.standard is not None and binding.resource.profiles
            if not _is_served(binding, graph)
        ]
        return "; ".join(lost) or None


def _is_served(binding: Binding, graph: Graph) -> bool:
    mapping = binding.mapping
    if mapping.topic is None:
        return graph.has(mapping.noun, mapping.target)
    written = not (binding.standard or "").startswith("sensor/")
    return bool((graph.subscribers if written else graph.publishers).get(mapping.topic))


def _tags(own: dict[str, Binding]) -> dict[str, tuple[str, ...]]:
    """Return the profiles of each resource that a robot offers."""
    names = [
        name
        for name in _CLAIMED
        if all(
            definition.gateway or not definition.required or definition.name in own
            for profile in STANDARD[name].whole
            for definition in profile.resources
        )
    ]
    resources = (
        structs.replace(b.resource, name=standard, robot=None) for standard, b in own.items()
    )
    try:
        return {one.name: one.profiles for one in claim(names, *resources)}
    except PluginError as error:  # a mapping that takes something away: `valid_for = 0`
        log.warning("ros_profiles_not_claimed", profiles=names, detail=str(error))
        return {}
