"""A CAN bus that recovers from bus-off and interface loss, counts frames and routes them."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar, cast

import anyio
import structlog

from rcp_can import messages as m
from rcp_can.condition import read_error
from rcp_can.config import BusConfig
from rcp_can.health import Health
from rcp_can.interface import open_interface
from rcp_can.load import seconds_on_the_bus
from rcp_can.routing import Listener, Route, RoutingTable
from rcp_can.wire import Wire
from rcp_kernel.errors import AdapterUnavailable, QueueFull
from rcp_kernel.spi import Host
from rcp_links import Lateness

if TYPE_CHECKING:
    import can

__all__ = ["Bus", "Listener", "Route"]

_T = TypeVar("_T")
log = structlog.get_logger("rcp.can")

_LONGEST = 5.0  # s between two attempts to restart
_WELL = 10.0  # s of operation after which the restart delay begins anew
_QUEUED = 50.0  # s a frame may wait to be read; some adapters' clocks begin again each minute
_TOLD = 64  # identifiers whose frames could not be taken that are told
_ECHOING = frozenset(("udp_multicast",))  # interfaces that deliver our own frames to us


class Bus:
    """One CAN bus of the configuration."""

    def __init__(self, name: str, config: BusConfig, host: Host, health: Health) -> None:
        self.name, self.config = name, config
        self.state: m.Condition = "down"
        self.reported_state = m.BusState(state="down", detail="not open yet")
        self.restarts = self.error_frames = self.malformed = self.refused = 0
        self.on_state: list[Callable[[m.Condition, m.Condition], None]] = []
        """Called with each change: the old state, the new state."""
        self.taps: list[Callable[[can.Message], None]] = []
        """Called with every frame, including error frames and our own."""
        self._host, self.health = host, health
        self._prefix = f"can/{name}"
        self.wire: Wire | None = None
        """The open interface, while there is one."""
        self._lost = asyncio.Event()
        self._reason = ""
        self.routing = RoutingTable()
        """Who takes its frames."""
        self.listen, self.overheard = self.routing.listen, self.routing.overheard
        self._lateness = Lateness(_QUEUED)
        self._after_batch: list[Callable[[], None]] = []
        self._failures: set[str] = set()
        self._busy = 0.0
        self._past = {"rx": 0, "tx": 0, "dropped": 0, "expired": 0, "failed": 0}
        self._message: Any = None
        self._done: dict[str, float] = {}
        self._counters: tuple[int | None, int | None] = (None, None)
        self._shared: dict[type, object] = {}

    def shared(self, kind: type[_T], make: Callable[[Bus], _T]) -> _T:
        """Return the one object of a kind that all devices of this bus share."""
        if kind not in self._shared:
            self._shared[kind] = make(self)
        return cast("_T", self._shared[kind])

    def received_at(self, message: can.Message) -> float:
        """Return the monotonic time when the interface received a frame, by its stamp if any.

        Frames wait in the interface while the gateway is stalled. Most stamps are of this machine's
        wall clock, which may be set; those of some adapters' own clocks begin anywhere.
        """
        now = time.monotonic()
        if not message.timestamp:
            return now
        return now - self._lateness.of(time.time() - message.timestamp, now)

    def after_batch(self, function: Callable[[], None]) -> None:
        """Call a function after each batch of frames."""
        self._after_batch.append(function)

    @property
    def up(self) -> bool:
        """Whether frames can be sent."""
        return self.wire is not None and self.state != "bus_off"

    @property
    def lag(self) -> float:
        """Seconds since the interface accepted a frame, while frames are queued."""
        wire = self.wire
        return 0.0 if wire is None else wire.lag

    @property
    def refusing(self) -> bool:
        """Whether the interface is what frames wait for, and not the gateway's own thread."""
        return self.wire is not None and self.wire.refusing

    def send(
        self,
        identifier: int,
        data: bytes = b"",
        *,
        extended: bool = False,
        remote: bool = False,
        length: int | None = None,
        fd: bool = False,
        switched: bool = False,
        lifetime: float | None = None,
        urgent: bool = False,
        sender: Hashable = None,
    ) -> None:
        """Queue one frame; an urgent one invalidates the queued frames of its sender.

        :raises AdapterUnavailable: the bus is down, or off.
        :raises QueueFull: the send queue is full.
        """
        wire = self._open_wire()
        message = self._message(
            arbitration_id=identifier,
            data=None if remote else data,
            dlc=length,
            is_extended_id=extended,
            is_remote_frame=remote,
            is_fd=fd,
            bitrate_switch=switched,
            is_rx=False,
        )
        self._queue(wire, (message,), lifetime=lifetime, urgent=urgent, sender=sender)

    def send_together(
        self,
        frames: Iterable[tuple[int, bytes]],
        *,
        fd: bool = False,
        switched: bool = False,
        lifetime: float | None = None,
        urgent: bool = False,
        sender: Hashable = None,
    ) -> None:
        """Queue extended frames one after the other, all or none; otherwise as `send`."""
        wire = self._open_wire()
        messages = [
            self._message(
                arbitration_id=identifier,
                data=data,
                is_extended_id=True,
                is_fd=fd,
                bitrate_switch=switched,
                is_rx=False,
            )
            for identifier, data in frames
        ]
        self._queue(wire, messages, lifetime=lifetime, urgent=urgent, sender=sender)

    def _queue(
        self,
        wire: Wire,
        messages: Sequence[can.Message],
        *,
        lifetime: float | None,
        urgent: bool,
        sender: Hashable,
    ) -> None:
        try:
            wire.send_together(messages, lifetime=lifetime, urgent=urgent, sender=sender)
        except QueueFull:
            self.refused += 1
            raise
        for message in messages:
            self._busy += self.duration(message)
            for tap in self.taps:
                tap(message)

    def _open_wire(self) -> Wire:
        wire = self.wire
        if wire is None or self.state == "bus_off":
            raise AdapterUnavailable(f"CAN bus '{self.name}' is {self.state}: {self._reason}")
        return wire

    def paced(self, what: str, period: float) -> bool:
        """Return whether a periodic frame of the whole bus is due, and mark it as sent."""
        now = time.monotonic()
        if now < self._done.get(what, float("-inf")) + period:
            return False
        self._done[what] = now
        return True

    async def run(self, ready: asyncio.Event) -> None:
        """Keep the bus open until cancelled; `ready` is set when it first opens.

        :raises NotReady: the interface does not open at the first attempt.
        :raises ConfigError: the interface can never open with this configuration.
        """
        import can

        self._message = can.Message
        pause = self.config.restart
        first = True
        while True:
            try:
                bus = await open_interface(self.name, self.config)
            except Exception as error:
                if first:
                    raise
                self._reason = str(error)
            else:
                opened = time.monotonic()
                await self._live(bus, ready, restarted=not first)
                first = False
                if time.monotonic() - opened > _WELL:
                    pause = self.config.restart
            await asyncio.sleep(pause)
            pause = min(2 * pause, _LONGEST)

    async def _live(self, bus: can.BusABC, ready: asyncio.Event, *, restarted: bool) -> None:
        self._lost.clear()
        self._lateness = Lateness(_QUEUED)
        wire = Wire(
            bus,
            name=self.name,
            queue=self.config.queue,
            echoes=self.config.interface in _ECHOING,
            received=self._take,
            lost=self._lose,
        )
        self.wire = wire
        self._reason = ""
        self.restarts += restarted
        self._turn("error_active", "restarted" if restarted else "open")
        ready.set()
        try:
            await self._lost.wait()
        finally:
            self.wire = None
            if not self._lost.is_set():  # nobody is told: it is not lost
                self.state, self._reason = "down", "the gateway closes it"
            for key in self._past:
                self._past[key] += getattr(wire, key)
            with anyio.CancelScope(shield=True):
                await wire.close()

    def _lose(self, reason: str) -> None:
        self._reason = reason
        self._turn("down", reason)
        self._lost.set()

    def _turn(self, state: m.Condition, text: str) -> None:
        was, self.state = self.state, state
        tx, rx = self._counters
        self.reported_state = m.BusState(state=state, detail=text, tx_errors=tx, rx_errors=rx)
        self._host.publish(f"sensor/{self._prefix}/state", self.reported_state)
        if was == state:
            return
        event = m.BusEvent(was=was, now=state, text=text)
        self._host.publish(f"event/{self._prefix}/state", event)
        bad = state in ("bus_off", "down")
        self.health.report(
            self._prefix, f"CAN bus '{self.name}' is {state}: {text}" if bad else None
        )
        for callback in self.on_state:
            callback(was, state)

    # Receiving

    def _take(self, batch: list[can.Message]) -> None:
        listeners_of, taps = self.routing.listeners, self.taps
        for message in batch:
            self._busy += self.duration(message)
            for tap in taps:
                tap(message)
            if message.is_error_frame:
                self._error(message)
                continue
            for listener in listeners_of(message):
                try:
                    listener(message)
                except ValueError:
                    self.malformed += 1
                except Exception as error:  # of a profile: others take their frames all the same
                    self.malformed += 1
                    self._tell_failure(f"0x{message.arbitration_id:X}", error)
        for function in self._after_batch:
            try:
                function()
            except Exception as error:
                self._tell_failure(f"after a batch {id(function)}", error)

    def _tell_failure(self, what: str, error: Exception) -> None:
        """Log an error of whoever takes frames, once for each identifier."""
        if what not in self._failures and len(self._failures) < _TOLD:
            self._failures.add(what)
            log.error("frame_not_taken", bus=self.name, what=what, exc_info=error)

    def _error(self, message: can.Message) -> None:
        self.error_frames += 1
        state, tx, rx, detail = read_error(message.arbitration_id, bytes(message.data))
        if tx is not None:
            self._counters = tx, rx
        if state == "bus_off":
            self._reason = "the controller is bus-off"
            self._turn("bus_off", self._reason)
            self._lost.set()
        elif state is not None and self.wire is not None and state != self.state:
            self._turn(state, detail)  # type: ignore[arg-type]

    def duration(self, message: can.Message) -> float:
        """Return how long a frame occupies the bus, s; 0 without a bit rate."""
        bitrate = self.config.bitrate
        if bitrate is None:
            return 0.0
        return seconds_on_the_bus(
            len(message.data),
            extended=message.is_extended_id,
            fd=message.is_fd,
            switched=message.bitrate_switch,
            bitrate=bitrate,
            data_bitrate=self.config.data_bitrate or bitrate,
        )

    # Statistics

    async def count(self) -> None:
        """Publish statistics at their period until cancelled."""
        moment, last = time.monotonic(), self.statistics()
        while True:
            await asyncio.sleep(self.config.statistics)
            now = time.monotonic()
            value = self.statistics(now - moment, last.rx, last.tx)
            self._report_losses(value, last)
            moment, last, self._busy = now, value, 0.0
            self._host.publish(f"sensor/{self._prefix}/statistics", value)

    def _report_losses(self, now: m.Statistics, before: m.Statistics) -> None:
        refused, expired = now.refused - before.refused, now.expired - before.expired
        losses = {
            "receive": (
                now.dropped - before.dropped,
                "not received in time: the gateway was too slow",
            ),
            "send": (refused + expired, "not sent in time: the bus or the gateway was too slow"),
        }
        for queue, (lost, text) in losses.items():
            if lost:
                many = "1 frame was" if lost == 1 else f"{lost} frames were"
                event = m.Overflow(queue=queue, lost=lost, text=f"{many} {text}")  # type: ignore[arg-type]
                self._host.publish(f"event/{self._prefix}/overflow", event)

    def statistics(self, period: float = 0.0, rx: int = 0, tx: int = 0) -> m.Statistics:
        """Compute the statistics; rates are since `rx` and `tx` were counted, `period` seconds ago."""
        wire = self.wire
        total = {key: n + (getattr(wire, key) if wire else 0) for key, n in self._past.items()}
        known = self.config.bitrate is not None and period
        return m.Statistics(
            load=self._busy / period if known else None,
            rx_rate=(total["rx"] - rx) / period if period else 0.0,
            tx_rate=(total["tx"] - tx) / period if period else 0.0,
            **total,
            error_frames=self.error_frames,
            malformed=self.malformed,
            refused=self.refused,
            queued=wire.waiting if wire else 0,
            restarts=self.restarts,
        )
