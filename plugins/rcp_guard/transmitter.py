"""One plan: its sender, opened in advance, and the thread that uses it."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Callable
from typing import Any

from rcp_guard.senders import MissingLibraryError, Sender, open_sender

__all__ = ["Transmitter"]

_FIRST_RETRY = 0.1  # s
_LAST_RETRY = 5.0  # s
_MISSING = 30.0  # s: the missing library may be installed meanwhile
_TRIES = 3  # consecutive failures after which the sender is reopened
_LOOK = 0.5  # s between checks for receivers
Report = Callable[[str, str, str], None]


class Transmitter:
    """Sends a plan at its period while switched on, up to the plan's duration."""

    def __init__(self, name: str, plan: dict[str, Any], report: Report) -> None:
        self.name = name
        self.plan = plan
        self.group = str(plan.get("group", name))
        self._period = max(0.001, float(plan.get("period", 0.05)))
        lasts = plan.get("lasts")
        self._lasts = math.inf if lasts is None else float(lasts)
        self._first: float | None = None
        """Time of the first transmission since it was switched on."""
        self._report = report
        self._reported = ("", "")
        self._changed = threading.Condition()
        self._on = False
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=f"plan {name}", daemon=True)

    @property
    def ready(self) -> bool:
        """Whether a stop could be sent now."""
        return self._reported[0] == "ready"

    def start(self) -> None:
        """Start to open the sender."""
        self._thread.start()

    def switch(self, *, on: bool) -> None:
        """Start or stop sending; never waits for the sender."""
        with self._changed:
            if self._on != on:
                self._on = on
                self._first = None
                self._changed.notify_all()

    def close(self) -> None:
        """Tell the thread to end; does not wait for it."""
        with self._changed:
            self._closed = True
            self._on = False
            self._changed.notify_all()

    def join(self, timeout: float) -> None:
        """Wait for the thread to end."""
        self._thread.join(timeout)

    @property
    def _due(self) -> bool:
        """Whether it should be sent now."""
        if not self._on or self._first is None:
            return self._on
        return time.monotonic() - self._first < self._lasts

    def _run(self) -> None:
        pause = _FIRST_RETRY
        while not self._closed:
            self._set_state("opening", "")
            try:
                sender = open_sender(str(self.plan.get("sender")), self.plan.get("data") or {})
            except MissingLibraryError as error:
                self._set_state("missing", str(error))
                self._wait(_MISSING)
                continue
            except Exception as error:
                self._set_state("failed", f"{type(error).__name__}: {error}")
                # A failed stop is retried at once.
                self._wait(_FIRST_RETRY if self._due else pause)
                pause = min(pause * 2, _LAST_RETRY)
                continue
            pause = _FIRST_RETRY
            if sender.unusable:
                self._set_state("missing", sender.unusable)
            try:
                self._serve(sender)
            except Exception as error:
                self._set_state("failed", f"{type(error).__name__}: {error}")
            finally:
                with contextlib.suppress(Exception):
                    sender.close()
            self._wait(_FIRST_RETRY)

    def _serve(self, sender: Sender) -> None:
        failed = 0
        while not self._closed and failed < _TRIES:
            self._idle(sender)
            if self._closed:
                return
            try:
                sender.send()
            except Exception as error:
                failed += 1
                self._set_state("failed", f"{type(error).__name__}: {error}")
            else:
                failed = 0
                self._note_sent()
                self._set_state("ready", "")
            with self._changed:
                self._changed.wait_for(lambda: not self._on, self._period)

    def _note_sent(self) -> None:
        with self._changed:
            if self._on and self._first is None:
                self._first = time.monotonic()

    def _idle(self, sender: Sender) -> None:
        """Wait until a stop is due; meanwhile check for receivers."""
        while not (self._due or self._closed):
            lacking = sender.lacks()
            self._set_state("waiting" if lacking else "ready", lacking)
            with self._changed:
                self._changed.wait_for(lambda: self._due or self._closed, _LOOK)

    def _wait(self, seconds: float) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self._closed, seconds)

    def _set_state(self, state: str, detail: str) -> None:
        if self._closed:
            return  # the plan that replaces it reports under the same name
        if state == "opening" and self._reported[0] == "failed":
            return  # the reason is more useful than the state of a retry
        if (state, detail) != self._reported:
            self._reported = (state, detail)
            self._report(self.name, state, detail)
