"""What a feature serves as files: whole, in parts, or written while it is sent."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from rcp_gateway.api import Session
from rcp_kernel.features import ServiceKey
from rcp_kernel.values import Encoding
from rcp_kernel.wire import Body

__all__ = ["RECORDINGS", "Download", "HistoryPage", "Recordings"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Download:
    """A file."""

    name: str
    media: str
    pieces: Callable[[int, int | None], AsyncIterator[bytes]]
    """Returns the bytes from one place until before another; of what has no size, all of them."""
    size: int | None = None
    """In bytes; None: it is known at the end."""


class HistoryPage(NamedTuple):
    """What was recorded of a path, one page of it."""

    path: str
    body: Body
    cursor: str | None
    """Where the next page begins; None: there is none."""


class Recordings(Protocol):
    """Recordings, as the feature `recorder` offers them."""

    async def page(
        self, session: Session, wanted: Mapping[str, Any], encoding: Encoding
    ) -> HistoryPage:
        """Return one page of what was recorded of a path, encoded as the client has it.

        :raises RcpError: the session may not read the path, or an option is wrong.
        """
        ...

    async def table(self, session: Session, wanted: Mapping[str, Any], format_: str) -> Download:
        """Return all of it in another format; in `json` the page, of which nothing is decoded here.

        :raises RcpError: as for `page`, or the format is none.
        """
        ...

    async def file(self, session: Session, name: str, format_: str) -> Download:
        """Return a recording, as it is (`mcap`) or as a bag (`ros2`) or the bag's metadata (`yaml`).

        :raises UnknownPath: there is none that the session may see.
        """
        ...


RECORDINGS: ServiceKey[Recordings] = ServiceKey("recorder.recordings")
