"""Content coding of responses; long ones are compressed off the event loop."""

from __future__ import annotations

import asyncio
import sys
import threading
import zlib

from rcp_http.negotiate import Coding

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

__all__ = ["compress"]

_IN_PLACE = 128 * 1024  # bytes below which compression is cheaper than a switch to a thread
_GZIP = 31  # window bits: the maximum, with gzip header and trailer
_local = threading.local()


async def compress(data: bytes, how: Coding) -> bytes:
    """Compress a response."""
    if len(data) <= _IN_PLACE:
        return _compress(data, how)
    return await asyncio.to_thread(_compress, data, how)


def _compress(data: bytes, how: Coding) -> bytes:
    if how == "gzip":
        return zlib.compress(data, 1, _GZIP)
    compressor: zstd.ZstdCompressor | None = getattr(_local, "zstd", None)
    if compressor is None:
        # The context must not be used by two threads at once.
        compressor = _local.zstd = zstd.ZstdCompressor(level=1)
    return compressor.compress(data, zstd.ZstdCompressor.FLUSH_FRAME)
