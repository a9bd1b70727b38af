"""Whether a client is read from: decided in one place, from reasons that are asked for anew."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from rcp_ws.socket import NativeSocket

__all__ = ["ReadGate"]


class ReadGate:
    """Stops and continues the reading of one client, and keeps what was read before it stopped.

    Two reasons stop it: the client has used up its turn of the loop, or `full` says that it does
    not take its replies. Neither is undone by whoever brought it about: `review` asks both again,
    and has to be called after everything that may have changed `full`. What was kept is handled
    in order, before anything newer; once this or the socket is closed, nothing is.
    """

    __slots__ = (
        "_closed",
        "_failed",
        "_full",
        "_handle",
        "_kept",
        "_settle",
        "_socket",
        "_turn_over",
        "_wait",
        "handing",
        "paused",
    )

    def __init__(
        self,
        socket: NativeSocket,
        *,
        wait: Callable[[Callable[[], None]], None],
        handle: Callable[[bytes], None],
        settle: Callable[[], None],
        full: Callable[[], bool],
        failed: Callable[[Exception], None],
    ) -> None:
        self._socket = socket
        self._wait = wait
        """Calls back when the client has a turn again."""
        self._handle = handle
        self._settle = settle
        """Called after the last of some messages that were handled together."""
        self._full = full
        """True only while something is left to send: the flush that sends the rest calls `review`."""
        self._failed = failed
        self._kept: deque[bytes] = deque()
        self._turn_over = False
        self._closed = False
        self.paused = False
        """Whether messages that come are to be kept."""
        self.handing = False
        """Whether one that was kept is being handled."""

    def keep(self, data: bytes) -> None:
        """Take a message that came although reading is paused: the socket had it already."""
        if not self._closed:
            self._kept.append(data)

    def put_back(self, messages: deque[bytes]) -> None:
        """Handle messages that had to wait elsewhere, before any that came after them."""
        if not self._closed:
            self._kept.extendleft(reversed(messages))
            self.review()

    def end_turn(self) -> None:
        """Let others have theirs, and go on when it comes to this client again."""
        if not self._turn_over:
            self._turn_over = True
            self._wait(self._begin_turn)
            self.review()

    def _begin_turn(self) -> None:
        self._turn_over = False
        self.review()

    def review(self) -> None:
        """Handle what was kept, and read or not, as the reasons stand now."""
        if self.handing:
            return  # the loop below looks again after each message
        self.handing = True
        try:
            while self._kept and not self._stopped():
                self._handle(self._kept.popleft())
                if not self._kept or self._stopped():
                    self._settle()  # which may make room for more
        except Exception as error:
            self._failed(error)
        finally:
            self.handing = False
        self._apply()

    def close(self) -> None:
        """Handle nothing any more; reading goes on, so that the client's end is noticed."""
        self._closed = True
        self._kept.clear()
        self._apply()

    def _stopped(self) -> bool:
        return self._turn_over or not self._socket.open or self._full()

    def _apply(self) -> None:
        waits = not self._closed and (bool(self._kept) or self._stopped())
        self.paused = waits or self._closed
        if waits:
            self._socket.pause_reading()
        else:
            self._socket.resume_reading()
