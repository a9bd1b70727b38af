"""One plan: its sender, opened before it is needed, and the thread that sends with it."""

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
_MISSING = 30.0  # s: somebody may install what is missing
_TRIES = 3  # transmissions that failed one after the other, after which the sender is opened anew
_LOOK = 0.5  # s between two looks who is there to hear a stop
Report = Callable[[str, str, str], None]


class Transmitter:
    """Sends a plan at its period while it is told to, for as long as the plan lasts."""

    def __init__(self, name: str, plan: dict[str, Any], report: Report) -> None:
        self.name = name
        self.plan = plan
        self.group = str(plan.get("group", name))
        self._period = max(0.001, float(plan.get("period", 0.05)))
        lasts = plan.get("lasts")
        self._lasts = math.inf if lasts is None else float(lasts)
        self._first: float | None = None
        """When it was first sent since it was switched on."""
        self._report = report
        self._told = ("", "")
        self._changed = threading.Condition()
        self._on = False
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=f"plan {name}", daemon=True)

    @property
    def ready(self) -> bool:
        """Whether a stop could be sent now."""
        return self._told[0] == "ready"

    def start(self) -> None:
        """Begin to open the sender."""
        self._thread.start()

    def switch(self, *, on: bool) -> None:
        """Have it send, now and until switched off; never waits for the sender."""
        with self._changed:
            if self._on != on:
                self._on = on
                self._first = None
                self._changed.notify_all()

    def close(self) -> None:
        """Let the thread end; does not wait for it."""
        with self._changed:
            self._closed = True
            self._on = False
            self._changed.notify_all()

    def join(self, timeout: float) -> None:
        """Wait for the thread to end."""
        self._thread.join(timeout)

    @property
    def _due(self) -> bool:
        """Whether it is to be sent now."""
        if not self._on or self._first is None:
            return self._on
        return time.monotonic() - self._first < self._lasts

    def _run(self) -> None:
        pause = _FIRST_RETRY
        while not self._closed:
            self._tell("opening", "")
            try:
                sender = open_sender(str(self.plan.get("sender")), self.plan.get("data") or {})
            except MissingLibraryError as error:
                self._tell("missing", str(error))
                self._wait(_MISSING)
                continue
            except Exception as error:
                self._tell("failed", f"{type(error).__name__}: {error}")
                # A stop that is due is tried again at once.
                self._wait(_FIRST_RETRY if self._due else pause)
                pause = min(pause * 2, _LAST_RETRY)
                continue
            pause = _FIRST_RETRY
            if sender.unusable:
                self._tell("missing", sender.unusable)
            try:
                self._serve(sender)
            except Exception as error:
                self._tell("failed", f"{type(error).__name__}: {error}")
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
                self._tell("failed", f"{type(error).__name__}: {error}")
            else:
                failed = 0
                self._note_sent()
                self._tell("ready", "")
            with self._changed:
                self._changed.wait_for(lambda: not self._on, self._period)

    def _note_sent(self) -> None:
        with self._changed:
            if self._on and self._first is None:
                self._first = time.monotonic()

    def _idle(self, sender: Sender) -> None:
        """Wait until a stop is due; meanwhile look who is there to hear it."""
        while not (self._due or self._closed):
            lacking = sender.lacks()
            self._tell("waiting" if lacking else "ready", lacking)
            with self._changed:
                self._changed.wait_for(lambda: self._due or self._closed, _LOOK)

    def _wait(self, seconds: float) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self._closed, seconds)

    def _tell(self, state: str, detail: str) -> None:
        if state == "opening" and self._told[0] == "failed":
            return  # the reason is worth more than that it is tried again
        if (state, detail) != self._told:
            self._told = (state, detail)
            self._report(self.name, state, detail)
