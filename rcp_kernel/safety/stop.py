"""The life of a stop: requested → commanded → confirmed at rest, and kept so while it is latched.

One state machine for every backend. A stop is confirmed by measurement only: the backend's `halt`
has returned since it was requested, and its `motion` says that the robot is at rest. A robot that
cannot be reached is never confirmed. Until it is, the stop is repeated; as long as an e-stop is
latched it is asserted again ten times a second, and a robot that moves again is stopped again and
raises an alarm. A robot's own gateway does so itself: it gets the stop again once a second, so that a
latched fleet does not take the hub's time.
"""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any, Literal

import structlog

from rcp_kernel.clock import iso, now
from rcp_kernel.contract.fence import unfenced
from rcp_kernel.errors import AdapterUnavailable, DeviceTimeout, RcpError
from rcp_kernel.safety.retry import retry_until_confirmed
from rcp_kernel.spi import MotionState
from rcp_kernel.tree.entry import RobotUnit

__all__ = ["Stop", "StopController", "StopPhase", "merged"]

log = structlog.get_logger("rcp.safety")
StopPhase = Literal["requested", "commanded", "confirmed"]
_NUMBER = re.compile(r"[-\d.]+")
_PERIOD = 0.1  # s between two assertions of a latched stop
_REMOTE_PERIODS = 10  # robots with their own gateway are asserted once per this many periods
_SPLIT_AFTER = 0.25  # s that halting a whole backend may take; then its robots are halted singly


StopRecorder = Callable[[RobotUnit, str, str | None], None]
"""Records that a robot's stop was `confirmed`, or that it `moves_again` and why; must not block."""


class Stop:
    """The stop of one robot: its progress, with times in ns since the epoch."""

    __slots__ = (
        "alarm",
        "attempts",
        "commanded",
        "confirmed",
        "confirmed_event",
        "detail",
        "halted",
        "released",
        "requested",
        "tasks",
        "unit",
    )

    def __init__(self, unit: RobotUnit) -> None:
        self.unit = unit
        self.requested = now()
        self.commanded: int | None = None
        """When the stop was first handed to a backend that could send it."""
        self.confirmed: int | None = None
        """Since when it is measured to be at rest."""
        self.detail: str | None = None
        """Why it is not confirmed."""
        self.alarm = False
        """Whether it has moved again after it had been confirmed."""
        self.confirmed_event = asyncio.Event()
        """Set while it is confirmed."""
        self.attempts = 0
        self.halted = False
        """Whether a `halt` has returned since the stop was requested, or since it moved again."""
        self.released = False
        """Whether the latch was reset: the stop is no longer repeated."""
        self.tasks: set[asyncio.Future[None]] = set()

    @property
    def phase(self) -> StopPhase:
        """Its progress: `commanded` once the backend was called, `confirmed` by measurement only."""
        if self.confirmed is not None:
            return "confirmed"
        return "requested" if self.commanded is None else "commanded"

    def plain(self) -> dict[str, Any]:
        """Describe it for `/system/estop`."""
        return {
            "state": self.phase,
            "requested": iso(self.requested),
            "commanded": None if self.commanded is None else iso(self.commanded),
            "confirmed": None if self.confirmed is None else iso(self.confirmed),
            "detail": self.detail,
            "alarm": self.alarm,
        }


class StopController:
    """All stops in progress or held."""

    def __init__(self, loop: asyncio.AbstractEventLoop, record: StopRecorder) -> None:
        self._loop = loop
        self._record = record
        self._stops: dict[RobotUnit, Stop] = {}
        self._timer: asyncio.TimerHandle | None = None
        self._turn = 0
        """Which of the robots with gateways of their own had their turn last."""
        self._watchers: list[Callable[[], None]] = []
        self.alarms = 0
        """Number of times a stopped robot has moved again."""

    def on_change(self, changed: Callable[[], None]) -> None:
        """Register a function to be called after every change of a stop's state."""
        self._watchers.append(changed)

    def of(self, unit: RobotUnit) -> Stop | None:
        """Return the stop of a robot, if there is one."""
        return self._stops.get(unit)

    # -- begin, continue, end ------------------------------------------------------------------

    def begin(self, units: Sequence[RobotUnit]) -> list[Stop]:
        """Stop robots now; return their stops. The backends are called before anything else runs."""
        stops = {unit: self._current_or_new(unit) for unit in units}
        for whole, together in merged(units).items():
            if len(together) == 1:
                self._halt(stops[together[0]])
            else:
                self._halt_together(whole, [stops[unit] for unit in together])
        self._schedule()
        return list(stops.values())

    def halt_unseen(self, whole: RobotUnit) -> None:
        """Halt all of a backend, in addition to its known robots; nothing waits for it."""
        with unfenced():
            task = self._loop.create_task(whole.halt())
        task.add_done_callback(_consume_outcome)

    def resume(self, unit: RobotUnit) -> None:
        """Stop a latched robot that is available again; the stop is sent within this call."""
        stop = self._current_or_new(unit)
        self._assert(stop)
        self._halt(stop)
        self._schedule()

    def again(self, units: Iterable[RobotUnit]) -> None:
        """Halt robots once more: cancelled work has ended, and may have sent something last."""
        for unit in units:
            stop = self._stops.get(unit)
            if stop is not None and unit.latch is not None:
                self._halt(stop)

    def has_partners(self, unit: RobotUnit) -> bool:
        """Return whether another backend of the same robot is stopped too."""
        return any(other.identity == unit.identity and other is not unit for other in self._stops)

    def end(self, units: Iterable[RobotUnit]) -> None:
        """Release robots whose latch was reset; a halt in progress ends by itself."""
        for unit in units:
            stop = self._stops.pop(unit, None)
            if stop is not None:
                stop.released = True
                unit.note_reset()
        self._changed()

    async def wait(self, stops: Sequence[Stop], seconds: float) -> list[Stop]:
        """Wait until all are confirmed, or the time is over; return those that are not."""
        waiting = [asyncio.ensure_future(stop.confirmed_event.wait()) for stop in stops]
        try:
            if waiting:
                await asyncio.wait(waiting, timeout=seconds)
        finally:
            for waiter in waiting:
                waiter.cancel()
        return [stop for stop in stops if stop.confirmed is None]

    def close(self) -> None:
        """Stop repeating; the backends are halted by their owner."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        for stop in list(self._stops.values()):
            self._drop(stop)

    def _drop(self, stop: Stop) -> None:
        """Stop repeating a stop that can no longer be sent."""
        del self._stops[stop.unit]
        stop.released = True
        for task in stop.tasks:
            task.cancel()

    # -- the halts -----------------------------------------------------------------------------

    def _current_or_new(self, unit: RobotUnit) -> Stop:
        """Return the stop in progress of a robot, or a new one to be confirmed."""
        old = self._stops.get(unit)
        if old is not None and old.confirmed is None:
            return old
        stop = self._stops[unit] = Stop(unit)
        if old is not None:
            old.released = True
            stop.alarm = old.alarm
        return stop

    def _halt(self, stop: Stop) -> None:
        """Halt at once, and again until it is confirmed."""
        if not stop.tasks:
            self._retry_halt(stop)
            return
        with unfenced():  # the repetition may be waiting between two calls
            task = self._loop.create_task(self._attempt(stop))
        task.add_done_callback(_consume_outcome)

    def _retry_halt(self, stop: Stop) -> None:
        unit = stop.unit
        task = retry_until_confirmed(
            partial(self._attempt, stop),
            "halt_failed",
            # Its link loses nothing: one call is enough while its gateway has not answered.
            again=_SPLIT_AFTER if unit.owner.has_gateways else None,
            backend=unit.name,
        )
        stop.tasks.add(task)
        task.add_done_callback(stop.tasks.discard)

    async def _attempt(self, stop: Stop) -> None:
        """Halt once; return when the robot is confirmed at rest."""
        if stop.released and stop.attempts:
            return
        stop.attempts += 1
        try:
            self._command(stop)
            number = stop.unit.stops
            await stop.unit.halt()
        except RcpError as error:
            self._unsent(stop, error)
            raise
        stop.halted = True
        stop.unit.loss.note_halt(number)
        self._judge(stop)
        if stop.confirmed is None and not stop.released:
            raise DeviceTimeout(f"{stop.unit.name} is not at rest: {stop.detail}")

    def _halt_together(self, whole: RobotUnit, stops: list[Stop]) -> None:
        """Halt all robots of a backend with one call; one by one if that fails or takes too long."""

        def alone() -> None:
            for stop in stops:
                self._retry_unconfirmed(stop)

        late = self._loop.call_later(_SPLIT_AFTER, alone)
        with unfenced():
            if whole.owner.has_gateways:  # each answers for itself, and none waits for the slowest
                for stop in stops:
                    task = self._loop.create_task(self._attempt(stop))
                    task.add_done_callback(partial(self._attempted, stop))
                return
            together = self._loop.create_task(self._attempt_together(whole, stops))
        together.add_done_callback(lambda _: (late.cancel(), alone()))

    def _attempted(self, stop: Stop, task: asyncio.Task[None]) -> None:
        _consume_outcome(task)
        self._retry_unconfirmed(stop)

    def _retry_unconfirmed(self, stop: Stop) -> None:
        if stop.confirmed is None and not stop.released and not stop.tasks:
            self._retry_halt(stop)

    async def _attempt_together(self, whole: RobotUnit, stops: list[Stop]) -> None:
        try:
            for stop in stops:
                stop.attempts += 1
                self._command(stop)
            numbers = [stop.unit.stops for stop in stops]
            await whole.halt()
        except Exception as error:  # whichever robot it was, each is halted alone next
            log.warning("halt_failed", backend=whole.name, error=repr(error))
            return
        for stop, number in zip(stops, numbers, strict=True):
            stop.halted = True
            stop.unit.loss.note_halt(number)
            self._judge(stop)

    def _command(self, stop: Stop) -> None:
        if stop.unit.backend is not None and stop.commanded is None:
            stop.commanded = now()
            self._changed()

    def _unsent(self, stop: Stop, error: RcpError) -> None:
        if isinstance(error, AdapterUnavailable):
            stop.commanded = None
        self._mark_unconfirmed(stop, error.message)

    # -- measurements --------------------------------------------------------------------------

    def _judge(self, stop: Stop) -> None:
        """Compare a stop with the robot's own measurements."""
        try:
            state = stop.unit.motion()
        except Exception as error:
            log.exception("motion_failed", backend=stop.unit.name)
            state = MotionState(None, f"its motion is unknown: {error!r}")
        if state is None:  # it measures nothing
            state = MotionState(True if stop.halted else None, stop.detail or "")
        if state.at_rest and stop.halted:
            self._confirm(stop)
            return
        if state.at_rest is None and stop.confirmed is not None and stop.unit.owner.closes:
            return  # it is releasing its devices at rest and no longer measures
        moves_again = stop.confirmed is not None and state.at_rest is False
        self._mark_unconfirmed(
            stop, state.detail or ("it moves" if state.at_rest is False else "unknown")
        )
        if moves_again:
            self._alarm(stop)

    def _confirm(self, stop: Stop) -> None:
        if stop.confirmed is not None:
            return
        stop.confirmed, stop.detail = now(), None
        stop.confirmed_event.set()
        self._record(stop.unit, "confirmed", None)
        self._changed()

    def _mark_unconfirmed(self, stop: Stop, detail: str) -> None:
        changed = stop.confirmed is not None or _without_numbers(detail) != _without_numbers(
            stop.detail
        )
        stop.detail = detail
        if stop.confirmed is not None:
            stop.confirmed, stop.halted = None, False
            stop.confirmed_event.clear()
            if not stop.tasks:
                self._retry_halt(stop)
        if changed:
            self._changed()

    def _alarm(self, stop: Stop) -> None:
        stop.alarm = True
        self.alarms += 1
        log.error("moves_under_estop", backend=stop.unit.name, detail=stop.detail)
        self._record(stop.unit, "moves_again", stop.detail)
        self._changed()

    # -- time ----------------------------------------------------------------------------------

    def _schedule(self) -> None:
        if self._timer is None and self._stops:
            with unfenced():
                self._timer = self._loop.call_later(_PERIOD, self._tick)

    def _tick(self) -> None:
        self._timer = None
        self._turn = (self._turn + 1) % _REMOTE_PERIODS
        for number, stop in enumerate(list(self._stops.values())):
            if stop.unit.owner.has_gateways and number % _REMOTE_PERIODS != self._turn:
                continue
            if stop.unit.latch is None:
                self.end([stop.unit])
            elif stop.unit.backend is None and stop.unit.owner.closes:
                self._drop(stop)
                self._changed()
            elif stop.unit.backend is None:
                self._mark_unconfirmed(stop, stop.unit.owner.unavailable().message)
            else:
                self._assert(stop)
                self._judge(stop)
        self._schedule()

    def _assert(self, stop: Stop) -> None:
        backend = stop.unit.backend
        if backend is None:
            return
        try:
            with unfenced():
                backend.hold_stop(stop.unit.robot)
        except Exception as error:
            log.warning("stop_not_asserted", backend=stop.unit.name, error=repr(error))

    def _changed(self) -> None:
        for changed in self._watchers:
            changed()


def _without_numbers(detail: str | None) -> str | None:
    """Remove the numbers from a reason: clients need not be notified when they change."""
    return None if detail is None else _NUMBER.sub("", detail)


def _consume_outcome(task: asyncio.Task[None]) -> None:
    """Retrieve the outcome of a call that is repeated anyway, so that asyncio does not report it."""
    if not task.cancelled():
        task.exception()


def merged(units: Iterable[RobotUnit]) -> dict[RobotUnit, list[RobotUnit]]:
    """Group robots by what stops them in one call: the whole backend where all of it is meant."""
    meant = dict.fromkeys(units)
    complete = {  # each backend is examined once: it may have thousands of robots
        whole
        for whole in {unit.whole for unit in meant}
        if whole in meant or meant.keys() >= set(whole.owner.units)
    }
    groups: dict[RobotUnit, list[RobotUnit]] = {}
    for unit in meant:
        groups.setdefault(unit.whole if unit.whole in complete else unit, []).append(unit)
    return groups
