"""The simulated device: a rover behind a link, with injected faults."""

from __future__ import annotations

from typing import Literal

from rcp_kernel.clock import iso, now
from rcp_kernel.errors import (
    AdapterUnavailable,
    ConfigError,
    DeviceRejected,
    DeviceTimeout,
    PreconditionFailed,
)
from rcp_kernel.spi import Host
from rcp_kernel.types import Point
from rcp_sim.config import SimConfig
from rcp_sim.faults import FaultBoard, unknown_target
from rcp_sim.messages import Boot, FaultEvent, FaultSpec, TaskEvent
from rcp_sim.publisher import Publisher
from rcp_sim.simulation import Simulation, Trip
from rcp_sim.ticker import run_ticks
from rcp_sim.waiting import Waiting

__all__ = ["Device"]

_PARTING = 0.05  # s
_ANSWER = 1.0  # s until a request without a response times out
TaskState = Literal["started", "completed", "cancelled", "failed"]


class Device:
    """A simulation in real time, with its faults and events."""

    def __init__(self, config: SimConfig, host: Host) -> None:
        self._host = host
        self._rate = config.rate
        self._awaiting = [(0.0, spec) for spec in config.faults]
        """Pending faults with their start times; those of the configuration start at the first
        tick, because nobody receives reports earlier."""
        self.sim = Simulation(config)
        self.faults = FaultBoard()
        self.publisher = Publisher(config, host, self.sim, self.faults)
        self.waiting = Waiting()
        self._ticks = 0
        self.uptime = 0.0
        """Real seconds since power-on, counted in ticks."""
        self._reported: tuple[str | None, bool] = (None, False)
        for spec in config.faults:
            if wrong := unknown_target(spec):
                raise ConfigError(f"faults: {wrong}")

    async def run(self) -> None:
        """Run until cancelled; a crash is reported before it is raised."""
        try:
            await run_ticks(self.tick, self._rate)
        except Exception as error:
            self._host.report(f"the simulated rover failed: {error}", down=True)
            raise
        finally:
            self.waiting.close("the simulated rover has stopped")

    def tick(self, stamp: int) -> None:
        """Advance by one period; `stamp` is the UTC time of the tick, ns."""
        if self.faults.crash:
            raise RuntimeError("crash, as requested")
        self._ticks += 1
        self.uptime = self._ticks / self._rate
        while self._awaiting and self._awaiting[0][0] <= self.uptime:
            self._strike(self._awaiting.pop(0)[1])
        for spec in self.faults.expire(self.uptime):
            self._over(spec)
        if (
            self.blind
            and self.receives_stops
            and (self.sim.trip is not None or self.sim.velocity != (0.0, 0.0))
        ):
            self.sim.stop("the rover sends no odometry", hard=True)
        self.publisher.tick(self.uptime, stamp)
        for fault, active, message in self.sim.happenings:
            self._event(FaultEvent(fault, active, message, None, iso(stamp)))
        self.sim.happenings.clear()
        self.waiting.poll()

    def boot(self, reason: Literal["power_on", "reset"] = "power_on") -> None:
        """Announce that the rover is up, and send the first values."""
        text = "The rover is ready." if reason == "power_on" else "The rover was reset."
        boot = Boot(reason, "simulated rover", text, iso(now()))
        self.publisher.event("event/boot", boot, now())
        if reason == "power_on":
            self._event(FaultEvent("none", False, "The self-test passed.", None, iso(now())))
            idle = TaskEvent("none", "idle", "No task has run yet.", timestamp=iso(now()))
            self.publisher.event("event/task", idle, now())
            self.publisher.send(0.0, now())

    # The link

    async def reach(self, name: str, *, stop: bool = False) -> None:
        """Transmit a request to the rover, subject to the active faults; a stop is never refused.

        :raises AdapterUnavailable: the link is lost.
        :raises DeviceTimeout: the request went missing.
        :raises DeviceRejected: the rover refuses it.
        """
        self._need_link()
        if delay := self.faults.delay(name):
            arrival = self.uptime + delay
            await self.waiting.until(lambda: self.uptime >= arrival)
            self._need_link()
        if stop:
            if self.faults.lose_stop():
                given_up = self.uptime + _ANSWER
                await self.waiting.until(lambda: self.uptime >= given_up)
                raise DeviceTimeout("the stop was lost on its way to the rover")
        elif self.faults.refused(name):
            raise DeviceRejected(
                f"the rover refuses {name}",
                remedy="Execute service/clear_faults to end the injected fault.",
            )

    @property
    def receives_stops(self) -> bool:
        """Whether a stop sent now takes effect at once."""
        return not self.faults.link_lost and not self.faults.delay("halt")

    @property
    def blind(self) -> bool:
        """Whether the odometry, which motion control needs, is missing."""
        return self.faults.stopped("sensor/odometry")

    def need_feedback(self) -> None:
        """Refuse motion without odometry.

        :raises PreconditionFailed: the odometry has stopped.
        """
        if self.blind:
            raise PreconditionFailed(
                "the rover sends no odometry, so its motion is unknown",
                remedy="Execute service/clear_faults, or wait until sensor/odometry is published again.",
            )

    def _need_link(self) -> None:
        if self.faults.link_lost:
            raise AdapterUnavailable("the link to the rover is lost")

    # Faults

    def strike(self, spec: FaultSpec) -> None:
        """Activate a fault; `link_lost` starts only after its reply could be sent."""
        if spec.fault == "link_lost":
            self._awaiting.append((self.uptime + _PARTING, spec))
        else:
            self._strike(spec)

    def _strike(self, spec: FaultSpec) -> None:
        self._event(FaultEvent(spec.fault, True, _text(spec), spec.target, iso(now())))
        self.faults.inject(spec, self.uptime)
        if spec.fault == "link_lost":
            self.sim.lose_link()
            self.waiting.poll()
        self._report()

    def clear_faults(self, fault: str | None = None) -> int:
        """End injected faults; return their number."""
        ended = self.faults.clear(fault)
        for spec in ended:
            self._over(spec)
        return len(ended)

    def _over(self, spec: FaultSpec) -> None:
        message = f"Cleared: {_text(spec)}"
        self._event(FaultEvent(spec.fault, False, message, spec.target, iso(now())))
        self._report()

    def _report(self) -> None:
        lost = self.faults.link_lost
        report = ("the link to the rover is lost" if lost else self.faults.troubles(), lost)
        if report != self._reported:
            if self._reported[1] and not lost:
                self._host.link_restored()
            self._reported = report
            self._host.report(report[0], down=lost)

    # Events

    def _event(self, event: FaultEvent) -> None:
        self.publisher.event("event/fault", event, now())

    def report_task(self, trip: Trip, state: TaskState, message: str) -> None:
        """Publish a task event."""
        rover, (x, y) = self.sim.rover, trip.follower.goal
        event = TaskEvent(
            trip.task, state, message, Point(x, y), Point(rover.x, rover.y), iso(now())
        )
        self.publisher.event("event/task", event, now())


def _text(spec: FaultSpec) -> str:
    match spec.fault:
        case "sensor_stop":
            return f"{spec.target or 'Every sensor'} has stopped publishing."
        case "refuse":
            return f"The rover refuses {spec.target or 'every command'}."
        case "slow":
            return f"Responses of {spec.target or 'everything'} are {spec.delay:g} s late."
        case "link_lost":
            return "The link is lost."
        case "stop_lost":
            return f"The next {spec.count} stops are lost."
        case "crash":
            return "The rover crashes."
