"""Time that runs ahead while nothing happens, so that no test sits out what a vehicle takes.

While a loop of this kind waits, the process's clocks go faster, and its timers with them; while
anything computes, they go as ever. So what is slow is as late as it was, on a busy machine too, and
an answer of a vehicle on the same loop comes before the time-out that it came before. It is for
tests whose devices are on that loop, however real the sockets between: another process or thread
would be slow by comparison.
"""

from __future__ import annotations

import selectors
import time
from typing import Any

import pytest

from ahead import AHEAD, machine_time
from rcp_gateway.testing import UnguardedLoop

__all__ = ["HURRIED", "Hurried", "HurriedLoop"]

_TIMES = 20.0  # as fast, while the loop waits
_FINE = 0.001  # s: a selector waits no less


class _Selector(selectors.DefaultSelector):
    """Waits for sockets as long as it has to, and puts the clocks ahead for the rest."""

    def __init__(self) -> None:
        super().__init__()
        self.working = 0
        """Jobs of the loop's threads: until they are done, time is the machine's."""

    def select(self, timeout: float | None = None) -> Any:
        if timeout is None or timeout <= 0 or self.working:
            return super().select(timeout)
        ready = super().select(0)
        if ready:
            return ready
        began, wait = machine_time(), timeout / _TIMES
        if wait < _FINE:
            time.sleep(wait)
            wait = 0
        ready = super().select(wait)
        took = machine_time() - began
        # Never past the next timer: the process may have stood still meanwhile.
        due = max(0.0, timeout - took)
        AHEAD.seconds += min(due, took * (_TIMES - 1)) if ready else due
        return ready


class HurriedLoop(UnguardedLoop):
    """An event loop that does not sit out its timers."""

    def __init__(self) -> None:
        self._waiting = _Selector()
        super().__init__(self._waiting)

    def run_in_executor(self, executor: Any, func: Any, *args: Any) -> Any:
        """Let a thread have the time it takes."""
        self._waiting.working += 1
        work = super().run_in_executor(executor, func, *args)
        work.add_done_callback(self._worked)
        return work

    def _worked(self, _: Any) -> None:
        self._waiting.working -= 1

    def close(self) -> None:
        """Set the clocks right."""
        super().close()
        AHEAD.seconds = 0.0


HURRIED: tuple[str, dict[str, Any]] = "asyncio", {"loop_factory": HurriedLoop}
"""How anyio's plugin runs a test on such a loop."""


class Hurried:
    """Runs the tests of a suite on such a loop."""

    @pytest.fixture
    def anyio_backend(self) -> tuple[str, dict[str, Any]]:
        """Sit out nothing: the device is on the test's loop."""
        return HURRIED
