"""What a feature adds to the description of a resource in discovery."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from rcp_kernel.access.acl import Rights
from rcp_kernel.tree.entry import Entry

__all__ = ["Describe"]


class Describe(Protocol):
    """Describes which commands a principal may send to a resource."""

    def __call__(self, rights: Rights, entry: Entry, /, *, schemas: bool) -> Mapping[str, Any]:
        """Return items for the description; `schemas` requests full schemas."""
        ...
