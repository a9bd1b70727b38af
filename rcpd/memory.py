"""Keep freed memory in the process for the next large message.

A camera frame passes through half a dozen buffers of a megabyte. By default glibc returns each to
the system and then faults it in again page by page: 0.5 ms per buffer, twenty times the useful
work.
"""

from __future__ import annotations

import ctypes
import sys

__all__ = ["keep_freed_memory"]

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of mallopt(3)
_KEPT = 64 * 1024 * 1024  # bytes kept in the process
_LARGEST = 16 * 1024 * 1024  # bytes of the largest buffer allocated from them


def keep_freed_memory() -> None:
    """Configure the allocator, if it is glibc's."""
    if not sys.platform.startswith("linux"):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, _LARGEST)
        mallopt(_TRIM_THRESHOLD, _KEPT)
