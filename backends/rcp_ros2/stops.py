"""Stops of robots: commanded through the ROS thread, confirmed by measurements there."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Iterable
from typing import Any

import structlog
from msgspec.structs import replace

from rcp_kernel.errors import AdapterUnavailable, ConfigError, DeviceTimeout
from rcp_kernel.model import Kind, kind_of
from rcp_kernel.spi import MotionState, StopPlan, Watchdog
from rcp_ros2.arm import JointMotion
from rcp_ros2.binding import Absent, Binding, Shared
from rcp_ros2.catalog import Catalog
from rcp_ros2.config import StopTopic
from rcp_ros2.feedback import ODOMETRY, Feedbacks
from rcp_ros2.graph import Graph
from rcp_ros2.idl import MissingType
from rcp_ros2.means import StopCall, StopSignal
from rcp_ros2.names import absolute, allows
from rcp_ros2.rest import Rest
from rcp_ros2.sensors import Commanded

__all__ = ["Stops"]

log = structlog.get_logger("rcp.ros2")
_WITHIN = 2.0  # s within which a stopped robot should be at rest
_POLL = 0.02  # s between two checks for rest
_FOLLOW = 0.1  # s between two checks of the latches
_LINGER = 0.5  # s for which a stop without a latch continues
_PERIOD = 0.05  # s between two transmissions of the guard
_RIDDEN = {
    "geometry_msgs/msg/Twist",
    "geometry_msgs/msg/TwistStamped",
    "ackermann_msgs/msg/AckermannDrive",
    "ackermann_msgs/msg/AckermannDriveStamped",
}
"""Types that drive a base, whose odometry measures the effect."""
_NO_WATCHDOG = "none that can be read: it is unknown whether the robot's nodes stop by themselves"


class Stops:
    """Stops the robots of a backend, and reports their motion."""

    def __init__(self, shared: Shared, catalog: Catalog) -> None:
        self._shared = shared
        self._catalog = catalog
        self.keeper = shared.keeper
        self.feedbacks = Feedbacks(shared, self._restored)
        self._calls: dict[str, StopCall] = {}
        self._signals: set[str] = set()
        self._lost: dict[str | None, set[str]] = {}
        """Unreachable parts, by robot."""
        self._met: dict[str | None, set[str]] = {}
        """By robot: the parts that have been seen."""
        self._recovered: set[str | None] = set()
        self._contested: dict[str, tuple[str, ...] | None] = {}
        """By topic: the nodes that command a stopped robot, as last reported."""
        self._plan: dict[str, Any] = {}
        spaces = [*shared.config.robots] or [shared.config.namespace]
        patterns = shared.config.stop.actions
        self._is_own = allows(absolute(p, space) for p in patterns for space in spaces)

    # -- robots ----------------------------------------------------------------------------------

    def _bindings(self) -> list[Binding]:
        return list(self._catalog.bindings.values())

    def robots(self) -> set[str | None]:
        """Return the robots, and None for what belongs to no single robot."""
        return {
            binding.resource.robot
            for binding in self._bindings()
            if binding.mapping.noun in ("topic", "action")
        } | {None}

    def _meant(self, robot: str | None) -> set[str | None]:
        return self.robots() if robot is None else {robot}

    def _is_latched(self, robot: str | None) -> bool:
        return self._shared.host.is_latched(robot)

    # -- stopping --------------------------------------------------------------------------------

    async def halt(self, robot: str | None) -> None:
        """Stop a robot (None: all); return when rest is confirmed.

        :raises AdapterUnavailable: a robot cannot be reached, or its state is unknown.
        :raises DeviceTimeout: a robot was commanded to stop and has not come to rest.
        """
        meant = self._meant(robot)
        now = time.monotonic()
        for one in meant:
            self._hold(one, again=True)
        own = [b for b in self._bindings() if b.resource.robot in meant]
        goals = [binding.halt() for binding in own if binding.is_barred]
        # Without a latch, nothing would release these.
        latched = {one for one in meant if self._is_latched(one)}
        calls = [c.engage() for c in self._calls.values() if c.robot in latched]
        rest = self._until_rest(meant, now)
        results = await asyncio.gather(*goals, rest, *calls, return_exceptions=True)
        if all(map(self._is_measured, meant)):
            # A robot measured at rest is at rest; the failed service is reported as a problem.
            results = results[: len(goals) + 1]
        for result in results:
            if isinstance(result, BaseException):
                raise result

    def hold_stop(self, robot: str | None) -> None:
        """Keep a robot (None: all) stopped; the ROS thread repeats the stop."""
        with contextlib.suppress(AdapterUnavailable):  # ROS has ended: the backend reopens
            for one in self._meant(robot):
                self._hold(one)

    def _hold(self, robot: str | None, *, again: bool = False) -> None:
        known = self.keeper.holds.get(robot)
        latched = self._is_latched(robot)
        self.keeper.hold(robot, _LINGER, latched=latched)
        if again and known is not None:
            self.keeper.again(robot)

    async def _until_rest(self, robots: set[str | None], since: float) -> None:
        end = since + _WITHIN
        while True:
            states = [self._state(robot, since) for robot in robots]
            if all(state.at_rest for state in states):
                return
            if time.monotonic() >= end:
                break
            for robot in robots:
                self._hold(robot)
            await asyncio.sleep(_POLL)
        worst = _worst(states)
        if worst.at_rest is None:
            raise AdapterUnavailable(
                f"commanded to stop, but not known to be at rest: {worst.detail}",
                remedy="Check the robot; use its own emergency stop if in doubt.",
            )
        raise DeviceTimeout(
            f"commanded to stop, but not at rest: {worst.detail}",
            remedy="Use the robot's own emergency stop.",
        )

    async def recover(self, robot: str | None) -> str:
        """Apply `on_loss` after a robot is back."""
        if self._shared.config.on_loss == "continue":
            return "continued"
        meant = self._meant(robot)
        first = self._recovered.isdisjoint(meant) and not self._shared.sent_goals
        if first:  # commands of an earlier gateway are unknown: none may continue
            await self.halt(robot)
            self._recovered |= meant
            return "held: all goals cancelled, safe values published"
        self._shared.ros.post(self._rest, meant)  # however late the thread comes to it
        return "held: the gateway's own goals cancelled, safe values published"

    def _rest(self, robots: set[str | None]) -> None:
        now = time.monotonic()
        for rest in self.keeper.rests:
            if rest.robot in robots and rest.commanded:
                rest.begin(now)
        self.keeper.wake()

    # -- state -----------------------------------------------------------------------------------

    def motion(self, robot: str | None) -> MotionState:
        """Report whether a robot (None: the worst of all) is at rest."""
        return _worst([self._state(one) for one in self._meant(robot)])

    def _is_measured(self, robot: str | None) -> bool:
        return any(one.is_fresh() for one in self.feedbacks.of(robot))

    def _state(self, robot: str | None, since: float | None = None) -> MotionState:
        """Report on one robot; while it is stopped, only data since the stop counts."""
        hold = self.keeper.holds.get(robot)
        if since is None and hold is not None:
            since = hold.began
        rests = [rest for rest in self.keeper.rests if rest.robot == robot]
        others = [text for rest in rests if (text := rest.about_others()) is not None]
        measured = self._measured(robot, since)
        if measured is None:
            states = [self._sent(rest, since) for rest in rests]
            states += self._goals(robot, since)
            states += self._absent(robot) if since is not None else []
            if not states and (missing := self._missing(robot)) is not None:
                states = [MotionState(None, missing)]
        elif measured.at_rest is None:  # sent commands and goal statuses are no measurement
            states = [measured]
        else:
            unmeasured = [r for r in rests if r.type not in _RIDDEN and not r.measured]
            states = [measured, *(self._sent(rest, since) for rest in unmeasured)]
            states += [self._sent(r, since) for r in rests if r.commanded]  # may not move yet
            states += self._goals(robot, None)
        found = _worst(states)
        detail = "; ".join(filter(None, [found.detail, *others, *self._about_means(robot)]))
        return MotionState(found.at_rest, detail)

    def _about_means(self, robot: str | None) -> list[str]:
        calls = [c.error for c in self._calls.values() if c.robot == robot]
        signals = [s.trouble() for s in list(self.keeper.signals) if s.robot == robot]
        return [text for text in (*calls, *signals) if text is not None]

    def _measured(self, robot: str | None, since: float | None) -> MotionState | None:
        """Return the measured state; None without feedback."""
        found = self.feedbacks.of(robot)
        if not found:
            topic = self._shared.config.stop.feedback
            own = isinstance(topic, str) and any(robot == one for _, one in self._each(topic))
            return MotionState(None, f"no feedback on {topic} yet") if own else None
        demanded = [one.state(since) for one in found if one.demanded]
        if demanded:
            return _worst(demanded)
        fresh = [one for one in found if one.is_fresh() or one.required]
        return _worst([one.state(since) for one in (fresh or found[:1])])

    def _sent(self, rest: Rest, since: float | None) -> MotionState:
        """Report the state of an unmeasured actuator."""
        if rest.commanded:
            return MotionState(False, f"{rest.topic} was commanded to move")
        if rate := rest.contested():
            return MotionState(None, f"other nodes publish on {rest.topic} at {rate:.0f} Hz")
        nodes, pulses = rest.outlet.nodes, self._shared.pulses
        if not rest.needed and not nodes:
            return MotionState(True)
        if not nodes:
            return MotionState(None, f"no node subscribes to {rest.topic}")
        if since is None:
            if all(map(pulses.is_silent, nodes)):
                return MotionState(
                    None, f"the node that subscribes to {rest.topic} does not respond"
                )
            if rest.others:
                return MotionState(
                    None, f"nothing measures the effect of other publishers on {rest.topic}"
                )
            return MotionState(True)
        if rest.delivered_at is None or rest.delivered_at < since:
            return MotionState(None, f"no node has received the safe value of {rest.topic} yet")
        known = [p for node in nodes if (p := pulses.of(node)) is not None and p.answers]
        silent = [
            p for p in known if p.last_response < since or p.silence > self._shared.config.silence
        ]
        if silent or (len(known) < len(nodes) and not rest.acked):
            return MotionState(None, f"the node that subscribes to {rest.topic} does not respond")
        if rest.others and time.monotonic() - since < _LINGER:
            return MotionState(None, f"other nodes may publish on {rest.topic}")
        return MotionState(True)

    def _goals(self, robot: str | None, since: float | None) -> list[MotionState]:
        found: list[MotionState] = []
        for server in list(self.keeper.servers.values()):
            if server.robot != robot:
                continue
            if server.active():
                found.append(MotionState(False, server.trouble()))
            elif since is not None and server.answered_at < since:
                found.append(MotionState(None, f"the server of {server.name} does not respond"))
        return found

    def _missing(self, robot: str | None) -> str | None:
        """Report that no part of a robot is running; None if it has nothing that moves."""
        shared = self._shared
        own = [b for b in self._bindings() if b.resource.robot == robot]
        if robot is None and shared.config.robots and not own and len(self.robots()) > 1:
            return None  # they are stopped individually
        if not self._catalog.is_mapped or (not own and shared.settling):
            return "the robot is still being discovered"
        if robot is None and shared.config.robots and not own:
            return None  # none of them exists
        if not any(shared.graph.has(b.mapping.noun, b.mapping.target) for b in own):
            return "no node of the robot is running"
        return None

    def _absent(self, robot: str | None) -> list[MotionState]:
        """Report mapped parts that are missing: an unreachable robot is not known to be at rest."""
        found: list[MotionState] = []
        for binding in self._bindings():
            mapping = binding.mapping
            if binding.resource.robot != robot or not mapping.require_subscriber:
                continue
            if not binding.is_barred:
                continue
            kind = kind_of(binding.resource.name)
            if kind is Kind.ACTUATOR and isinstance(binding, Absent):
                found.append(MotionState(None, f"no node subscribes to {mapping.target}"))
            elif kind is Kind.ACTION and mapping.target not in self.keeper.servers:
                found.append(MotionState(None, f"no node offers {mapping.target}"))
        return found

    def watchdogs(self) -> list[Watchdog]:
        """Report for each moving robot that no watchdog is known."""
        robots = {rest.robot for rest in self.keeper.rests}
        robots |= {server.robot for server in self.keeper.servers.values()}
        return [Watchdog(_NO_WATCHDOG, None, robot=robot) for robot in sorted(robots, key=str)]

    # -- monitoring ------------------------------------------------------------------------------

    def update(self, graph: Graph) -> None:
        """Apply a new poll of the graph."""
        config, naming = self._shared.config, self._shared.naming
        harmless = {
            b.mapping.target for b in self._bindings() if b.mapping.action and not b.is_barred
        }
        servers = {
            name: naming.split(name)[0]
            for name in graph.servers - harmless
            if self._is_own(name) or name in graph.actions
        }
        self._shared.ros.post(self.keeper.follow, servers)
        self._shared.ros.post(self.keeper.poll)
        robots = self.robots()
        self.feedbacks.drop(self.feedbacks.robots - robots)
        feedback = config.stop.feedback
        if feedback is True:
            for topic, type_ in graph.topics.items():
                if type_ == ODOMETRY and graph.publishers.get(topic):
                    self.feedbacks.follow(topic, naming.split(topic)[0], type_)
            self._measure_arms(graph)
        elif isinstance(feedback, str):
            for topic, robot in self._each(feedback):
                one = self.feedbacks.follow(topic, robot, graph.topics.get(topic))
                one.demanded = True
        for binding in self._bindings():
            if (topic := binding.mapping.feedback) is not None:
                topic = self._absolute(topic, binding.resource.robot)
                binding.feedback = one = self.feedbacks.follow(
                    topic, binding.resource.robot, graph.topics.get(topic)
                )
                one.demanded = True
                if isinstance(binding, Commanded) and binding.rest is not None:
                    binding.rest.measured = True
                one.max_age = binding.mapping.feedback_timeout or one.max_age
        self._make_means()
        self._update_guard()

    def _measure_arms(self, graph: Graph) -> None:
        """Measure the joints that trajectory controllers move: their goals end before these do."""
        joints: dict[str | None, set[str]] = {}
        for binding in self._bindings():
            if isinstance(binding, JointMotion):
                joints.setdefault(binding.resource.robot, set()).update(binding.joints.names)
        for binding in self._bindings():
            robot, topic = binding.resource.robot, binding.mapping.target
            if binding.standard == "sensor/joint_states" and robot in joints:
                one = self.feedbacks.follow(topic, robot, graph.topics.get(topic))
                one.required, one.joints.needed = True, frozenset(joints[robot])

    def _each(self, name: str) -> list[tuple[str, str | None]]:
        """Return the absolute form of a configured name, for each robot if it is relative."""
        if not self._shared.config.robots or name.startswith("/"):
            return [(absolute(name, self._shared.config.namespace), None)]
        return [(self._absolute(name, robot), robot) for robot in self.robots() if robot]

    def _absolute(self, name: str, robot: str | None) -> str:
        space = self._shared.config.namespace
        if robot is not None:
            targets = (b.mapping.target for b in self._bindings() if b.resource.robot == robot)
            space = next((self._shared.naming.split(t)[1] for t in targets), space)
        return absolute(name, space)

    def _make_means(self) -> None:
        stop = self._shared.config.stop
        if stop.service is not None:
            for name, robot in self._each(stop.service.name):
                if name not in self._calls:
                    self._shared.needed.add(name)
                    config = replace(stop.service, name=name)
                    self._calls[name] = StopCall(self._shared, config, robot)
                self._shared.ros.post(self._calls[name].prepare)
        topics = [stop.topic] if stop.topic is not None else []
        if stop.twist_mux_lock is not None:
            topics.append(StopTopic(name=stop.twist_mux_lock))
        for topic in topics:
            for name, robot in self._each(topic.name):
                if name not in self._signals:
                    self._signals.add(name)
                    self._shared.ros.post(self._signal, replace(topic, name=name), robot)

    def _signal(self, config: StopTopic, robot: str | None) -> None:
        try:
            signal = StopSignal(self._shared, config, robot)
        except (MissingType, ConfigError, ValueError) as error:
            self._shared.complain(f"stop topic {config.name}", f"{config.name}: {error}")
            return
        self.keeper.signals.append(signal)
        self._shared.on_poll.append(signal.poll)

    async def follow(self) -> None:
        """Monitor the latches and reachability while the backend is open."""
        while True:
            await asyncio.sleep(_FOLLOW)
            try:
                self._follow()
            except AdapterUnavailable:  # ROS has ended
                return
            except Exception as error:
                log.error("ros_stop_failed", exc_info=error)

    def _follow(self) -> None:
        for robot in self.robots() | self.keeper.holds.keys():
            hold = self.keeper.holds.get(robot)
            if self._is_latched(robot):
                self._hold(robot)
            elif hold is not None and hold.latched:
                self.release(robot)
            self._watch(robot)
        for binding in self._bindings():
            if isinstance(binding, Commanded):
                binding.check_feedback_while_moving()
        self._report_contest()

    def release(self, robot: str | None) -> None:
        """Let a robot move again: its e-stop was reset."""
        self.keeper.release(robot)
        for call in self._calls.values():
            if call.robot == robot:
                call.release()

    def _report_contest(self) -> None:
        """Report which nodes command a stopped robot."""
        for rest in self.keeper.rests:
            contested = rest.robot in self.keeper.holds and rest.contested() > 0
            others = rest.others if contested else None  # their names may be discovered later
            if others == self._contested.get(rest.topic):
                continue
            self._contested[rest.topic] = others
            if contested:
                log.warning("ros_stop_contested", topic=rest.topic, nodes=list(rest.others))
            text = f"stopped, but {rest.about_others()}" if contested else None
            self._shared.trouble(f"others {rest.topic}", text)
            self._shared.report()

    # -- links -----------------------------------------------------------------------------------

    def _watch(self, robot: str | None) -> None:
        """Detect lost parts of a robot, and their return."""
        there = self._there(robot)
        met = self._met.setdefault(robot, set())
        first = bool(there) and not met
        met |= there
        lost = met - there
        back = self._lost.get(robot, set()) - lost
        self._lost[robot] = lost
        if first or back:
            self._restored(robot)

    def _there(self, robot: str | None) -> set[str]:
        pulses, found = self._shared.pulses, set[str]()
        for rest in self.keeper.rests:
            nodes = rest.outlet.nodes
            if rest.robot == robot and nodes and not all(map(pulses.is_silent, nodes)):
                found.add(rest.topic)
        for server in list(self.keeper.servers.values()):
            if server.robot == robot:
                found.add(server.name)
        return found

    def _restored(self, robot: str | None) -> None:
        if not self._is_latched(robot):
            self._shared.host.link_restored(robot)
            return
        self.hold_stop(robot)  # before anything else is sent to it
        self._shared.host.link_restored(robot)

    # -- the guard -------------------------------------------------------------------------------

    def _update_guard(self) -> None:
        """Update the guard's plan, which is sent if the gateway's event loop stops."""
        latched = {robot for robot, hold in self.keeper.holds.items() if hold.latched}
        publishers = [
            {
                "topic": rest.topic,
                "type": rest.type,
                "data": rest.data.hex(),
                "reliable": rest.outlet.reliable,
            }
            for rest in self.keeper.rests
        ]
        publishers += [
            {"topic": s.topic, "type": s.type, "data": s.data.hex(), "reliable": True}
            for s in self.keeper.signals
            if s.robot in latched
        ]
        services = [call.plan for call in self._calls.values() if call.plan is not None]
        data = {
            "domain_id": self._shared.config.domain_id,
            "publishers": publishers,
            "cancel": sorted(self.keeper.servers),
            "services": services,
        }
        if data != self._plan:
            self._plan = data
            useful = publishers or data["cancel"] or services
            plan = StopPlan("ros2", data, _PERIOD) if useful else None
            self._shared.host.guard("ros2", plan)

    async def close(self) -> None:
        """Release everything."""
        await asyncio.gather(*(call.close() for call in self._calls.values()))
        self._shared.ros.post(self.keeper.close)


def _worst(states: Iterable[MotionState]) -> MotionState:
    """Return the worst: moving beats unknown, which beats at rest."""
    found = list(states)
    for wanted in (False, None):
        worse = [state for state in found if state.at_rest is wanted]
        if worse:
            return MotionState(wanted, "; ".join(state.detail for state in worse if state.detail))
    return MotionState(True, "; ".join(state.detail for state in found if state.detail))
