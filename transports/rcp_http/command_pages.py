"""A page of the list of commands: filtered, and limited in size."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from typing import NamedTuple, get_args

from rcp_gateway.api import Command
from rcp_gateway.api.pages import LONGEST, ObjectList, cursor_of, place_of
from rcp_http.request import HttpRequest, count
from rcp_kernel.errors import BadRequest
from rcp_kernel.wire import Status

__all__ = ["Wanted", "fill"]

_PAGE = 100  # default number of items per page
_STATUSES = (*get_args(Status), "running")


class Wanted(NamedTuple):
    """The filters of a request."""

    status: str | None
    path: str | None
    after: tuple[int, str] | None
    """The last command of the previous page."""
    limit: int

    @classmethod
    def read(cls, http: HttpRequest) -> Wanted:
        """Parse the parameters.

        :raises BadRequest: one of them is invalid.
        """
        status, cursor, limit = http.one("status"), http.one("cursor"), http.one("limit")
        if status is not None and status not in _STATUSES:
            known = ", ".join(_STATUSES)
            raise BadRequest(f"{status[:40]!r} is not a status", remedy=f"Use one of {known}.")
        after = None if cursor is None else _place(place_of(cursor[:LONGEST]))
        return cls(
            status, http.one("path"), after, _PAGE if limit is None else count("limit", limit)
        )

    def takes(self, command: Command) -> bool:
        """Return whether a command matches the filters."""
        if self.after is not None and command.order_key >= self.after:
            return False
        if self.path is not None and command.path != self.path:
            return False
        if self.status == "running":
            return not command.final
        return self.status in (None, command.status)


def fill(
    page: ObjectList, wanted: Wanted, commands: Iterable[Command | None], longest: int
) -> Generator[None, None, str | None]:
    """Fill a page with at most `longest` bytes in steps; return the cursor of the next page.

    The first command is always included.
    """
    last: Command | None = None
    for command in commands:
        yield
        if command is None or not wanted.takes(command):
            continue
        room = None if last is None else longest
        full = len(page) == wanted.limit
        if full or not page.add(None, command.plain(history=False), room):
            return None if last is None else cursor_of(f"{last.created}:{last.id}")
        last = command
    return None


def _place(text: str) -> tuple[int, str]:
    created, _, id_ = text.partition(":")
    if not (created.isascii() and created.isdigit()):
        raise BadRequest(
            "`cursor` is not valid for this list", remedy="Send the `cursor` of the previous page."
        )
    return int(created), id_
