"""One vehicle as known from its messages: the latest of each, its state, and who waits for them."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any, NamedTuple

from rcp_kernel.errors import AdapterUnavailable
from rcp_links import Lateness
from rcp_mavlink.dialect import Dialect
from rcp_mavlink.duplicates import Duplicates
from rcp_mavlink.flightmodes import Family, family
from rcp_mavlink.frames import Frame
from rcp_protocol.timeouts import timeout

__all__ = ["Fix", "Text", "Vehicle"]

_ARMED = 128
_PREARM = 1 << 28
_BYTEWISE, _C_CAST = 1 << 4, 1 << 17
_TEXTS = 50
_PARTS = 32  # maximum number of components kept per system
_STAMPED = frozenset({"GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "ATTITUDE"})
"""Messages that start with their time of measurement."""
_LANDED, _IN_AIR = 1, (2, 3, 4)
_ON_ROTORS = (2, 3)  # MAV_VTOL_STATE: transition to multicopter, multicopter


class Text(NamedTuple):
    """A STATUSTEXT."""

    at: float
    severity: int
    text: str


class Fix(NamedTuple):
    """Position and motion."""

    lat: float  # deg
    lon: float  # deg
    height: float  # m above home
    above_sea: float  # m
    speed: float  # m/s, horizontal and vertical combined


class Vehicle:
    """Stores the latest frames and wakes waiters."""

    def __init__(self, dialect: Dialect, system: int, component: int) -> None:
        self.dialect = dialect
        self.system, self.component = system, component
        self.family: Family = family(0, 0)
        self.latest: dict[str, Frame] = {}
        self.received_at: dict[str, float] = {}
        """Arrival time of the latest of each message, on the monotonic clock."""
        self.measured_at: dict[str, float] = {}
        """When the latest of each stamped message was measured, on the monotonic clock: before it
        arrived if that took longer than usual."""
        self._stamps: dict[str, bytes] = {}
        self._lateness = Lateness()
        self._duplicates: Duplicates | None = None
        self.last_message_at = time.monotonic()
        self.routes: dict[tuple[int, Any], tuple[Any, Any, float]] = {}
        """Links and addresses that it uses, with the time of the last frame."""
        self.texts: deque[Text] = deque(maxlen=_TEXTS)
        self.mode_number = 0
        self.armed = False
        self.lost = False
        self.away_until = 0.0
        """Until when its silence is no loss, on the monotonic clock: it restarts."""
        self.on_frame: list[Callable[[Frame], None]] = []
        self.taps: list[Callable[[Frame], None]] = []
        """Hear every frame, those of other components on board too."""
        self.on_text: list[Callable[[Text], None]] = []
        self.components: dict[int, int] = {}
        """Other components on board: component ids with their MAV_TYPE."""
        self._eavesdroppers: dict[int, list[Callable[[Frame], None]]] = {}
        self._listeners: dict[int, list[Callable[[Frame], None]]] = {}
        self._waiters: list[tuple[Callable[[], bool], asyncio.Future[None]]] = []

    # Receiving

    def take(self, frame: Frame, now: float) -> None:
        """Handle a frame of its autopilot; `now` is monotonic."""
        definition = frame.definition
        name, number = definition.name, definition.id
        if number == 0 and not self._is_own(frame, now):
            return
        self.latest[name] = frame
        self.last_message_at = now
        if not self._is_repeated(name, frame):
            self.received_at[name] = now
            if name in _STAMPED:
                self.measured_at[name] = self._measured(name, frame, now)
        if number == 0:
            self._heartbeat(frame)
        listeners = self._listeners.get(number)
        if listeners:
            for listener in list(listeners):
                listener(frame)
        for callback in self.on_frame:
            callback(frame)
        if self._waiters:
            self._poll()

    def _is_repeated(self, name: str, frame: Frame) -> bool:
        """Return whether a position repeats the previous one, by the vehicle's time stamp.

        The repeated messages of a hung process are as old as their measurement. Some vehicles
        leave the stamp at 0.
        """
        if name not in _STAMPED:
            return False
        stamp, before = frame.payload[:4], self._stamps.get(name)
        self._stamps[name] = stamp
        return stamp == before and any(stamp)

    def _measured(self, name: str, frame: Frame, now: float) -> float:
        """Return when a stamped message that arrives now was measured."""
        ticks = int.from_bytes(frame.payload[:4], "little")  # ms since boot
        if ticks and self._duplicates is not None:
            self._duplicates.take_clock(name, now - ticks / 1e3, now)
        return now - self._lateness.of(now - ticks / 1e3, now) if ticks else now

    def _is_own(self, frame: Frame, now: float) -> bool:
        """Return whether a heartbeat is not of another vehicle with the same system id."""
        beat = frame.fields()
        kind = (beat["autopilot"], beat["type"])
        if self._duplicates is None:
            self._duplicates = Duplicates(kind, now)
        return self._duplicates.is_own(kind, now)

    @property
    def duplicated(self) -> bool:
        """Whether another vehicle with its system id was heard lately."""
        return self._duplicates is not None and self._duplicates.seen(time.monotonic())

    @property
    def may_be_armed(self) -> bool:
        """Whether it is armed, or another vehicle with its system id may be what says it is not."""
        return self.armed or self.duplicated

    def overhear(self, frame: Frame) -> None:
        """Handle a frame of another component on board, such as a camera or gimbal."""
        number = frame.definition.id
        if number == 0 and (frame.component in self.components or len(self.components) < _PARTS):
            self.components[frame.component] = frame.fields()["type"]
        listeners = self._eavesdroppers.get(number)
        if listeners:
            for listener in list(listeners):
                listener(frame)
            self._poll()

    def _heartbeat(self, frame: Frame) -> None:
        beat = frame.fields()
        self.family = family(beat["autopilot"], beat["type"])
        self.mode_number = beat["custom_mode"]
        self.armed = bool(beat["base_mode"] & _ARMED)

    @contextmanager
    def listening(
        self, name: str, listener: Callable[[Frame], None], *, anybody: bool = False
    ) -> Generator[None]:
        """Call `listener` with each frame of a message while entered, if the dialect has it.

        `anybody` includes every component on board, not only the autopilot.
        """
        definition = self.dialect.by_name.get(name)
        number = -1 if definition is None else definition.id
        tables = [self._listeners, self._eavesdroppers] if anybody else [self._listeners]
        for table in tables:
            table.setdefault(number, []).append(listener)
        try:
            yield
        finally:
            for table in tables:
                table[number].remove(listener)

    # State

    @property
    def mode(self) -> str:
        """The name of its mode."""
        return self.family.word(self.mode_number)

    @property
    def landed(self) -> bool | None:
        """Whether it is on the ground; None if it has not reported that or cannot fly."""
        if self.family.drives:
            return None
        frame = self.latest.get("EXTENDED_SYS_STATE")
        state = 0 if frame is None else frame.fields()["landed_state"]
        return True if state == _LANDED else False if state in _IN_AIR else None

    @property
    def hovering(self) -> bool:
        """Whether a VTOL flies as a multicopter now."""
        frame = self.latest.get("EXTENDED_SYS_STATE")
        return frame is not None and frame.fields()["vtol_state"] in _ON_ROTORS

    @property
    def prearm(self) -> bool | None:
        """Whether its own checks allow arming; None if it has not reported that."""
        frame = self.latest.get("SYS_STATUS")
        if frame is None:
            return None
        fields = frame.fields()
        if not fields["onboard_control_sensors_present"] & _PREARM:
            return None
        return bool(fields["onboard_control_sensors_health"] & _PREARM)

    @property
    def bytewise(self) -> bool:
        """Whether it encodes integer parameters bytewise into the float, as PX4 does."""
        frame = self.latest.get("AUTOPILOT_VERSION")
        can = 0 if frame is None else frame.fields()["capabilities"]
        return bool(can & _BYTEWISE) or (self.family.px4 and not can & _C_CAST)

    @property
    def fix(self) -> Fix | None:
        """Position and motion; None if it has no position."""
        frame = self.latest.get("GLOBAL_POSITION_INT")
        if frame is None:
            return None
        f = frame.fields()
        if f["lat"] == 0 and f["lon"] == 0:
            return None
        speed = (f["vx"] ** 2 + f["vy"] ** 2 + f["vz"] ** 2) ** 0.5 / 100
        return Fix(f["lat"] / 1e7, f["lon"] / 1e7, f["relative_alt"] / 1e3, f["alt"] / 1e3, speed)

    @property
    def home(self) -> tuple[float, float, float] | None:
        """Latitude, longitude (deg) and height above sea level (m) of home."""
        frame = self.latest.get("HOME_POSITION")
        if frame is None:
            return None
        f = frame.fields()
        return f["latitude"] / 1e7, f["longitude"] / 1e7, f["altitude"] / 1e3

    def texts_since(self, at: float, *, severity: int = 5) -> list[str]:
        """List its texts since a time, of at least that severity."""
        return [t.text for t in self.texts if t.at >= at and t.severity <= severity]

    # Waiting

    def check(self) -> None:
        """Check that it is connected.

        :raises AdapterUnavailable: it is lost.
        """
        if self.lost:
            raise AdapterUnavailable(f"no message from vehicle {self.system}")

    async def until(self, holds: Callable[[], bool], seconds: float | None = None) -> bool:
        """Wait until a condition holds, checked at each frame; return whether it does.

        :raises AdapterUnavailable: the vehicle was lost meanwhile.
        """
        self.check()
        if holds():
            return True
        waiter: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        entry = (holds, waiter)
        self._waiters.append(entry)
        try:
            async with timeout(seconds):
                await waiter
        except TimeoutError:
            return False
        finally:
            if entry in self._waiters:
                self._waiters.remove(entry)
        return True

    def _poll(self) -> None:
        for holds, waiter in self._waiters:
            if not waiter.done() and holds():
                waiter.set_result(None)

    def lose(self, why: str) -> None:
        """Mark the vehicle as lost."""
        self.lost = True
        for _, waiter in self._waiters:
            if not waiter.done():
                waiter.set_exception(AdapterUnavailable(why))
