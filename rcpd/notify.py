"""systemd notifications: readiness by `sd_notify`, and the watchdog fed from the event loop."""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import Generator, Mapping
from contextlib import contextmanager

import structlog

__all__ = ["Notifier", "notifying"]

log = structlog.get_logger("rcp.notify")


class Notifier:
    """The service manager's socket; without one every call does nothing."""

    def __init__(self, environment: Mapping[str, str]) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "")
        self._socket: socket.socket | None = None
        self.period = _watchdog_period(environment)
        """Seconds between two watchdog notifications; None without a watchdog."""
        if self._address and hasattr(socket, "AF_UNIX"):
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.setblocking(False)

    def send(self, *lines: str) -> None:
        """Send assignments such as `READY=1`; never blocks, and failures are only logged."""
        if self._socket is None:
            return
        address = self._address
        if address.startswith("@"):  # abstract: a leading null byte
            address = "\0" + address[1:]
        try:
            self._socket.sendto("\n".join(lines).encode(), address)
        except OSError as error:
            log.warning("notify_failed", what=lines[0], reason=error.strerror)

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


@contextmanager
def notifying(
    loop: asyncio.AbstractEventLoop, environment: Mapping[str, str] = os.environ
) -> Generator[Notifier]:
    """Feed the watchdog while entered, which requires a running event loop."""
    notifier = Notifier(environment)
    timer: asyncio.TimerHandle | None = None
    period = notifier.period

    def feed(every: float) -> None:
        nonlocal timer
        notifier.send("WATCHDOG=1")
        timer = loop.call_later(every, feed, every)

    if period is not None:
        feed(period)
    try:
        yield notifier
    finally:
        if timer is not None:
            timer.cancel()
        notifier.close()


def _watchdog_period(environment: Mapping[str, str]) -> float | None:
    """Return half of `WATCHDOG_USEC` in s, as sd_watchdog_enabled(3) advises."""
    try:
        limit = int(environment.get("WATCHDOG_USEC", "0"))
        process = int(environment.get("WATCHDOG_PID", os.getpid()))
    except ValueError:
        return None
    return limit / 2e6 if limit > 0 and process == os.getpid() else None
