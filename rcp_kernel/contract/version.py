"""The version of the gateway."""

from __future__ import annotations

from functools import cache
from importlib.metadata import PackageNotFoundError, version

__all__ = ["gateway_version"]


@cache
def gateway_version() -> str:
    """Return the installed version of the distribution."""
    try:
        return version("rcp-gateway")
    except PackageNotFoundError:
        return "0"
