"""The installed plugins: which of them cannot be used, and the profiles that they publish."""

from __future__ import annotations

import importlib
from contextlib import suppress
from importlib.metadata import EntryPoint

from rcp_gateway.plugins import (
    GROUPS,
    collect,
    import_remedy,
    install_remedy,
    installed,
    missing_module,
)
from rcp_profiles import STANDARD, Profile

__all__ = ["obstacle", "published_profiles"]

_KINDS = ("rcp_backends", "rcp_transports", "rcp_adapters", "rcp_features")
"""Hooks whose records may need libraries of an extra."""


def published_profiles() -> dict[str, Profile]:
    """Return the profiles by name: the standard ones, and those of the installed plugins.

    A plugin that cannot be imported is skipped.

    :raises PluginError: two of them have one name.
    """
    found = dict(STANDARD)
    points = {point.value for group in GROUPS for point in installed(group).values()}
    for name in sorted(points):
        with suppress(ImportError):
            offer = getattr(importlib.import_module(name), "rcp_profiles", None)
            if offer is not None and hasattr(offer, "rcp_impl"):
                collect(found, [offer()], "profile")
    return found


def obstacle(point: EntryPoint) -> str | None:
    """Return why an installed plugin cannot be used, and what to do; None: it can."""
    try:
        module = importlib.import_module(point.value)
    except ImportError as error:
        return f"{error}; {import_remedy(error, point)}"
    offers = [getattr(module, hook, None) for hook in _KINDS]
    kinds = [kind for offer in offers if offer is not None for kind in offer()]
    found = ((missing_module(kind), kind) for kind in kinds)
    name, kind = next((one for one in found if one[0] is not None), (None, None))
    return None if name is None else f"No module named '{name}'; {install_remedy(point, kind)}"
