"""Requests that select one of several operations by the field that they set."""

from __future__ import annotations

import msgspec

from rcp_kernel.errors import BadRequest

__all__ = ["chosen"]


def chosen(request: msgspec.Struct, path: str) -> str:
    """Return the name of the one field that a request sets.

    :raises BadRequest: it sets none, or several.
    """
    names = request.__struct_fields__
    given = [name for name in names if getattr(request, name) is not None]
    if len(given) != 1:
        *others, last = [f"`{name}`" for name in names]
        raise BadRequest(
            "a request does one thing",
            path=path,
            remedy=f"Give one of {', '.join(others)} and {last}.",
        )
    return given[0]
