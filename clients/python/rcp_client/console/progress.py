"""The progress of a command on a terminal: one line that is written anew."""

from __future__ import annotations

import shutil
import sys

from rcp_client.command import Feedback
from rcp_client.console.output import Output, clean, compact

__all__ = ["ProgressLine"]

_WIDTH = 24
_PARTS = " ▏▎▍▌▋▊▉█"


class ProgressLine:
    """The last line of a terminal, as long as a command runs."""

    def __init__(self, out: Output) -> None:
        self._out = out
        self._shown = False

    def show(self, feedback: Feedback) -> None:
        """Write the line anew."""
        bar = "" if feedback.progress is None else f"{_bar(feedback.progress)} "
        head = f"{feedback.status} {bar}"
        room = max(0, shutil.get_terminal_size().columns - len(head) - 1)
        body = "" if feedback.body is None else clean(compact(feedback.body))
        cut = body if len(body) <= room else body[: max(0, room - 1)] + "…"
        sys.stdout.write(f"\r\x1b[K{self._out.paint(feedback.status)} {bar}{self._out.dim(cut)}")
        sys.stdout.flush()
        self._shown = True

    def clear(self) -> None:
        """Remove the line: what follows is written in its place."""
        if self._shown:
            sys.stdout.write("\r\x1b[K")
            sys.stdout.flush()
            self._shown = False


def _bar(share: float) -> str:
    """Return a share of 0 to 1 as a bar with its percentage."""
    eighths = round(min(1.0, max(0.0, share)) * _WIDTH * 8)
    full, rest = divmod(eighths, 8)
    part = _PARTS[rest] if rest else ""
    return f"{'█' * full}{part}".ljust(_WIDTH, "░") + f" {share:4.0%}"
