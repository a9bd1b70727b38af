"""What a vehicle has beside its journeys: turns, circles, held positions, sticks, motors, payloads."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from rcp_kernel.model import Resource
from rcp_kernel.spi import MotionState, Progress
from rcp_mavlink.commands import Commands
from rcp_mavlink.corrections import CORRECTIONS, Corrections
from rcp_mavlink.flight_statistics import FlightStatistics
from rcp_mavlink.flightmodes import Family
from rcp_mavlink.follow import Follows
from rcp_mavlink.follow_limits import FollowLimits
from rcp_mavlink.follow_target import FOLLOW_TARGET, FollowTargets
from rcp_mavlink.hub import Hub
from rcp_mavlink.intervals import Intervals
from rcp_mavlink.journeys import Journeys
from rcp_mavlink.motion import Motion
from rcp_mavlink.motor_tests import MotorTests
from rcp_mavlink.orbits import Orbits
from rcp_mavlink.origins import Origins
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.payloads import Payloads
from rcp_mavlink.plans import Plans
from rcp_mavlink.position_targets import PositionTargets
from rcp_mavlink.setpoints import Setpoints
from rcp_mavlink.speeds import SpeedLimit
from rcp_mavlink.sticks import Sticks
from rcp_mavlink.turns import Turns
from rcp_mavlink.vehicle import Vehicle
from rcp_mavlink.winches import Winches

__all__ = ["Equipment"]


class Equipment:
    """The services of one vehicle that need no more than its commands and messages."""

    def __init__(
        self,
        hub: Hub,
        vehicle: Vehicle,
        commands: Commands,
        intervals: Intervals,
        motion: Motion,
        parameters: Parameters,
        setpoints: Setpoints,
        limit: SpeedLimit,
        journeys: Journeys,
        plans: Plans,
    ) -> None:
        fastest = hub.config.max_speed
        self._turns = Turns(vehicle, commands, motion, limit, fastest)
        self._orbits = Orbits(vehicle, commands, motion, parameters, limit, journeys)
        self._origins = Origins(hub, vehicle, commands, intervals)
        self._payloads = Payloads(vehicle, commands, intervals)
        self._winches = Winches(vehicle, commands, intervals, motion)
        self._motors = MotorTests(vehicle, commands, intervals, motion)
        self._ongoing = (self._winches.ongoing, self._motors.ongoing)
        self._sticks = Sticks(hub, vehicle, motion)
        targets = FollowTargets(hub, vehicle, motion.hold)
        limits = FollowLimits(vehicle, commands, parameters, limit, plans)
        self._follows = Follows(hub, vehicle, motion, parameters, targets, limits, journeys)
        self._statistics = FlightStatistics(vehicle, parameters)
        self.writes: dict[str, Callable[[Any], Awaitable[None]]] = {
            "actuator/position": PositionTargets(hub, vehicle, setpoints, parameters).write,
            "actuator/sticks": self._sticks.positions,
            "actuator/rc": self._sticks.pulses,
            FOLLOW_TARGET: targets.write,
            CORRECTIONS: Corrections(hub, vehicle).write,
        }
        """The handler of each path that is written."""

    def verbs(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return the handler of each path that is executed."""
        return {
            **self._turns.verbs(),
            **self._origins.verbs(),
            **self._payloads.verbs(),
            **self._winches.verbs(),
            **self._motors.verbs(),
            "service/flight_statistics": self._statistics.read,
        }

    def leading(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return the handler of each path that ends what the vehicle does."""
        return {**self._turns.leading(), **self._orbits.leading(), **self._follows.leading()}

    @staticmethod
    def resources(family: Family, *, sticks: bool) -> list[Resource]:
        """List what a vehicle of a family has."""
        found = [
            *Turns.resources(family),
            *Orbits.resources(family),
            *Follows.resources(family),
            *Origins.resources(),
            *Payloads.resources(),
            *Winches.resources(),
            *MotorTests.resources(),
            *PositionTargets.resources(family.led),
            *Corrections.resources(),
            *FlightStatistics.resources(),
        ]
        return found + (Sticks.resources(family) if sticks else [])

    def end_writes(self) -> None:
        """Release the sticks."""
        self._sticks.end()

    def end(self) -> None:
        """Stop at once what moves beside the flight."""
        for each in self._ongoing:
            each.end()

    def keep_ending(self) -> None:
        """Repeat the stop of what was stopped and has not been seen to stop."""
        for each in self._ongoing:
            each.keep_ending()

    def state(self) -> MotionState | None:
        """Return what moves beside the flight; None if nothing does."""
        found = [state for each in self._ongoing if (state := each.state()) is not None]
        return min(found, key=lambda state: state.at_rest is not None, default=None)
