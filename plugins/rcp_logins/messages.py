"""The data types of logins."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from rcp_kernel.types import Time

__all__ = ["Ended", "Ending", "ListedLogin"]


class ListedLogin(Struct, frozen=True, kw_only=True):
    """One login as it is listed."""

    login: str
    principal: str
    proof: str
    """What it began with: `key`, `token`, `jwt <issuer>`, …"""
    address: str | None
    """Where it began."""
    remembered: bool
    """Whether the browser keeps it when it is closed."""
    begun: Time
    used: Time
    expires: Time
    sessions: int
    """Number of its connected sessions."""


class Ending(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What to end: one of both."""

    login: Annotated[str, Meta(max_length=64)] | None = None
    """Id of a login: its sessions end, and its cookie is worth nothing."""
    session: Annotated[str, Meta(max_length=64)] | None = None
    """A session as `/system/sessions` lists it; its client may connect again with its credentials."""


class Ended(Struct, frozen=True, kw_only=True):
    """What has ended."""

    principal: str
    sessions: int
    """Number of sessions."""
