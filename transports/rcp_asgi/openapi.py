"""One OpenAPI document of what every mount says about itself."""

from __future__ import annotations

from typing import Any

from rcp_kernel.client_api import ClientApi
from rcp_kernel.clients.session import Session
from rcp_kernel.status import gateway_version

__all__ = ["document"]

_TITLE = "RCP gateway"


def document(client_api: ClientApi, session: Session) -> dict[str, Any]:
    """Write the document for what a session sees.

    :raises RateLimited: a quota does not allow it now.
    """
    client_api.charge(session)
    paths: dict[str, Any] = {}
    schemes = _schemes(client_api)
    components: dict[str, dict[str, Any]] = {"securitySchemes": schemes}
    # What an operation may do without proof it says itself, where that is not this.
    free: list[dict[str, Any]] = [{}] if client_api.proofs.anonymous else []
    for mount in client_api.mounts:
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


def _schemes(client_api: ClientApi) -> dict[str, Any]:
    """Describe by what a client may prove who it is."""
    found: dict[str, Any] = {}
    if client_api.proofs.bearer:
        found["bearer"] = {
            "type": "http",
            "scheme": "bearer",
            "description": "A key, a token of `rcpd token`, or a JSON Web Token of an issuer.",
        }
    if client_api.proofs.certificates:
        found["certificate"] = {"type": "mutualTLS", "description": "A client certificate."}
    return found
