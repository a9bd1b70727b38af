"""What `rcpd` and `rcpctl` do around their commands, before anything else is imported."""

from __future__ import annotations

import errno
import os
import signal
import sys
from collections.abc import Generator
from contextlib import contextmanager, suppress
from io import TextIOWrapper
from typing import TextIO

__all__ = ["as_program", "interrupt_ends"]

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)  # of writing only
_FAILED = 1


@contextmanager
def interrupt_ends() -> Generator[None]:
    """Let Ctrl-C end the process at once: a module that is imported expects none."""
    before = signal.getsignal(signal.SIGINT)
    if before is signal.SIG_IGN:  # as a shell starts what runs in the background
        yield
        return
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def as_program(name: str) -> Generator[None]:
    """Run a command whose output may be closed, or cannot be written."""
    _open_closed()
    output: TextIO = sys.stdout
    if isinstance(output, TextIOWrapper) and output.errors == "strict":
        output.reconfigure(errors="replace")  # of an encoding that lacks a character
    try:
        yield
    except OSError as error:
        if error.errno not in _FULL:
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what is left is not tried again at the end
        with suppress(OSError):
            what = "its output" if error.filename is None else f"'{error.filename}'"
            sys.stderr.write(
                f"{name}: {what} cannot be written: {error.strerror}. "
                "Free some space, or write elsewhere.\n"
            )
        sys.exit(_FAILED)


def _open_closed() -> None:
    """Open streams that are closed (`>&-`), or the first connection would get their number."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: PTH123, SIM115 - for the whole run
