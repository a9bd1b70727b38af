"""Simulated drives on a real bus, and the bench that runs several in one thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Self

from rcp_can.sim.plant import Plant

if TYPE_CHECKING:
    import can

__all__ = ["Bench", "Twin"]

_TICK = 0.005  # s
_BURST = 100  # frames received between two ticks, however late


class Twin:
    """A simulated drive; each profile has a subclass. Everything runs in the bench's thread."""

    def __init__(self, node: int, plant: Plant | None = None, **options: Any) -> None:
        self.node, self.options = node, options
        self.plant = plant or Plant()
        self.enabled = False
        self.silent = False
        """Neither receives nor sends: unplugged."""
        self.deaf = False
        """Sends its measurements, but receives nothing."""
        self.heartless = False
        """Sends no heartbeats, if it has any; everything else continues."""
        self.blind = False
        """Sends no position and no velocity; everything else continues."""
        self.refuses = False
        """Cannot be switched on."""
        self.keeps_zero = False
        """Does not take a new zero, and does not say so."""
        self.send: Callable[..., None] = _nowhere
        self.commands: list[tuple[str, float]] = []
        """The last accepted set-points as (mode, value); at most a hundred."""
        self._due: dict[str, float] = {}
        self._commanded = time.monotonic()

    def feed(self) -> None:
        """Restart its watchdog."""
        self._commanded = time.monotonic()

    def is_quiet(self, seconds: float) -> bool:
        """Return whether its watchdog was not fed for `seconds`."""
        return time.monotonic() - self._commanded > seconds

    def take(self, message: can.Message) -> None:
        """Handle a frame from the bus."""
        raise NotImplementedError

    def tick(self, now: float) -> None:
        """Send whatever is due."""

    def boot(self) -> None:
        """Reboot, as after a loss of supply: switched off, without set-points."""
        self.enabled = False
        self.plant.off()

    def break_down(self) -> None:
        """Enter a fault that switches it off."""
        self.enabled = False
        self.plant.off()

    def took(self, mode: str, value: float) -> None:
        """Record an accepted set-point."""
        self.commands.append((mode, value))
        del self.commands[:-100]

    def every(self, what: str, period: float, now: float) -> bool:
        """Return whether a periodic message is due."""
        due = self._due.get(what, now)
        if now < due:
            return False
        self._due[what] = max(due + period, now)
        return True


def _nowhere(*_: Any, **__: Any) -> None:
    """Drop a frame: the twin is not on a bus yet."""


class Bench:
    """Runs twins on a bus, in its own thread, while entered.

    As in `with Bench(can.Bus("demo", "virtual"), [OdriveTwin(1)]): …`.
    """

    def __init__(self, bus: can.BusABC, twins: Sequence[Twin], *, tick: float = _TICK) -> None:
        self.bus, self.twins = bus, list(twins)
        self._tick = tick
        self._stopping = False
        self._orders: list[Callable[[], object]] = []
        self.loses: Callable[[], object] | None = None
        """Called for each frame in either direction; returns whether the bus loses it."""
        for twin in twins:
            twin.send = self._send
        self._thread = threading.Thread(target=self._run, name="can twins", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping = True
        self._thread.join(5)
        self.bus.shutdown()

    def order(self, function: Callable[[], object]) -> None:
        """Call a function in the bench's thread, such as a fault or a push at the shaft."""
        self._orders.append(function)

    def _send(self, identifier: int, data: bytes = b"", **more: Any) -> None:
        import can

        if self.loses is not None and self.loses():
            return
        more.setdefault("is_extended_id", False)
        self.bus.send(can.Message(arbitration_id=identifier, data=data, **more), timeout=0.1)

    def _run(self) -> None:
        last = time.monotonic()
        due = last
        while not self._stopping:
            now = time.monotonic()
            if now < due:
                self._receive(due - now)
                continue
            due = max(due + self._tick, now)
            while self._orders:
                self._orders.pop(0)()
            for twin in self.twins:
                twin.plant.advance(min(now - last, 0.2))
                if not twin.silent:
                    twin.tick(now)
            last = now
            for _ in range(_BURST):  # also if there is no time left until the next tick
                if not self._receive(0.0):
                    break

    def _receive(self, timeout: float) -> bool:
        message = self.bus.recv(timeout)
        if message is not None:
            self._give(message)
        return message is not None

    def _give(self, message: can.Message) -> None:
        if message.is_error_frame or (self.loses is not None and self.loses()):
            return
        for twin in self.twins:
            if not twin.silent and not twin.deaf:
                twin.take(message)
