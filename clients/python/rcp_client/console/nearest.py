"""Paths that were probably meant, in place of one that is not there."""

from __future__ import annotations

from contextlib import suppress

from rcp_client.client import Client
from rcp_protocol.errors import RcpError, UnknownPath
from rcp_protocol.similarity import nearest
from rcp_protocol.timeouts import timeout

__all__ = ["with_nearest"]

_WAIT = 2.0  # s for the list of paths, which is no more than a help
_FEATURES = {  # resources that are there with a feature only
    "alarms": "triggers",
    "approvals": "approvals",
    "configuration": "configuration",
    "firings": "triggers",
    "history": "recorder",
    "leases": "leases",
    "places": "places",
    "plans": "plans",
    "recorder": "recorder",
    "robots": "inventory",
    "triggers": "triggers",
}


async def with_nearest(client: Client, error: RcpError) -> RcpError:
    """Name the nearest visible paths in the remedy of an unknown path."""
    general = error.remedy == UnknownPath.default_remedy
    if not isinstance(error, UnknownPath) or error.path is None or not general:
        return error
    if (feature := _FEATURES.get(error.path.removeprefix("/system/"))) is not None:
        error.remedy = (
            f"This gateway runs without the feature, or your role may not use it: its operator can "
            f"add `[features.{feature}]` to the configuration, or the right."
        )
        return error
    with suppress(RcpError, TimeoutError):
        async with timeout(_WAIT):
            found = await client.discover("/**", schemas=False)
        tenant = client.greeting.get("tenant")
        path = error.path if error.path.startswith("/tenant/") else f"/tenant/{tenant}{error.path}"
        near = nearest(path, [one.path for one in found])
        if near:
            error.remedy = f"Did you mean {' or '.join(near)}?"
    return error
