"""One OpenAPI document of what every mount says about itself."""

from __future__ import annotations

from typing import Any

from rcp_kernel.clients.session import Session
from rcp_kernel.door import Door
from rcp_kernel.status import gateway_version

__all__ = ["document"]

_TITLE = "RCP gateway"


def document(door: Door, session: Session) -> dict[str, Any]:
    """Write the document for what a session sees.

    :raises RateLimited: a quota does not allow it now.
    """
    door.pay(session)
    paths: dict[str, Any] = {}
    components: dict[str, dict[str, Any]] = {
        "securitySchemes": {"bearer": {"type": "http", "scheme": "bearer"}}
    }
    for mount in door.mounts:
        if mount.openapi is None:
            continue
        part = mount.openapi(session)
        paths |= part.get("paths", {})
        for kind, named in part.get("components", {}).items():
            components.setdefault(kind, {}).update(named)
    return {
        "openapi": "3.1.0",
        "info": {
            "title": _TITLE,
            "version": gateway_version(),
            "description": "Robots behind one interface: read, write, execute, subscribe.",
        },
        "servers": [{"url": "/"}],
        "security": [{}, {"bearer": []}],
        "paths": paths,
        "components": components,
    }
