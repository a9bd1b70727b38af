"""The gateway that a command line names."""

from __future__ import annotations

from typing import Any

from rcp_client.client import Client
from rcp_client.connection import connect

__all__ = ["named_gateway"]


def named_gateway(
    options: dict[str, Any], *, deadline: float, within: float, patience: float
) -> Client:
    """Return a client for the gateway of the common options; `within` bounds the connection.

    :raises ValueError: the options do not fit together.
    """
    return connect(
        options.get("url"),
        token=options.get("token"),
        tenant=options.get("tenant"),
        cacert=options.get("cacert"),
        cert=options.get("cert"),
        key=options.get("client_key"),
        plaintext=bool(options.get("plaintext")),
        deadline=deadline,
        connect_timeout=within,
        patience=patience,
        client="rcpctl",
    )
