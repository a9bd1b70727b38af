"""Keeps a stopped robot stopped, from the ROS thread and independent of the event loop.

A hold begins with a stop. A latched hold lasts until the event loop has seen the e-stop reset,
which a frozen event loop cannot do. A hold without a latch expires.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import structlog

from rcp_kernel.errors import EstopActive
from rcp_ros2.link import RosLink
from rcp_ros2.means import StopSignal
from rcp_ros2.rest import Rest
from rcp_ros2.ros import contained
from rcp_ros2.servers import ActionServer

__all__ = ["Hold", "Keeper"]

log = structlog.get_logger("rcp.ros2")
_TICK = 0.01  # s
_POLL = 0.25  # s between two checks for other publishers


@dataclass(slots=True)
class Hold:
    """A stopped robot."""

    began: float
    """Monotonic time, s."""
    until: float
    """When it ends, unless it is latched; monotonic time, s."""
    latched: bool
    """Whether an e-stop holds the robot: then the configured means of stopping are used too."""
    begun: bool = False
    """Whether the ROS thread has started it."""


class Keeper:
    """The holds of a backend, and the actuators and action servers that they stop."""

    def __init__(self, link: RosLink) -> None:
        self._link = link
        self.rests: list[Rest] = []
        self.servers: dict[str, ActionServer] = {}
        self.signals: list[StopSignal] = []
        self.holds: dict[str | None, Hold] = {}
        """By robot; None stands for everything that belongs to no single robot."""
        self._timer: Any = None
        self._poll_due = 0.0
        self._reported: dict[str, tuple[str, ...]] = {}

    # -- from the event loop ---------------------------------------------------------------------

    def hold(self, robot: str | None, seconds: float, *, latched: bool) -> Hold:
        """Start or extend the hold of a robot; a new hold uses every means of stopping."""
        now = time.monotonic()
        found = self.holds.get(robot)
        if found is None:
            found = self.holds[robot] = Hold(now, now + seconds, latched)
        found.until = max(found.until, now + seconds)
        found.latched = latched
        if not found.begun:
            found.begun = True
            self._link.ros.submit(contained(self._begin, robot))
        return found

    def again(self, robot: str | None) -> None:
        """Repeat every stop command to a robot."""
        self._link.ros.submit(contained(self._begin, robot))

    def release(self, robot: str | None) -> None:
        """End a hold: the e-stop was reset."""
        self._link.ros.post(self._release, robot)

    # -- ROS thread ------------------------------------------------------------------------------

    def admit(self, robot: str | None) -> None:
        """Admit a command to a robot, which ends a hold without a latch.

        :raises EstopActive: an e-stop holds the robot.
        """
        found = self.holds.get(robot)
        if found is None:
            return
        if found.latched:
            raise EstopActive("the robot was stopped before this was sent")
        del self.holds[robot]
        for rest in self.rests:
            if rest.robot == robot:
                rest.leave()  # or the admitted command would be countered as a foreign one

    def on_goals(self, server: ActionServer) -> None:
        """Cancel the goals of a stopped robot as soon as they appear."""
        if server.robot in self.holds:
            server.cancel()

    def add(self, rest: Rest) -> None:
        """Add an actuator of a robot."""
        self.rests.append(rest)
        if rest.robot in self.holds:
            rest.begin(time.monotonic())

    def remove(self, rest: Rest) -> None:
        """Remove an actuator."""
        if rest in self.rests:
            self.rests.remove(rest)
            rest.leave()

    def follow(self, names: dict[str, str | None]) -> None:
        """Set the action servers and the robot of each."""
        for name in self.servers.keys() - names.keys():
            self.servers.pop(name).close()
        for name in names.keys() - self.servers.keys():
            server = ActionServer(self._link, name, names[name], self.on_goals)
            self.servers[name] = server
            if server.robot in self.holds:
                server.cancel()

    def poll(self) -> None:
        """Update other publishers and action servers; at each poll."""
        for server in list(self.servers.values()):
            server.poll()
        for rest in self.rests:
            rest.poll()
            if rest.others != self._reported.get(rest.topic, ()):
                self._reported[rest.topic] = rest.others
                log.info("ros_other_publishers", topic=rest.topic, nodes=list(rest.others))

    def _begin(self, robot: str | None) -> None:
        now = time.monotonic()
        for rest in self.rests:
            if rest.robot == robot:
                rest.begin(now)
                self._link.pulses.ping(rest.outlet.nodes)
        for server in self.servers.values():
            if server.robot == robot:
                server.cancel()
        hold = self.holds.get(robot)
        for signal in self.signals:
            if signal.robot == robot and hold is not None and hold.latched:
                signal.engage(now)
        for rest in self.rests:
            if rest.robot == robot:
                rest.poll()
                rest.listen()
        self.wake()

    def wake(self) -> None:
        """Repeat the stop of held robots."""
        if self._timer is None:
            self._timer = self._link.ros.node.create_timer(_TICK, contained(self._tick))
        elif self._timer.is_canceled():
            self._timer.reset()

    def _tick(self) -> None:
        now = time.monotonic()
        for robot, hold in list(self.holds.items()):
            if not hold.latched and now > hold.until:
                self.holds.pop(robot, None)
        due = now >= self._poll_due
        if due:
            self._poll_due = now + _POLL
        for rest in self.rests:
            if rest.robot in self.holds:
                rest.hold(now)
                if due:
                    rest.poll()
                    rest.listen()
                    self._link.pulses.ping(rest.outlet.nodes)
            else:
                rest.leave()
                if rest.is_bursting:
                    rest.hold(now)
        for server in self.servers.values():
            if (hold := self.holds.get(server.robot)) is not None:
                server.press(now, hold.began)
        for signal in self.signals:
            held = self.holds.get(signal.robot)
            if held is not None and held.latched:
                signal.hold(now)
        if not self.holds and not any(rest.is_bursting for rest in self.rests):
            self._timer.cancel()

    def _release(self, robot: str | None) -> None:
        self.holds.pop(robot, None)
        for rest in self.rests:
            if rest.robot == robot:
                rest.leave()
        for signal in self.signals:
            if signal.robot == robot:
                signal.release()

    def close(self) -> None:
        """Release everything, in the ROS thread."""
        self.holds.clear()
        for server in self.servers.values():
            server.close()
        self.servers.clear()
        for signal in self.signals:
            signal.close()
        self.signals.clear()
