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
    schemes = _schemes(door)
    components: dict[str, dict[str, Any]] = {"securitySchemes": schemes}
    # What an operation may do without proof it says itself, where that is not this.
    free: list[dict[str, Any]] = [{}] if door.proofs.anonymous else []
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
        "security": free + [{name: []} for name in schemes],
        "paths": paths,
        "components": components,
    }


def _schemes(door: Door) -> dict[str, Any]:
    """Describe by what a client may prove who it is."""
    found: dict[str, Any] = {}
    if door.proofs.bearer:
        found["bearer"] = {
            "type": "http",
            "scheme": "bearer",
            "description": "A key, a token of `rcpd token`, or a JSON Web Token of an issuer.",
        }
    if door.proofs.certificates:
        found["certificate"] = {"type": "mutualTLS", "description": "A client certificate."}
    return found
