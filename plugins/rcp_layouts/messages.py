"""The data types of layouts."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from rcp_kernel.types import Time

__all__ = ["EVERYONE", "Entry", "Layout", "OwnRequest", "SharedRequest"]

EVERYONE = "*"
Name = Annotated[str, Meta(pattern=r"^[^/\x00-\x1f\x7f]{1,64}$")]
Tenant = Annotated[str, Meta(max_length=64)]
Version = Annotated[int, Meta(ge=0)]
Content = dict[str, Any]


class Entry(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A layout as it is listed."""

    name: Name
    tenant: Tenant | None = None
    """The tenant whose people share it; `*`: those of all. Absent: it is the caller's own."""
    version: Version
    """Increases with every save."""
    by: str
    """Who saved it last."""
    saved: Time


class Layout(Entry, frozen=True, kw_only=True, omit_defaults=True):
    """A layout with its content."""

    content: Content | None = None
    """Whatever the page keeps; the gateway does not interpret it. Absent in the response to `save`."""


class OwnRequest(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Open a layout, or change one of the caller's own."""

    do: Literal["open", "save", "remove"]
    name: Name
    tenant: Tenant | None = None
    """With `open`: the tenant that shares it. Absent: it is the caller's own."""
    version: Version = 0
    """The version that a change was made from; 0: there is none yet."""
    content: Content | None = None
    """Required with `save`."""


class SharedRequest(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Change a layout that a tenant shares."""

    do: Literal["save", "remove"]
    name: Name
    tenant: Tenant | None = None
    """Default: the session's. `*`: that of all, for principals of all tenants."""
    version: Version = 0
    """The version that the change was made from; 0: there is none yet."""
    content: Content | None = None
    """Required with `save`."""
