"""The process of a gateway, which no plugin may end early, nor keep from ending."""

from __future__ import annotations

import asyncio
import sys
import threading
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import Any, TypeVar

import structlog

__all__ = ["end_in_time", "run_contained"]

log = structlog.get_logger("rcp.plugins")
_Result = TypeVar("_Result")
_LEAVE = 3.0  # s that threads left behind by plugins may run after the gateway's end


def run_contained(runner: asyncio.Runner, main: Coroutine[Any, Any, _Result]) -> _Result:
    """Run the gateway to its end and return its result, whatever a plugin's task or timer raises.

    Ctrl-C arrives as a signal that the gateway handles itself, so a `KeyboardInterrupt` out of the
    loop comes from a plugin as well.
    """
    loop = runner.get_loop()
    task = loop.create_task(main, name="gateway")
    while True:
        try:
            return loop.run_until_complete(task)
        except (SystemExit, KeyboardInterrupt) as error:
            if task.done():
                raise
            # Without traceback: formatting it may call the plugin's objects.
            with suppress(BaseException):
                log.error("plugin_would_end_the_process", error=repr(error))


def end_in_time(leave: Callable[[], object]) -> None:
    """Call `leave`, which ends the process, after a bound if a plugin has left threads behind.

    Python waits for every non-daemon thread, and the event loop for those of its executor.
    """

    def end() -> None:
        left = [t.name for t in threading.enumerate() if not t.daemon and t.name != "MainThread"]
        log.error("threads_left_behind", threads=left, detail="ended without waiting for them")
        sys.stderr.flush()
        sys.stdout.flush()
        leave()

    last = threading.Timer(_LEAVE, end)
    last.daemon = True
    last.start()
