"""Have freed memory kept for the next large message, instead of being given back and fetched anew.

A camera frame passes through half a dozen buffers of a megabyte. glibc returns each to the system
and faults it in again page by page, 0.5 ms a buffer, which is twenty times what is done in it.
"""

from __future__ import annotations

import ctypes
import sys

__all__ = ["keep_freed_memory"]

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of mallopt(3)
_KEPT = 64 * 1024 * 1024  # bytes that stay with the process
_LARGEST = 16 * 1024 * 1024  # bytes of a buffer that comes from them


def keep_freed_memory() -> None:
    """Set the allocator so, where it is one that can be."""
    if not sys.platform.startswith("linux"):
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, _LARGEST)
        mallopt(_TRIM_THRESHOLD, _KEPT)
