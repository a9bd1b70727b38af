"""The handshake: encoding and caller."""

from __future__ import annotations

from rcp_gateway.api import Principal
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import BadRequest, Unauthenticated
from rcp_kernel.values import Encoding
from rcp_web.asgi import Scope, bearer, header, peer_of

__all__ = ["SUBPROTOCOLS", "choose", "identify"]

SUBPROTOCOLS = {f"rcp.v1.{encoding.value}": encoding for encoding in Encoding}


def choose(offered: list[str]) -> tuple[str | None, Encoding]:
    """Choose the client's first supported subprotocol; JSON if it offers none.

    :raises BadRequest: none of those offered is supported.
    """
    for name in offered:
        if name in SUBPROTOCOLS:
            return name, SUBPROTOCOLS[name]
    if offered:
        raise BadRequest(
            f"none of the subprotocols {', '.join(offered)[:100]} is supported",
            remedy=f"Offer one of {', '.join(SUBPROTOCOLS)}, or none for JSON.",
        )
    return None, Encoding.JSON


async def identify(client_api: ClientApi, scope: Scope) -> tuple[Principal | None, str | None]:
    """Return the caller and its tenant; None: it must authenticate in `hello`.

    :raises Unauthenticated: the token of the Authorization header is invalid.
    """
    token = bearer(header(scope, b"authorization"))
    tenant = header(scope, b"x-rcp-tenant")
    try:
        principal = await client_api.identify(token, peer_of(scope))
    except Unauthenticated:
        if token is not None:
            raise
        principal = None
    return principal, None if tenant is None else tenant.decode("latin-1")
