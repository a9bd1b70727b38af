"""The OpenAPI document, combined from those of all mounts."""

from __future__ import annotations

from typing import Any

import msgspec

from rcp_gateway.api import Session, SharedWork, gateway_version
from rcp_gateway.client_api import ClientApi

__all__ = ["Documents"]

_TITLE = "RCP gateway"
_KEPT = 8  # documents, of about a megabyte each with a thousand resources


class Documents:
    """The document per view of the tree; callers with the same view share one until it changes."""

    def __init__(self, client_api: ClientApi) -> None:
        self._client_api = client_api
        self._known: dict[Any, bytes] = {}
        self._writing = SharedWork[bytes](client_api.loop)

    async def written(self, session: Session) -> bytes:
        """Return the encoded document for a session.

        :raises RateLimited: a quota is exceeded.
        """
        client_api = self._client_api
        client_api.charge(session)
        key = (
            client_api.generation(session),
            session.rights,
            client_api.rights_of_anyone(),
            client_api.proofs,
            tuple(client_api.mounts),
        )
        document = self._known.pop(key, None)
        if document is None:
            document = await self._writing.result(key, lambda: self._write(session))
        self._known[key] = document  # least recently used
        if len(self._known) > _KEPT:
            del self._known[next(iter(self._known))]
        return document

    async def _write(self, session: Session) -> bytes:
        client_api = self._client_api
        paths: dict[str, Any] = {}
        schemes = _schemes(client_api)
        components: dict[str, dict[str, Any]] = {"securitySchemes": schemes}
        # Operations that need no authentication declare that themselves.
        free: list[dict[str, Any]] = [{}] if client_api.proofs.anonymous else []
        for mount in list(client_api.mounts):
            if mount.openapi is None:
                continue
            part = await mount.openapi(session)
            paths |= part.get("paths", {})
            for kind, named in part.get("components", {}).items():
                components.setdefault(kind, {}).update(named)
        return msgspec.json.encode(
            {
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
        )


def _schemes(client_api: ClientApi) -> dict[str, Any]:
    """Describe the authentication schemes."""
    found: dict[str, Any] = {}
    if client_api.proofs.bearer:
        found["bearer"] = {
            "type": "http",
            "scheme": "bearer",
            "description": "An API key, a token created by `rcpd token`, or a JSON Web Token from a configured issuer.",
        }
    if client_api.proofs.certificates:
        found["certificate"] = {"type": "mutualTLS", "description": "A client certificate."}
    return found
