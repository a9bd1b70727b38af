"""Names and quantities that every table of the configuration shares."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

__all__ = ["BusName", "Name", "Seconds"]

Name = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_-]+(/[A-Za-z0-9_-]+)*$", max_length=64)]
BusName = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_-]+$", max_length=32)]
Seconds = Annotated[float, Meta(gt=0, extra_json_schema={"unit": "s"})]
