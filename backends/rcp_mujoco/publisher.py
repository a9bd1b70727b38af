"""Publishing of a simulated robot's values; runs in the stepping thread."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

from rcp_kernel.clock import now
from rcp_kernel.errors import AdapterUnavailable
from rcp_kernel.spi import Host, Publication
from rcp_mujoco.messages import SimulationState
from rcp_mujoco.robot import Robot
from rcp_mujoco.sensors import Reading

__all__ = ["SCAN_RATE", "Publisher"]

SCAN_RATE = 10.0  # Hz
_SLOWEST = 1.0  # Hz, minimum rate of watched values, so that they do not become stale
_STATE_PERIOD = 0.5  # s between simulation states, and between values while it is paused


class Publisher:
    """Reads the robot and publishes batches of values."""

    def __init__(self, robot: Robot, host: Host, state: Callable[[], SimulationState]) -> None:
        self.readings = robot.readings()
        self._by_name = {reading.name: reading for reading in self.readings}
        self._robot = robot
        self._host = host
        self._state = state
        self._began = now()
        self._wanted: dict[str, list[float | None]] = {}
        self._next: dict[str, float] = {}
        self._shown: Any = None
        self._state_at = float("-inf")

    @property
    def stamp(self) -> int:
        """Simulation time as a timestamp, counted from the opening of the robot across resets."""
        return self._began + int(self._robot.simulation.elapsed * 1e9)

    def tick(self) -> None:
        """Publish the current measurements."""
        stamp = self.stamp
        batch: list[Publication] = []
        if self._robot.simulation.fault is None:  # otherwise there are no finite values
            batch += (
                Publication(reading.name, reading.read(stamp), stamp)
                for reading in self.readings
                if not reading.is_scan or self._due(reading.name, SCAN_RATE)
            )
        self._add_state(batch, stamp)
        self._host.publish_batch(batch)

    def idle(self) -> None:
        """Repeat the measurements occasionally while the simulation is paused."""
        if time.monotonic() - self._state_at >= _STATE_PERIOD or self._has_changed():
            self._next.clear()
            self.tick()

    def _add_state(self, batch: list[Publication], stamp: int) -> None:
        if self._has_changed() or time.monotonic() - self._state_at >= _STATE_PERIOD:
            self._state_at = time.monotonic()
            state = self._state()
            self._shown = _facts(state)
            batch.append(Publication("sensor/simulation", state, stamp))

    def _has_changed(self) -> bool:
        return self._shown != _facts(self._state())

    def _due(self, name: str, fastest: float) -> bool:
        wanted = tuple(self._wanted.get(name, ()))  # the event loop changes it meanwhile
        if not wanted:
            return False
        elapsed = time.monotonic()
        if elapsed < self._next.get(name, 0.0):
            return False
        rates = [min(fastest, rate) for rate in wanted if rate is not None]
        rate = fastest if None in wanted else max(_SLOWEST, *rates)
        self._next[name] = elapsed + 1 / rate
        return True

    def read(self, name: str) -> Any:
        """Return a current value; None if there is no such reading.

        :raises AdapterUnavailable: the simulation has diverged, so that nothing can be measured.
        """
        if name == "sensor/simulation":
            return self._state()
        reading: Reading | None = self._by_name.get(name)
        if reading is None:
            return None
        if (fault := self._robot.simulation.fault) is not None:
            raise AdapterUnavailable(f"the simulation has stopped: {fault}")
        return reading.read(self.stamp)

    @contextmanager
    def watched(self, name: str, rate: float | None) -> Generator[None]:
        """Publish a value that is only published on demand, while entered; on the event loop."""
        wanted = self._wanted.setdefault(name, [])
        wanted.append(rate)
        self._next.pop(name, None)
        try:
            yield
        finally:
            wanted.remove(rate)


def _facts(state: SimulationState) -> tuple[Any, ...]:
    """Return the facts whose change is published at once; in a pause also the time."""
    time_of_steps = state.time if state.paused else None
    return state.paused, state.resets, state.brakes, state.fault, time_of_steps
