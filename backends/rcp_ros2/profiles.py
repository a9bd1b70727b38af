"""The profiles of a graph's robots: what each offers by convention or map, and what that claims."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from collections.abc import Mapping as Named
from functools import partial
from typing import NamedTuple

import msgspec
import structlog
from msgspec import structs

from rcp_kernel.errors import ConfigError, PluginError
from rcp_kernel.types import PoseStamped
from rcp_profiles import STANDARD, claim
from rcp_ros2.binding import Binding, Offer, Shared
from rcp_ros2.config import Mapping
from rcp_ros2.conventions import CONVENTIONS, LIMITS, SPEED_LIMIT, Convention, rank_of
from rcp_ros2.going import Going, located
from rcp_ros2.graph import Graph
from rcp_ros2.idl import load
from rcp_ros2.parameters import Described, Events, NodeParameters
from rcp_ros2.services import Called
from rcp_ros2.standard import Driven, SpeedLimit, observed
from rcp_ros2.wanted import Wanted

__all__ = ["Profiles"]

log = structlog.get_logger("rcp.ros2")
_CLAIMED = ("drive", "mobile", "battery", "camera", "lidar", "power")
_FRAMES = frozenset({"map", "odom"})


class _Choice(NamedTuple):
    """What a resource of a robot is made of."""

    standard: str
    robot: str | None
    mapping: Mapping
    type: str


class Profiles:
    """Finds the conventional names of each robot, and tags what its profiles claim."""

    def __init__(
        self,
        shared: Shared,
        wanted: Wanted,
        bindings: Named[str, Binding],
        events: Events,
        frames: Callable[[str], frozenset[str]],
    ) -> None:
        """Tell with `frames` the known frames of a namespace."""
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
        present = {choice.robot for choice in found.values()}
        for path, choice in self._chosen.items():
            binding = self._bindings.get(path)
            claimed = binding is not None and binding.standard and binding.resource.profiles
            if path not in found and claimed and choice.robot in present:
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
        return found | self._found_limits(graph)

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
        """Return the option by its rank; cameras are all taken, each under its own name."""
        found: dict[str, _Choice] = {}
        several = len(options) > 1
        for _, name, type_ in options if convention.resource == "sensor/camera" else options[:1]:
            path = convention.resource
            if several and convention.resource == "sensor/camera":
                _, _, rest = self._shared.naming.split(name)
                camera = rest.removesuffix("/image_raw/compressed").strip("/") or "camera"
                path = f"sensor/{camera}/camera"
            path = self._shared.naming.below(path, robot)
            mapping = msgspec.convert({convention.noun: name}, Mapping)
            found[path] = _Choice(convention.resource, robot, mapping, type_)
        return found

    def _found_limits(self, graph: Graph) -> dict[str, _Choice]:
        found: dict[str, tuple[int, _Choice]] = {}
        for node, (_, described) in sorted(self.limits.items()):
            if node not in graph.nodes:
                continue
            robot = self._shared.naming.split(node)[0]
            path = self._shared.naming.below(SPEED_LIMIT, robot)
            rank = LIMITS.index(described.name)
            mapping = Mapping(node=node, parameter=described.name)
            if path not in found or rank < found[path][0]:
                found[path] = rank, _Choice(SPEED_LIMIT, robot, mapping, "")
        return {path: choice for path, (_, choice) in found.items()}

    def _offer(self, path: str, choice: _Choice) -> Offer:
        key = f"{choice.standard} {choice.type} {choice.mapping.target}"
        return Offer(choice.mapping, partial(self._make, path, choice), key)

    def _make(self, path: str, choice: _Choice) -> Binding:
        if choice.mapping.node is not None:
            node, described = self.limits[choice.mapping.node]
            return SpeedLimit(
                self._shared, path, choice.standard, choice.mapping, node, described, self._events
            )
        return self.make(path, choice.standard, choice.mapping, choice.type)

    # -- bindings --------------------------------------------------------------------------------

    def make(self, path: str, standard: str, mapping: Mapping, type_: str) -> Binding:
        """Create the binding of a profile's resource; called in the ROS thread.

        :raises MissingType: the type is not installed.
        :raises ConfigError: this resource cannot be made of the type.
        """
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
    written = (binding.standard or "").startswith("actuator/")
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
