"""The thread of a simulation: real-time pacing, jobs from the event loop, steps on demand."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

from rcp_mujoco.simulation import Simulation

__all__ = ["Job", "Pace", "Stepper"]

_SLICE = 0.005  # s of wall-clock time between checks for jobs
_LATE = 0.25  # s, maximum delay that is caught up
_IDLE = 0.1  # s between heartbeats of a paused simulation
_OVERDUE = 1.5  # times the period, after which a tick is due although no time was simulated for it
_MEASURED = 0.5  # s, window of the measured real-time factor
_JOIN = 2.0  # s for the thread to end


class Job(NamedTuple):
    """A function to run between two steps."""

    run: Callable[[Simulation], Any]
    done: Callable[[Any, BaseException | None], None]
    is_wanted: Callable[[], bool]
    """Whether it is still needed; called just before it would run."""


class Budget:
    """Steps on demand."""

    def __init__(self, steps: int, done: Callable[[], None]) -> None:
        self.left = steps
        self.done = done


class Pace(NamedTuple):
    """How fast simulated time passes."""

    factor: float
    paused: bool


class Stepper:
    """Steps a simulation in a separate thread.

    `on_tick(simulation)` is called in that thread `rate` times per second of wall-clock time while
    the simulation runs, and after steps on demand; `on_idle` occasionally while it is paused.
    """

    def __init__(
        self,
        simulation: Simulation,
        pace: Pace,
        *,
        rate: float,
        on_tick: Callable[[], None],
        on_idle: Callable[[], None],
    ) -> None:
        self.pace = pace
        self.measured = 0.0
        """The recent real-time factor."""
        self.beats = 0
        """Incremented while the thread is alive."""
        self._simulation = simulation
        self._rate = rate
        self._on_tick = on_tick
        self._on_idle = on_idle
        self._jobs: deque[Job] = deque()
        self._budgets: deque[Budget] = deque()
        self._wake = threading.Event()
        self._closing = False
        self._next_tick = 0.0
        self._tick_by = 0.0
        self._from = (0.0, 0.0)
        self._since = (0.0, 0.0)
        self._thread = threading.Thread(target=self._run, name="mujoco", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self) -> bool:
        """End the thread; return whether it ended in time. Blocks."""
        self._closing = True
        self._wake.set()
        self._thread.join(_JOIN)
        return not self._thread.is_alive()

    def submit(self, job: Job) -> None:
        """Queue a job to run between two steps, in order; callable from any thread."""
        self._jobs.append(job)
        self._wake.set()

    # In the thread

    def set_pace(self, *, factor: float | None = None, paused: bool | None = None) -> Pace:
        """Change the pace; call it from jobs."""
        old = self.pace
        self.pace = Pace(
            old.factor if factor is None else factor, old.paused if paused is None else paused
        )
        self._rebase()
        return self.pace

    def demand(self, budget: Budget) -> None:
        """Request steps, done as fast as possible; call it from jobs."""
        self._budgets.append(budget)

    def _run(self) -> None:
        self._rebase()
        while not self._closing:
            self.beats += 1
            self._drain()
            if self._budgets:
                self._spend(self._budgets[0])
            elif self.pace.paused or self._simulation.fault is not None:
                self._stand_still()
            else:
                self._keep_pace()

    def _drain(self) -> None:
        self._wake.clear()
        while self._jobs and not self._closing:
            job = self._jobs.popleft()
            if not job.is_wanted():
                continue
            try:
                result = job.run(self._simulation)
            except Exception as error:
                job.done(None, error)
            else:
                job.done(result, None)

    def _stand_still(self) -> None:
        self.measured = 0.0
        self._on_idle()
        self._wake.wait(_IDLE)
        self._rebase()

    def _spend(self, budget: Budget) -> None:
        """Do requested steps until a job is pending or all are done."""
        simulation = self._simulation
        until = time.perf_counter() + _SLICE
        while budget.left > 0 and simulation.fault is None and not self._jobs:
            simulation.step()
            budget.left -= 1
            if time.perf_counter() > until:
                break
        over = budget.left <= 0 or simulation.fault is not None
        if over:
            self._budgets.popleft()
        if over or simulation.elapsed >= self._next_tick:
            self._tick()
        if over:
            budget.done()
            self._rebase()

    def _keep_pace(self) -> None:
        simulation, factor = self._simulation, self.pace.factor
        wall, elapsed = self._from
        now = time.perf_counter()
        behind = (now - wall) * factor - (simulation.elapsed - elapsed)
        if behind > _LATE * factor:
            # The process was suspended, or the machine is too slow: the robot must not rush on to
            # catch up before it sees pending commands.
            self._from = (now, simulation.elapsed)
            behind = simulation.dt
        until = now + _SLICE
        while behind >= simulation.dt and simulation.fault is None and not self._jobs:
            simulation.step()
            behind -= simulation.dt
            if simulation.elapsed >= self._next_tick:
                self._tick()
            if time.perf_counter() > until:
                break
        if simulation.fault is not None or time.perf_counter() >= self._tick_by:
            self._tick()
        elif behind < simulation.dt:
            self._wake.wait(_SLICE)  # several steps at once: waking up costs more than one

    def _tick(self) -> None:
        simulation, now = self._simulation, time.perf_counter()
        self._tick_by = now + _OVERDUE / self._rate
        period = max(simulation.dt, self.pace.factor / self._rate)
        self._next_tick += period
        if not simulation.elapsed < self._next_tick <= simulation.elapsed + period:
            self._next_tick = simulation.elapsed + period
        wall, elapsed = self._since
        if now - wall >= _MEASURED:
            self.measured = (simulation.elapsed - elapsed) / (now - wall)
            self._since = (now, simulation.elapsed)
        self._on_tick()

    def _rebase(self) -> None:
        now = time.perf_counter()
        self._from = self._since = (now, self._simulation.elapsed)
