"""The catalog of paths: mapped paths always, exposed paths while they are in the graph."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterable
from collections.abc import Set as AbstractSet
from functools import partial
from typing import Any

import structlog
from msgspec.structs import replace

from rcp_kernel.errors import AdapterUnavailable, ConfigError, PluginError, RcpError
from rcp_kernel.model import Kind, Resource, kind_of
from rcp_ros2.actions import Run
from rcp_ros2.arms import Arms
from rcp_ros2.assets import Assets
from rcp_ros2.atomic_parameters import AtomicParameters
from rcp_ros2.binding import Absent, Binding, Construct, Offer, Shared
from rcp_ros2.calls import Calls, calls_of
from rcp_ros2.clock import Clock
from rcp_ros2.config import Mapping
from rcp_ros2.conventions import LIMITS
from rcp_ros2.description import Descriptions
from rcp_ros2.diagnostics import Diagnostics
from rcp_ros2.facts import Facts
from rcp_ros2.goals import Goals, goals_of
from rcp_ros2.graph import Graph
from rcp_ros2.idl import MissingType, load
from rcp_ros2.learning import Learning, is_installed
from rcp_ros2.lifecycle import Lifecycles
from rcp_ros2.log import Log
from rcp_ros2.names import is_internal_parameter, resource_name
from rcp_ros2.parameters import Events, NodeParameters, Setting
from rcp_ros2.pictures import Pictures
from rcp_ros2.profiles import Profiles
from rcp_ros2.reduced import Reduced
from rcp_ros2.sensors import Commanded, Observed
from rcp_ros2.services import Called
from rcp_ros2.standard import SpeedLimit
from rcp_ros2.texts import Texts
from rcp_ros2.transforms import Transforms
from rcp_ros2.view import GraphView
from rcp_ros2.wanted import Wanted, type_of

__all__ = ["Catalog"]

log = structlog.get_logger("rcp.ros2")
_PLACING = 2.0  # s to import the types of the map
_LINGER = 5.0  # s for which an exposed name may be missing before its path is removed
_AGAIN = 5.0  # s before parameters of a node are requested again after a failure
_SOON = 0.5  # s before a type is requested again while nodes are still being discovered
_QUIET = 0.5  # s without a new path, after which discovery counts as complete
_DOUBLE = 3  # in rcl_interfaces/msg/ParameterType
_AT_ONCE = 4  # nodes queried concurrently


class Catalog:
    """The bindings of a backend, synchronized with the graph."""

    def __init__(self, shared: Shared, texts: Texts) -> None:
        config = shared.config
        self.shared = shared
        self._learning = Learning(shared, texts)
        self._exposes = bool(config.expose or config.robots or not config.map)
        """Whether the paths depend on the graph."""
        self.bindings: dict[str, Binding] = {}
        self.rates: dict[str, list[float]] = {}
        """Subscribed names with the rates of their subscribers."""
        self._wanted = wanted = Wanted(config, shared.naming, shared.needed)
        self.matters = wanted.matters
        self._mapped = wanted.mapped
        self._nodes: dict[str, NodeParameters] = {}
        self._events = Events(shared)
        clock = Clock(shared)
        self._actions: set[str] = set()
        self._services: set[str] = set()
        transforms = Transforms(shared, wanted.exposes, clock.on_jump)
        self._descriptions = Descriptions(shared, wanted.matters)
        self._arms = Arms(shared, self._descriptions)
        self._profiles = Profiles(
            shared, wanted, self.bindings, self._events, transforms.known, self._arms
        )
        diagnostics = Diagnostics(shared, wanted.exposes)
        self._facts = Facts(
            shared.host,
            shared.naming,
            self.bindings,
            self._descriptions,
            diagnostics.hardware,
        )
        self._constructs: tuple[Construct, ...] = (
            Goals(shared, self._actions),
            Calls(shared, self._services),
            Lifecycles(shared, wanted.exposes),
            diagnostics,
            clock,
            GraphView(shared),
            transforms,
            Log(shared, wanted.exposes_log),
            Pictures(shared, self.bindings),
            Assets(shared, wanted.matters),
            self._profiles,
        )
        shared.refresh = lambda: self.update(shared.graph)

        self._gone: dict[str, float] = {}
        """Exposed names no longer in the graph, with the time this was noticed."""
        self._types: dict[str, str] = {}
        """The type for which each binding was created."""
        self._keys: dict[str, str] = {}
        """What each binding of a construct was made of."""
        self._made_of: dict[str, Mapping] = {}
        """The mapping for which each binding was created."""
        self._later: dict[str, float] = {}
        """When to retry a binding that could not be created."""
        self._building: set[str] = set()
        self._tasks: set[asyncio.Task[None]] = set()
        self._queries = asyncio.Semaphore(_AT_ONCE)
        self.complete = asyncio.Event()
        """Set once every mapping has its binding, and discovery counts as complete."""
        self._placed = float("-inf")

    # -- required paths --------------------------------------------------------------------------

    def update(self, graph: Graph) -> None:
        """Apply a new poll of the graph."""
        self.shared.graph = graph
        self._descriptions.update(graph)
        for action in self._arms.unknown(graph, self._wanted.matters):
            if self._is_due(f"arm {action}"):
                self._start(f"arm {action}", self._find_joints(action))
        for name, mapping in self._mapped.items():
            self._want(name, mapping, graph, mapped=True)
        brought = {
            name: offer
            for construct in self._constructs
            for name, offer in construct.find(graph).items()
            if name not in self._mapped
        }
        reserved = self._profiles.reserved
        found = self._wanted.found(graph, reserved)
        for name, mapping in found.items():
            self._want(name, mapping, graph, mapped=False)
        _note(self._actions, "action", found.values())
        _note(self._services, "service", found.values())
        for name, offer in brought.items():
            self._gone.pop(name, None)
            is_made = name in self.bindings and self._keys.get(name, "") == offer.key
            if not is_made and time.monotonic() >= self._later.get(name, 0.0):
                self._start(name, self._bring(name, offer))
        for node in graph.nodes:
            if self._wanted.exposes(node) and self._is_due(f"node {node}"):
                self._start(f"node {node}", self._expose_parameters(node))
            if self._wanted.is_conventional(node) and self._is_due(f"limit {node}"):
                self._start(f"limit {node}", self._find_limit(node))
        self._sweep(found.keys() | brought.keys(), graph)
        self._tag()
        self._facts.tell()
        self._report(graph)
        if self._is_complete():
            self.complete.set()
        if self.is_mapped and not (self.shared.settling and self._exposes):
            self.shared.host.discovering(active=False)

    async def place_mapped(self) -> None:
        """Declare mappings whose type is configured, which do not need the graph."""
        for name, mapping in self._mapped.items():
            if mapping.type is not None:
                self._want(name, mapping, self.shared.graph, mapped=True)
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=_PLACING)

    @property
    def is_mapped(self) -> bool:
        """Whether every mapping has its binding."""
        return all(name in self.bindings for name in self._mapped)

    def _is_complete(self) -> bool:
        if self._building or not self.is_mapped:
            return False
        quiet = time.monotonic() - self._placed > _QUIET
        return not self._exposes or (quiet and bool(self.bindings))

    def _want(self, name: str, mapping: Mapping, graph: Graph, *, mapped: bool) -> None:
        self._gone.pop(name, None)
        type_ = type_of(mapping, graph)
        if type_ is None:
            if mapped and name not in self.bindings and not self.shared.settling:
                self._place(name, self._absent(name, mapping, _not_seen(mapping), _START_IT))
            return
        made = self._made_of.get(name)
        if (
            self._types.get(name) == type_ and made == mapping
        ) or time.monotonic() < self._later.get(name, 0.0):
            return
        self._start(name, self._bind(name, mapping, type_))

    # -- creating bindings -----------------------------------------------------------------------

    def _start(self, key: str, work: Any) -> None:
        if key in self._building:
            work.close()
            return
        self._building.add(key)
        task = asyncio.ensure_future(work)
        self._tasks.add(task)

        def done(ended: asyncio.Task[None]) -> None:
            self._building.discard(key)
            self._tasks.discard(ended)
            if not ended.cancelled() and (error := ended.exception()) is not None:
                self._later[key] = time.monotonic() + _AGAIN
                log.error("ros_binding_failed", what=key, exc_info=error)

        task.add_done_callback(done)

    async def _bind(self, name: str, mapping: Mapping, type_: str) -> None:
        try:
            if mapping.node is not None:
                binding = await self._bind_parameter(name, mapping)
            else:
                binding = await self._made(name, mapping, type_)
        except MissingType as error:
            # A node that appears later may provide the type, or have another version of it.
            self._later[name] = time.monotonic() + (_SOON if self.shared.settling else _AGAIN)
            type_ = ""
            if isinstance(self.bindings.get(name), Absent):
                return
            log.warning("ros_type_missing", resource=name, detail=str(error))
            binding = self._absent(name, mapping, str(error), error.remedy)
        except ConfigError as error:
            log.warning("ros_mapping_wrong", resource=name, detail=str(error))
            binding = self._absent(name, mapping, str(error), "Correct the mapping of this path.")
        except RcpError as error:
            self._later[name] = time.monotonic() + _AGAIN
            if not isinstance(self.bindings.get(name), Absent | None):
                return
            binding = self._absent(name, mapping, error.message, error.remedy)
            type_ = ""
        self._place(name, binding)
        self._types[name] = type_
        self._made_of[name] = mapping

    async def _made(self, name: str, mapping: Mapping, type_: str) -> Binding:
        make = partial(self._make, name, mapping, type_)
        return await self._learned(name, mapping, type_, make)

    async def _learned(
        self, name: str, mapping: Mapping, type_: str, make: Callable[[], Binding]
    ) -> Binding:
        """Create a binding, of a type that is learned first if it is not installed."""
        ros, noun = self.shared.ros, mapping.noun
        group = {"service": "srv", "action": "action"}.get(noun)
        of_goals = kind_of(name) is Kind.SENSOR  # those of an action have a type of their own
        if type_ and group and not of_goals and not await ros.call(is_installed, type_, group):
            await self._learning.interface(noun, mapping.target, type_)
        try:
            return await ros.call(make)
        except MissingType:
            topic = mapping.topic
            if topic is None or not type_ or not await self._learning.topic(topic, type_):
                raise
            return await ros.call(make)

    async def _bring(self, name: str, offer: Offer) -> None:
        try:
            type_ = type_of(offer.mapping, self.shared.graph)
            binding = await self._learned(name, offer.mapping, type_ or "", offer.make)
        except MissingType as error:
            self._later[name] = time.monotonic() + _AGAIN
            self.shared.trouble(name, f"{name} is not available: {error}. {error.remedy}")
            if not isinstance(self.bindings.get(name), Absent):
                self._place(name, self._absent(name, offer.mapping, str(error), error.remedy))
            return
        self.shared.trouble(name, None)
        self._keys[name] = offer.key
        self._types.pop(name, None)
        self._place(name, binding)

    def _make(self, name: str, mapping: Mapping, type_: str) -> Binding:
        kind = kind_of(name)
        if mapping.profile:
            return self._profiles.make(name, self._standard(name, mapping), mapping, type_)
        match mapping.noun:
            case "service" if kind is Kind.EVENT:
                return calls_of(self.shared, name, mapping, type_)
            case "action" if kind is Kind.SENSOR:
                return goals_of(self.shared, name, mapping)
            case "topic":
                cls = load(type_)
                if kind is not Kind.ACTUATOR:
                    sensor = Reduced if mapping.crop or mapping.decimate else Observed
                    return sensor.of(self.shared, name, mapping, cls)
                return Commanded(self.shared, name, mapping, cls)
            case "service":
                return Called(self.shared, name, mapping, load(type_, "srv"))
            case _:
                return Run(self.shared, name, mapping, load(type_, "action"))

    def _standard(self, name: str, mapping: Mapping) -> str:
        """Return the name of a mapping's resource without the robot."""
        robot = self.shared.naming.split(mapping.target)[0]
        branch, _, rest = name.partition("/")
        return f"{branch}/{rest.removeprefix(f'{robot}/')}" if robot else name

    async def _find_limit(self, name: str) -> None:
        """Look for a speed limit among the parameters of a node."""
        key = f"limit {name}"
        try:
            async with self._queries:
                node = await self._node(name)
                own = set(await node.names())
                first = next((limit for limit in LIMITS if limit in own), None)
                described = await node.describe([first]) if first else []
        except RcpError as error:
            self._later[key] = time.monotonic() + _AGAIN
            log.warning("ros_parameters_unknown", node=name, detail=error.message)
            return
        if described and described[0].kind == _DOUBLE:
            self._profiles.limits[name] = (node, described[0])
        else:  # Nav2's servers declare theirs when they are configured
            self._events.follow(name, partial(self._changed, name))
        self._types[key] = "parameters"

    async def _find_joints(self, action: str) -> None:
        """Ask a trajectory controller for its joints."""
        try:
            async with self._queries:
                await self._arms.ask(action, self._node)
        except RcpError as error:
            self._later[f"arm {action}"] = time.monotonic() + _AGAIN
            log.warning("ros_joints_unknown", action=action, detail=error.message)
            return
        self.shared.refresh()

    async def _bind_parameter(self, name: str, mapping: Mapping) -> Binding:
        node = await self._node(mapping.target)
        wanted = [mapping.parameter] if mapping.parameter else list(mapping.parameters)
        every = wanted == ["*"]
        found = await node.describe(await node.names() if every else wanted)
        missing = set() if every else set(wanted) - {one.name for one in found}
        if missing or not found:
            raise AdapterUnavailable(
                f"{node.node} has no parameter '{', '.join(sorted(missing))}', or it has no value "
                "yet",
                remedy="Check the name with `ros2 param list`.",
            )
        self._events.follow(mapping.target, partial(self._changed, mapping.target))
        if mapping.parameters:
            settable = [one for one in found if not one.read_only]
            return AtomicParameters(self.shared, name, mapping, node, settable)
        if mapping.profile:
            standard = self._standard(name, mapping)
            return SpeedLimit(self.shared, name, standard, mapping, node, found[0], self._events)
        return Setting(self.shared, name, mapping, node, found[0], self._events)

    async def _node(self, name: str) -> NodeParameters:
        if name not in self._nodes:
            made = await self.shared.ros.call(NodeParameters, self.shared, name)
            self._nodes.setdefault(name, made)
        return self._nodes[name]

    def _is_due(self, key: str) -> bool:
        return key not in self._types and time.monotonic() >= self._later.get(key, 0.0)

    async def _expose_parameters(self, name: str) -> None:
        prefix = self.shared.naming.path("param", name) + "/"
        key = f"node {name}"
        try:
            async with self._queries:
                node = await self._node(name)
                found = await node.describe(await node.names())
        except RcpError as error:
            self._later[key] = time.monotonic() + _AGAIN
            log.warning("ros_parameters_unknown", node=name, detail=error.message)
            return
        self._events.follow(name, partial(self._changed, name))
        offers = self._wanted.offers_parameter
        for described in found:
            path = prefix + resource_name("param", described.name).removeprefix("param/")
            old = self.bindings.get(path)
            same = isinstance(old, Setting) and old.described == described
            free = path not in self._mapped and offers(name, described.name)
            if free and not same:
                mapping = Mapping(node=name, parameter=described.name)
                binding = Setting(self.shared, path, mapping, node, described, self._events)
                self._place(path, binding)
        self._types[key] = "parameters"

    def _changed(self, node: str, kinds: dict[str, int]) -> None:
        """Query a node again after it has declared parameters or changed the type of one."""
        own = self.bindings.values()
        settings = [b for b in own if isinstance(b, Setting) and b.standard is None]
        known = {b.described.name: b for b in settings if b.mapping.node == node}
        for name, kind in kinds.items():
            setting = known.get(name)
            if is_internal_parameter(name) or (setting and setting.described.kind == kind):
                continue
            if setting is not None and setting.resource.name in self._mapped:
                self._types.pop(setting.resource.name, None)
                continue
            if setting is not None and kind == 0:
                self._remove(setting.resource.name, setting)
            self._types.pop(f"node {node}", None)
        if not kinds.keys().isdisjoint(LIMITS):
            self._types.pop(f"limit {node}", None)
        self.update(self.shared.graph)

    def _absent(self, name: str, mapping: Mapping, why: str, remedy: str) -> Absent:
        resource = Resource(
            name=name,
            description=f"The {mapping.noun} {mapping.target}, which is currently not available.",
            value=Any,
            input=Any,
            output=Any,
            meta={mapping.noun: mapping.target},
        )
        return Absent(self.shared, resource, mapping, why, remedy)

    # -- adding and removing ---------------------------------------------------------------------

    def _place(self, name: str, binding: Binding) -> None:
        old = self.bindings.get(name)
        if old is not None:
            old.close()
        robot = self.shared.naming.split(binding.mapping.target)[0]
        if robot is not None and name.split("/")[1] == robot:
            binding.resource = replace(binding.resource, robot=robot)
        try:
            self.shared.host.declare(binding.resource)
        except (PluginError, RcpError) as error:
            binding.close()
            self.bindings.pop(name, None)
            log.error("ros_resource_refused", resource=name, detail=str(error))
            return
        self.bindings[name] = binding
        binding.placed()
        self._placed = time.monotonic()
        if name in self.rates:
            binding.watched(max(self.rates[name]))

    def _tag(self) -> None:
        """Tell what the robots claim with what they offer now."""
        for binding in self._profiles.tag():
            self.shared.host.declare(binding.resource)

    def _sweep(self, found: AbstractSet[str], graph: Graph) -> None:
        now = time.monotonic()
        for name, binding in list(self.bindings.items()):
            if name in self._mapped or name in found:
                continue
            if binding.mapping.node is not None and binding.mapping.node in graph.nodes:
                self._gone.pop(name, None)
            elif now - self._gone.setdefault(name, now) > _LINGER:
                self._remove(name, binding)

    def _remove(self, name: str, binding: Binding) -> None:
        binding.close()
        del self.bindings[name]
        self._gone.pop(name, None)
        self._types.pop(name, None)
        self._made_of.pop(name, None)
        self._keys.pop(name, None)
        node = binding.mapping.node
        if node is not None and node not in self.shared.graph.nodes:
            self._types.pop(f"node {node}", None)
            self._types.pop(f"limit {node}", None)
            self._profiles.limits.pop(node, None)
            self._events.leave(node)
        self.shared.outbox.forget(name)
        self.shared.host.withdraw(name)

    def _report(self, graph: Graph) -> None:
        if self.shared.settling:
            return
        missing = sorted(
            {m.target for m in self._mapped.values() if not graph.has(m.noun, m.target)}
        )
        text = f"nobody offers {', '.join(missing)}" if missing else None
        self.shared.trouble("missing", text)
        self.shared.trouble("profiles", self._profiles.missing(graph))
        words = "; ".join(graph.disputed[name] for name in sorted(graph.disputed))
        self.shared.trouble("types", words or None)
        self.shared.report()

    async def close(self) -> None:
        """Stop creating bindings, and release everything."""
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        for binding in self.bindings.values():
            binding.close()


_START_IT = "Start the node that provides it, or set its `type` in the mapping."


def _note(into: set[str], noun: str, found: Iterable[Mapping]) -> None:
    into.clear()
    into.update(mapping.target for mapping in found if mapping.noun == noun)


def _not_seen(mapping: Mapping) -> str:
    if mapping.node is not None:
        return f"the node {mapping.node} is not running, so its parameters are not known yet"
    return f"no node offers the {mapping.noun} {mapping.target}, so its type is not known yet"
