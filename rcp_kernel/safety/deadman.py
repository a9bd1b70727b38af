"""The dead-man: what brings an actuator to rest when nobody commands it any more."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Any

import structlog

from rcp_kernel.contract.fence import unfenced
from rcp_kernel.errors import BadRequest
from rcp_kernel.safety.retry import retry_until_confirmed
from rcp_kernel.safety.safe_value import safe_value
from rcp_kernel.safety.shared_handle import Cancellable, Shared
from rcp_kernel.tree.entry import Entry
from rcp_kernel.wire import Request
from rcp_protocol.timeouts import timeout

__all__ = ["REPLY_GRACE", "Deadman"]

log = structlog.get_logger("rcp.safety")
_ESCALATE_AFTER = 0.25  # s without a safe value being accepted; then other backends are halted
REPLY_GRACE = 1.0  # s added to a write's validity while its reply is outstanding


class Deadman:
    """Writes the safe value when an actuator's last command expires, until the device accepts it."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        *,
        sending: Callable[[Entry, Any], None],
        at_rest: Callable[[Entry, Any], None],
        escalate: Callable[[Entry], list[asyncio.Task[None]]],
        note: Callable[[Entry, str], None],
    ) -> None:
        """Create the dead-man, which brings expired commands to rest.

        `sending` is called when a safe value is being sent; `at_rest` when it is in force, or the
        whole robot is brought to rest. `escalate` is called to stop the robot by other means while a
        safe value is not accepted, and returns the tasks. `note` records expired commands and
        accepted safe values.
        """
        self._loop = loop
        self._sending = sending
        self._at_rest = at_rest
        self._escalate = escalate
        self._note = note
        self._timers: dict[str, Cancellable] = {}
        self._stops: dict[str, Cancellable] = {}
        self._writes: dict[str, set[asyncio.Task[Any]]] = {}
        """Writes that the robot has not answered yet."""
        self.cancelling: dict[str, set[asyncio.Task[Any]]] = {}
        """Cancelled writes that have not ended yet: nothing may overtake them."""
        self.expired = 0
        """Number of expired commands."""
        self._closed = False

    def window(self, entry: Entry, request: Request) -> float | None:
        """Return for how many seconds a write is valid, or None without a limit.

        :raises BadRequest: `valid_for` was given for a path that has no safe value.
        """
        if request.valid_for is None:
            return entry.resource.valid_for
        if entry.resource.safe is None:
            raise BadRequest(
                f"{entry.path} has no safe value to apply after `valid_for`",
                path=entry.path,
                remedy="Omit `valid_for`, or use an actuator with a dead-man.",
            )
        return request.valid_for

    def begin_write(self, entry: Entry) -> asyncio.Task[Any]:
        """Register the current task as a writer of an entry, so that `cancel_pending` can cancel it.

        Return the task, to be passed to `end_write` when it has ended in any way.
        """
        task = asyncio.current_task(self._loop)  # without a loop, it costs a system call
        assert task is not None
        self._writes.setdefault(entry.path, set()).add(task)
        return task

    def end_write(self, entry: Entry, task: asyncio.Task[Any]) -> None:
        """Unregister a write that has ended."""
        writes = self._writes[entry.path]
        writes.discard(task)
        if not writes:
            del self._writes[entry.path]

    def cancel_writes(self, entry: Entry) -> list[asyncio.Task[Any]]:
        """Cancel the commands of an entry whose robot is brought to rest as a whole.

        Return the cancelled writes that have not ended yet.
        """
        self.cancel_pending(entry)
        self._at_rest(entry, safe_value(entry))
        return list(self.cancelling.get(entry.path, ()))

    def stop(self, entry: Entry) -> None:
        """Bring an actuator to rest immediately, whatever is in force or in flight."""
        self.cancel_pending(entry)
        self._start(entry)

    def _start(self, entry: Entry) -> None:
        with unfenced():  # a write to another actuator may have started it
            task = self._loop.create_task(self._stop(entry), name=f"dead-man {entry.path}")
        self._stops[entry.path] = task
        helping: list[asyncio.Task[None]] = []
        late = self._loop.call_later(_ESCALATE_AFTER, lambda: helping.extend(self._escalate(entry)))

        def forget(done: asyncio.Task[None]) -> None:
            late.cancel()
            for helper in helping:
                helper.cancel()
            if self._stops.get(entry.path) is done:
                del self._stops[entry.path]

        task.add_done_callback(forget)

    def cancel_pending(self, entry: Entry) -> None:
        """Cancel every pending write to an entry, and discard its window."""
        self.begin(entry)
        for task in self._writes.get(entry.path, ()):
            self._cancel(entry.path, task)

    def _cancel(self, path: str, task: asyncio.Task[Any]) -> None:
        if task.done():
            return
        task.cancel()
        cancelling = self.cancelling.setdefault(path, set())
        cancelling.add(task)

        def ended(done: asyncio.Task[Any]) -> None:
            cancelling.discard(done)
            if not cancelling and self.cancelling.get(path) is cancelling:
                del self.cancelling[path]

        task.add_done_callback(ended)

    async def wait_cancelled(self, entry: Entry) -> None:
        """Wait until cancelled work on an entry has released the robot, within a bound."""
        cancelling = self.cancelling.get(entry.path, set()) - {asyncio.current_task()}
        if cancelling:
            await asyncio.wait(cancelling, timeout=REPLY_GRACE)

    @property
    def driving(self) -> bool:
        """Whether any command is valid for a time, is in flight, or has to be stopped."""
        return bool(self._timers or self._stops or self._writes)

    @property
    def paths(self) -> set[str]:
        """The paths with a command that is valid for a time, in flight, or to be stopped."""
        return {*self._timers, *self._stops, *self._writes}

    def is_in_force(self, entry: Entry) -> bool:
        """Return whether a command, or an unacknowledged stop, is in force on an actuator."""
        path = entry.path
        if path in self._timers or path in self._stops:
            return True
        if entry.resource.safe is None:
            return False
        if path in self._writes:
            return True
        return entry.latest is not None and entry.latest.value != safe_value(entry)

    def begin(self, entry: Entry) -> bool:
        """Let a new command take over: the stop of an older one must not interfere with it.

        Return whether an older command was in force; if the new one fails, `arm(entry, 0)`.
        """
        timer = self._timers.pop(entry.path, None)
        stop = self._stops.pop(entry.path, None)
        for handle in (timer, stop):
            if handle is not None:
                handle.cancel()
        return timer is not None or stop is not None

    def arm(self, entry: Entry, seconds: float) -> asyncio.TimerHandle:
        """Start the window of a write that is now in force; return the argument of `disarm`."""
        self.begin(entry)
        with unfenced():  # it outlives the write
            timer = self._timers[entry.path] = self._loop.call_later(seconds, self._lapse, entry)
        return timer

    def arm_together(self, entries: Sequence[Entry], seconds: float) -> dict[str, Cancellable]:
        """Start one window for several actuators of a backend, which come to rest together.

        A later write to one of them ends only its own part. Return the arguments of `disarm`, by
        path.
        """
        shared = Shared(entries)

        def lapse() -> None:
            due = shared.take()
            for entry in due:
                del self._timers[entry.path]
            self.expired += len(due)
            self._start_together(due)
            for entry in due:
                self._note(entry, "lapsed")

        for entry in entries:
            self.begin(entry)
        with unfenced():  # it outlives the write
            timer = self._loop.call_later(seconds, lapse)
        parts = shared.parts(lambda others: None if others else timer.cancel())
        self._timers |= parts
        return parts

    def disarm(self, entry: Entry, timer: Cancellable | None) -> None:
        """End a window, unless that of another write has taken its place."""
        if timer is not None and self._timers.get(entry.path) is timer:
            timer.cancel()
            del self._timers[entry.path]

    def _lapse(self, entry: Entry) -> None:
        del self._timers[entry.path]
        self.expired += 1
        self._start(entry)
        self._note(entry, "lapsed")

    def _start_together(self, entries: Sequence[Entry]) -> None:
        """Bring several actuators to rest with one call; one by one if that does not succeed."""
        if len(entries) == 1:
            self._start(entries[0])
            return
        shared = Shared(entries)
        task = self._loop.create_task(self._stop_together(shared), name="dead-man of several")

        def split(others: list[Entry]) -> None:
            task.cancel()
            shared.take()
            self._start_each(others)

        self._stops |= shared.parts(split)

    def _start_each(self, entries: Sequence[Entry]) -> None:
        if not self._closed:
            for entry in entries:
                self._start(entry)

    async def _stop_together(self, shared: Shared) -> None:
        entries = shared.members
        try:
            async with timeout(_ESCALATE_AFTER):
                await self._write_safe(entries)
        except Exception as error:
            log.warning("deadman_stop_failed", error=repr(error), path=entries[0].path)
            self._start_each(shared.take())
            return
        for entry in shared.take():
            del self._stops[entry.path]
            safe = safe_value(entry)
            self._at_rest(entry, safe)
            entry.publish(safe, None)
            self._note(entry, "ok")

    async def _write_safe(self, entries: Sequence[Entry]) -> None:
        owner = entries[0].owner
        if owner.backend is None:
            raise owner.unavailable()
        for entry in entries:
            self._sending(entry, safe_value(entry))
        await owner.backend.write_together({e.name: safe_value(e) for e in entries})

    async def _stop(self, entry: Entry) -> None:
        safe = safe_value(entry)

        async def once() -> None:
            backend = entry.owner.backend
            if backend is None:  # it may still be driving: it is stopped when the link is back
                raise entry.owner.unavailable()
            self._sending(entry, safe)
            await backend.write(entry.name, safe)

        await retry_until_confirmed(once, "deadman_stop_failed", path=entry.path)
        self._at_rest(entry, safe)
        entry.publish(safe, None)
        self._note(entry, "ok")

    def close(self) -> None:
        """Discard all windows; the backends are halted by their owner."""
        self._closed = True
        for handle in (*self._timers.values(), *self._stops.values()):
            handle.cancel()
