"""Paged replies: how much a page holds, and where the next one starts.

A listing is ordered by path, so a cursor only needs the last path of the page: a resource that
exists throughout is listed once, whatever else is added or removed meanwhile.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Generator
from contextlib import contextmanager
from contextvars import ContextVar

from rcp_kernel.errors import BadRequest

__all__ = [
    "LONGEST",
    "MOST",
    "MOST_BATCH",
    "MOST_BYTES",
    "cursor_of",
    "place_of",
    "room",
    "shared_room",
]

MOST = 1000
"""Items of one page."""
MOST_BYTES = 1024 * 1024
"""Bytes of the encoded items of one page; the first item is included however long it is."""
MOST_BATCH = 4 * 1024 * 1024
"""Bytes of all bodies in the reply of a batch; the first one is included however long it is."""
LONGEST = 1024
"""Characters of a cursor; a path has at most 512."""
_LEAST = 4 * 1024  # bytes for one request of a batch, however many there are

_shares: ContextVar[int] = ContextVar("shares of one answer", default=1)


def cursor_of(place: str) -> str:
    """Write the cursor of the page that follows `place`, the last item of this one."""
    return base64.urlsafe_b64encode(place.encode()).decode()


def place_of(cursor: str) -> str:
    """Return the place after which a cursor's page begins.

    :raises BadRequest: it is not one of the gateway's cursors.
    """
    try:
        return base64.b64decode(cursor.encode(), altchars=b"-_", validate=True).decode()
    except (binascii.Error, UnicodeError):
        raise BadRequest(
            "`cursor` is not valid", remedy="Send the `cursor` of the previous page."
        ) from None


def room(longest: int) -> int:
    """Return how many bytes of items an answer may have, where no message is above `longest`."""
    return max(min(MOST_BYTES, longest) // _shares.get(), _LEAST)


@contextmanager
def shared_room(shares: int) -> Generator[None]:
    """Let the requests that start meanwhile share the room of one reply: those of a batch."""
    token = _shares.set(max(shares, 1))
    try:
        yield
    finally:
        _shares.reset(token)
