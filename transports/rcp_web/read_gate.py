"""Whether a client is read from: one place decides, and re-evaluates all reasons each time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from rcp_web.socket import NativeSocket

__all__ = ["ReadGate"]


class ReadGate:
    """Pauses and resumes reading from one client, and keeps messages received meanwhile.

    Two reasons pause it: the client has used up its turn of the loop, or `full` reports that it
    does not read its replies. `review` re-evaluates both, and must be called after anything that
    may have changed `full`. Kept messages are handled in order, before newer ones; after this or
    the socket is closed, none are.
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
        """Calls back at the client's next turn."""
        self._handle = handle
        self._settle = settle
        """Called after the last of several messages that were handled together."""
        self._full = full
        """True only while there is data to send: the flush that sends it calls `review`."""
        self._failed = failed
        self._kept: deque[bytes] = deque()
        self._turn_over = False
        self._closed = False
        self.paused = False
        """Whether received messages are kept."""
        self.handing = False
        """Whether a kept message is being handled."""

    def keep(self, data: bytes) -> None:
        """Keep a message that the socket had already read when reading was paused."""
        if not self._closed:
            self._kept.append(data)

    def put_back(self, messages: deque[bytes]) -> None:
        """Handle messages that were deferred elsewhere, before any that came after them."""
        if not self._closed:
            self._kept.extendleft(reversed(messages))
            self.review()

    def end_turn(self) -> None:
        """End this client's turn; continue in the next one."""
        if not self._turn_over:
            self._turn_over = True
            self._wait(self._begin_turn)
            self.review()

    def _begin_turn(self) -> None:
        self._turn_over = False
        self.review()

    def review(self) -> None:
        """Handle kept messages, and pause or resume reading as the reasons require."""
        if self.handing:
            return  # the loop below checks again after each message
        self.handing = True
        try:
            while self._kept and not self._stopped():
                self._handle(self._kept.popleft())
                if not self._kept or self._stopped():
                    self._settle()  # which may free space for more
        except Exception as error:
            self._failed(error)
        finally:
            self.handing = False
        self._apply()

    def close(self) -> None:
        """Stop handling messages; reading continues, to detect the end of the connection."""
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
