"""Status messages: what a client is told besides the data it asked for."""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from rcp_kernel.errors import BadRequest, RcpError
from rcp_rosbridge.config import Level

__all__ = ["StatusMessages", "sentence"]

_RANKS: dict[Level, int] = {"none": 0, "error": 1, "warning": 2, "info": 3}
_PERIOD = 1.0  # s
_AT_ONCE = 5  # messages of a kind in that time
_OPERATION = "See the description of the operation in rosbridge v2."
_KINDS = 256  # kinds of messages that are remembered


def sentence(error: RcpError) -> str:
    """Return what went wrong, and what to do."""
    text = error.message if error.message.endswith(".") else f"{error.message}."
    remedy = _OPERATION if error.remedy == BadRequest.default_remedy else error.remedy
    return f"{text} {remedy}".strip() if remedy else text


class StatusMessages:
    """The status messages of one client; too many of a kind are counted instead."""

    def __init__(
        self, level: Level, send: Callable[[bytes], None], now: Callable[[], float]
    ) -> None:
        self.level: Level = level
        self._send = send
        self._now = now
        self._windows: dict[str, _Window] = {}

    def error(self, text: str, id_: str | None = None, kind: str | None = None) -> None:
        """Tell of an error; `kind` says which are alike."""
        self.tell("error", text, id_, kind)

    def warning(self, text: str, id_: str | None = None, kind: str | None = None) -> None:
        """Tell of something that may not be what the client wants."""
        self.tell("warning", text, id_, kind)

    def tell(self, level: Level, text: str, id_: str | None, kind: str | None = None) -> None:
        """Send a message, if the client wants those of its level."""
        if _RANKS[level] > _RANKS[self.level]:
            return
        if kind is not None:
            left_out = self._count(kind)
            if left_out is None:
                return
            if left_out:
                text = f"{text} ({left_out} more messages of this kind were left out before)"
        fields = {"op": "status", "level": level, "msg": text}
        if id_ is not None:
            fields["id"] = id_
        self._send(msgspec.json.encode(fields))

    def _count(self, kind: str) -> int | None:
        """Return how many messages of a kind were left out before; None: this one is too."""
        now = self._now()
        window = self._windows.get(kind)
        if window is None or now - window.began >= _PERIOD:
            if len(self._windows) >= _KINDS:
                self._windows.clear()
            left_out = 0 if window is None else window.left_out
            self._windows[kind] = _Window(now)
            return left_out
        if window.sent >= _AT_ONCE:
            window.left_out += 1
            return None
        window.sent += 1
        return 0


class _Window:
    """The messages of a kind within a second."""

    __slots__ = ("began", "left_out", "sent")

    def __init__(self, began: float) -> None:
        self.began = began
        self.sent = 1
        self.left_out = 0
