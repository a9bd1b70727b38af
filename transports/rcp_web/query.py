"""Strict query parsing: unknown and repeated parameters are refused."""

from __future__ import annotations

from urllib.parse import parse_qsl

from rcp_kernel.errors import BadRequest

__all__ = ["read_query", "single"]


def read_query(text: bytes, most: int) -> dict[str, list[str]]:
    """Return the values of each parameter.

    :raises BadRequest: it is malformed or has more than `most` parameters.
    """
    found: dict[str, list[str]] = {}
    try:
        pairs = parse_qsl(text.decode("ascii"), keep_blank_values=True, max_num_fields=most)
    except ValueError:
        raise BadRequest("the query is malformed or has too many parameters") from None
    for name, value in pairs:
        found.setdefault(name, []).append(value)
    return found


def single(name: str, values: list[str]) -> str:
    """Return the only value of a parameter.

    :raises BadRequest: it is repeated.
    """
    if len(values) > 1:
        raise BadRequest(f"the parameter `{name}` is given {len(values)} times")
    return values[0]
