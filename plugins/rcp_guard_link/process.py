"""The guard process from the gateway's side: start, heartbeat, messages and restart.

Nothing here blocks: what the guard does not accept immediately is kept, or dropped.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import structlog

from rcp_kernel.config.safety import Safety

__all__ = ["GuardProcess"]

log = structlog.get_logger("rcp.guard")
_FIRST_RETRY = 0.25  # s
_LAST_RETRY = 10.0  # s
_SILENT = 5.0  # s without a sign of life after which a guard is ended and started again
_GOODBYE = 2.0  # s that the guard has to end
_OURS = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")
Report = Callable[[dict[str, Any]], None]


class GuardProcess:
    """At most one guard process, with the plans and armed groups it has been sent."""

    def __init__(self, loop: asyncio.AbstractEventLoop, safety: Safety) -> None:
        self._loop = loop
        self._safety = safety
        self.on_report: list[Report] = []
        """Called with each message of the guard."""
        self._process: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None
        self._partial = b""
        self._waiting = b""
        self._sent_armed: frozenset[str] = frozenset()
        self._heard: float | None = None
        self._pause = _FIRST_RETRY
        self._due = 0.0
        self.plans: dict[str, dict[str, Any]] = {}
        """The plans that the guard has, or will receive once it runs."""
        self.restarts = 0

    @property
    def pid(self) -> int | None:
        """The process, or None while there is none."""
        return None if self._process is None else self._process.pid

    @property
    def running(self) -> bool:
        """Whether there is a guard that has sent a message."""
        return self._process is not None and self._heard is not None

    def replace_plans(self, plans: dict[str, dict[str, Any]]) -> None:
        """Send all plans to the guard again; the first plan starts it."""
        self.plans = plans
        if self._process is not None:
            self._send({"plans": plans})

    def beat(self, armed: frozenset[str]) -> None:
        """Give a sign of life, and look after the guard's."""
        now = time.monotonic()
        if self._process is None:
            if self.plans and now >= self._due:
                self._start()
            else:
                return
        if armed != self._sent_armed:
            self.arm(armed)
        else:
            self._write(b"" if self._waiting else b"\n")
        if self._heard is not None and now - self._heard > _SILENT:
            self._hear()  # the loop may have stood still itself
            if now - self._heard > _SILENT:
                self._drop(f"no heartbeat for {_SILENT:g} s")

    def arm(self, armed: frozenset[str]) -> None:
        """Tell the guard at once which groups may move."""
        if self._process is not None:
            self._sent_armed = armed
            self._send({"armed": sorted(armed)})

    async def close(self) -> None:
        """Shut the guard down, and wait for its end."""
        process, connection = self._process, self._socket
        if process is None or connection is None:
            return
        self._loop.remove_reader(connection)
        self._send({"bye": True})
        # Closed only after the guard has ended, unless it does not: the goodbye must not get lost.
        until = time.monotonic() + _GOODBYE
        while process.poll() is None and time.monotonic() < until:
            self._write(b"")
            await asyncio.sleep(0.01)
        if process.poll() is None:
            process.kill()
            process.wait()
        connection.close()
        self._process = self._socket = None

    # -- its life --------------------------------------------------------------------------------

    def _start(self) -> None:
        parent, child = socket.socketpair()
        environment = {key: text for key, text in os.environ.items() if key not in _OURS}
        safety = self._safety
        with child:
            command = [
                *(sys.executable, "-P", "-m", "rcp_guard"),
                *("--fd", str(child.fileno())),
                *("--after", str(safety.guard_after)),
                *("--bound", str(safety.guard_bound)),
            ]
            try:
                # A separate session: signals to the gateway's group do not reach it.
                self._process = subprocess.Popen(  # noqa: S603 - our own module
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    pass_fds=(child.fileno(),),
                    start_new_session=True,
                    env=environment,
                )
            except OSError as error:
                parent.close()
                self._again()
                log.error("guard_not_started", reason=str(error), again_in=self._pause)
                return
        parent.setblocking(False)
        self._socket, self._heard = parent, None
        self._partial = self._waiting = b""
        self._sent_armed = frozenset()
        self._loop.add_reader(parent, self._hear)
        self._send({"plans": self.plans})

    def _again(self) -> None:
        self._due = time.monotonic() + self._pause
        self._pause = min(self._pause * 2, _LAST_RETRY)

    def _drop(self, why: str) -> None:
        """End the guard; another one is started after a pause."""
        process, connection = self._process, self._socket
        assert process is not None
        assert connection is not None
        self._loop.remove_reader(connection)
        connection.close()
        if process.poll() is None:
            process.kill()
        code = process.wait()
        self._process = self._socket = None
        self.restarts += 1
        self._tell({"event": "ended"})
        log.error("guard_ended", reason=why, code=code, again_in=self._pause)
        self._again()

    # -- lines -----------------------------------------------------------------------------------

    def _send(self, message: dict[str, Any]) -> None:
        self._write(json.dumps(message).encode() + b"\n")

    def _write(self, data: bytes) -> None:
        if self._socket is None:
            return
        self._waiting += data
        with contextlib.suppress(OSError):  # full, or ended: the reader says so
            self._waiting = self._waiting[self._socket.send(self._waiting) :]

    def _hear(self) -> None:
        connection = self._socket
        if connection is None:
            return
        try:
            data = connection.recv(65536)
        except BlockingIOError:
            return
        except OSError as error:
            self._drop(str(error))
            return
        if not data:
            self._drop("it exited")
            return
        if self._heard is None:
            self._pause = _FIRST_RETRY
        self._heard = time.monotonic()
        *lines, self._partial = (self._partial + data).split(b"\n")
        for line in lines:
            with contextlib.suppress(ValueError):
                self._tell(json.loads(line))

    def _tell(self, message: dict[str, Any]) -> None:
        for report in self.on_report:
            report(message)
