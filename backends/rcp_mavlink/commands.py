"""Commands: sent until acknowledged; a refusal carries its result and the vehicle's reasons."""

from __future__ import annotations

import asyncio
import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import msgspec

from rcp_kernel.errors import (
    AdapterUnavailable,
    DeviceRejected,
    DeviceTimeout,
    NotImplementedByRobot,
    RcpError,
)
from rcp_kernel.spi import check_fence
from rcp_mavlink.cancelling import cancel_message
from rcp_mavlink.flightmodes import Family
from rcp_mavlink.frames import Frame
from rcp_mavlink.hub import Hub
from rcp_mavlink.refusals import silent_reason
from rcp_mavlink.vehicle import Vehicle
from rcp_protocol.timeouts import timeout

__all__ = ["Command", "Commands", "mode_command"]

_ACCEPTED, _BUSY, _UNSUPPORTED, _RUNNING = 0, 1, 3, 5
_LONG_ONLY, _INT_ONLY = 7, 8
_WORDS = {
    1: "temporarily rejected", 2: "denied", 3: "unsupported", 4: "failed", 6: "cancelled",
    7: "accepted as COMMAND_LONG only", 8: "accepted as COMMAND_INT only", 9: "unsupported frame",
    10: "not in control",
}  # fmt: skip
_PATIENCE = 30.0  # s without an update after which a command in progress times out
_LOOK = 1.0  # s between two checks of the link meanwhile
_LAST_WORDS = 0.15  # s within which the reason may follow the refusal
_RELATIVE = 6
_REMEDY = "Fix what the vehicle reports and try again; sensor/prearm shows whether it can be armed."
_WRONG_MODE = "mode not armable"
_NO_REASON = "The vehicle gave no reason; check sensor/mode, sensor/health and event/statustext."
_QUESTIONS = frozenset({401, 510, 511, 512})
"""Commands that only request messages or reasons; they do not move the vehicle."""


class Command(msgspec.Struct, frozen=True):
    """One command, with a position if it has one."""

    number: int
    params: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    x: float = 0.0
    """Latitude in degrees, or the fifth parameter."""
    y: float = 0.0
    z: float = 0.0
    frame: int = _RELATIVE
    place: bool = False
    """Whether `x` and `y` are degrees."""
    whole: bool = False
    """Whether to send it as COMMAND_INT at once."""
    component: int | None = None
    """Target component; None is the autopilot."""


def mode_command(family: Family, mode: str) -> Command:
    """Return DO_SET_MODE for a mode of a family.

    :raises NotImplementedByRobot: the family does not have the mode.
    """
    number = family.number(mode)
    if number is None:
        raise NotImplementedByRobot(f"a {family.kind} has no mode {mode or 'for that'}")
    if family.px4:
        return Command(176, (1.0, float(number >> 16 & 0xFF), float(number >> 24 & 0xFF), 0.0))
    return Command(176, (1.0, float(number), 0.0, 0.0))


class Commands:
    """Sends the commands of one vehicle; commands with the same number are serialized."""

    def __init__(self, hub: Hub, vehicle: Vehicle) -> None:
        self._hub, self._vehicle = hub, vehicle
        self._turns: dict[int, asyncio.Lock] = defaultdict(asyncio.Lock)
        self._orphans: dict[int, tuple[int, float]] = {}
        """Commands with replies that may still arrive: how many, and until when."""

    async def send(
        self,
        command: Command,
        what: str,
        progress: Callable[[float | None], None] | None = None,
        *,
        urgent: bool = False,
    ) -> None:
        """Send a command and wait until it is accepted; completion must be observed separately.

        An urgent one, which brings something to rest, has room on a full link.

        :raises DeviceRejected: the vehicle refuses it.
        :raises DeviceTimeout: the vehicle does not respond.
        :raises EstopActive: the vehicle was stopped after the request.
        """
        self._vehicle.check()
        started = time.monotonic()
        async with self._turns[command.number]:
            try:
                result = await self._request(
                    command, what, progress, whole=command.whole, urgent=urgent
                )
            except AdapterUnavailable as lost:  # the vehicle may have received and executed it
                raise DeviceTimeout(f"{what}: {lost}, and it had not responded") from None
            other = not command.whole and _fits(command)
            if result in (_UNSUPPORTED, _INT_ONLY) and other:
                again = await self._request(command, what, progress, whole=True, urgent=urgent)
                result = result if again == _UNSUPPORTED and result == _UNSUPPORTED else again
            elif result == _LONG_ONLY and command.whole:
                result = await self._request(command, what, progress, whole=False, urgent=urgent)
        if result != _ACCEPTED:
            await self._refuse(command, what, result, started)

    def send_once(self, command: Command, *, urgent: bool = False) -> None:
        """Send a command once, without waiting for a reply; an urgent one has room on a full link.

        :raises EstopActive: the vehicle was stopped after the request.
        """
        _check_fence(command)
        message = self._message(command, 0, whole=command.whole)
        self._hub.send(self._vehicle, message, urgent=urgent)

    async def _request(
        self,
        command: Command,
        what: str,
        progress: Callable[[float | None], None] | None,
        *,
        whole: bool,
        urgent: bool,
    ) -> int:
        """Send it until it is acknowledged; return the MAV_RESULT."""
        answers: asyncio.Queue[tuple[int, int]] = asyncio.Queue()
        to = self._vehicle.component if command.component is None else command.component

        def take(frame: Frame) -> None:
            if frame.component != to:
                return
            ack = frame.fields()
            if ack["command"] == command.number and self._hub.is_target(ack):
                answers.put_nowait((ack["result"], ack.get("progress", 255)))

        config = self._hub.config
        with self._vehicle.listening("COMMAND_ACK", take, anybody=True):
            first = self._message(command, 0, whole=whole) if urgent else None
            await self._let_pass(command, answers, first)
            running, attempt = False, 0
            try:
                while attempt <= config.retries and not running:  # one in progress would begin anew
                    self._vehicle.check()
                    _check_fence(command)
                    message = self._message(command, attempt, whole=whole)
                    self._hub.send(self._vehicle, message, urgent=urgent)
                    attempt, wait = attempt + 1, config.timeout
                    self._expect(command.number, attempt)
                    while (answer := await self._answer(answers, wait)) is not None:
                        result, part = answer
                        if result != _RUNNING:
                            asks = command.number in _QUESTIONS  # whichever it answers, it comes
                            self._expect(command.number, 0 if asks else attempt - 1)
                            return result
                        wait, running = _PATIENCE, True
                        if progress is not None:
                            progress(part / 100 if part <= 100 else None)
            except asyncio.CancelledError:
                if running:
                    self._cancel(command.number, to)
                raise
        self._vehicle.check()
        if running:
            self._expect(command.number, 1)
            raise DeviceTimeout(
                f"{what}: the vehicle began it, and has told nothing for {_PATIENCE:g} s",
                remedy="It may still go on: see its telemetry before you send it again.",
            )
        raise DeviceTimeout(f"{what}: the vehicle did not respond")

    def _expect(self, number: int, count: int) -> None:
        """Note that replies to what was sent may still arrive."""
        self._orphans[number] = (count, time.monotonic() + self._hub.config.timeout)

    async def _let_pass(
        self, command: Command, answers: asyncio.Queue[tuple[int, int]], urgently: Any
    ) -> None:
        """Wait for late replies: they would be mistaken for those to the next command.

        What brings to rest does not wait: the message `urgently` is sent at once, and again later.
        """
        count, until = self._orphans.get(command.number, (0, 0.0))
        left = until - time.monotonic()
        if urgently is not None and count and left > 0:
            _check_fence(command)
            self._hub.send(self._vehicle, urgently, urgent=True)
            count += 1
        with suppress(TimeoutError):
            async with timeout(left):
                while count:
                    self._orphans[command.number] = count, until  # if it is cancelled here
                    result, _ = await answers.get()
                    count -= result != _RUNNING
        self._orphans.pop(command.number, None)

    async def _answer(
        self, answers: asyncio.Queue[tuple[int, int]], seconds: float
    ) -> tuple[int, int] | None:
        """Return the next answer; None if there is none in time.

        :raises AdapterUnavailable: the vehicle is lost meanwhile.
        """
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            with suppress(TimeoutError):
                async with timeout(min(left, _LOOK)):
                    return await answers.get()
            self._vehicle.check()
        return None

    def _cancel(self, number: int, component: int) -> None:
        """Tell the vehicle, once, to end a command in progress; many do not know the message."""
        self._expect(number, 1)
        module, system = self._hub.dialect.module, self._vehicle.system
        with suppress(RcpError, OSError):
            message = cancel_message(module, (system, component), number)
            self._hub.send(self._vehicle, message, urgent=True)

    def _message(self, c: Command, attempt: int, *, whole: bool) -> Any:
        module, vehicle = self._hub.dialect.module, self._vehicle
        to = (vehicle.system, vehicle.component if c.component is None else c.component)
        if not whole:
            return module.MAVLink_command_long_message(
                *to, c.number, attempt, *c.params, c.x, c.y, c.z
            )
        scale = 1e7 if c.place else 1.0
        return module.MAVLink_command_int_message(
            *to, c.frame, c.number, 0, 0, *c.params, round(c.x * scale), round(c.y * scale), c.z
        )

    async def _refuse(self, command: Command, what: str, result: int, started: float) -> None:
        words = _WORDS.get(result, f"result {result}")
        if not self._vehicle.texts_since(started):
            await asyncio.sleep(_LAST_WORDS)
        reasons = self._vehicle.texts_since(started)
        unsaid = silent_reason(self._vehicle, command.number, command.params[0])
        why = [*reasons, *([] if unsaid is None else [unsaid.reason])]
        reason = f": {'; '.join(why)}" if why else ""
        remedy = _REMEDY if reasons else _NO_REASON
        if any(text.endswith(_WRONG_MODE) for text in reasons):
            remedy = f"Set mode {self._vehicle.family.guided} with action/set_mode first."
        raise DeviceRejected(
            f"{what}: {words}{reason}",
            remedy=remedy if unsaid is None else unsaid.remedy,
            retry_after=1.0 if result == _BUSY else None,
            details={"result": words, "texts": reasons},
        )


def _fits(c: Command) -> bool:
    """Tell whether COMMAND_INT, which has `x` and `y` as whole numbers, can carry a command."""
    return c.place or all(float(v).is_integer() and abs(v) < 2**31 for v in (c.x, c.y))


def _check_fence(command: Command) -> None:
    if command.number not in _QUESTIONS:
        check_fence()
