"""Names and quantities shared by the tables of the configuration."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Annotated

from msgspec import Meta

__all__ = ["BusName", "IdRange", "Name", "Seconds", "id_ranges"]

Name = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_-]+(/[A-Za-z0-9_-]+)*$", max_length=64)]
BusName = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_-]+$", max_length=32)]
Seconds = Annotated[float, Meta(gt=0, extra_json_schema={"unit": "s"})]
IdRange = Annotated[str, Meta(pattern=r"^0x[0-9A-Fa-f]{1,8}(-0x[0-9A-Fa-f]{1,8})?$")]
"""An identifier `"0x100"`, or a range `"0x100-0x1FF"`."""


def id_ranges(texts: Iterable[str]) -> list[tuple[int, int]]:
    """Parse identifiers and ranges into closed ranges."""
    found: list[tuple[int, int]] = []
    for text in texts:
        first, *last = (int(part, 16) for part in re.split("-", text))
        found.append((first, last[0] if last else first))
    return found
