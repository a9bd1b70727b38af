"""A gateway that speaks A2A around two simulated rovers, in fast time."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from configuration import backend, key, listener, role, table
from rcp_gateway.log import configure
from rcp_gateway.testing import serve
from rcp_kernel.config.file import parse

OPERATOR = "operator-of-the-rovers"
CAREFUL = "operator-who-is-careful"
BETA = "operator-of-rover-beta"
CARD_KEY = (
    ec.generate_private_key(ec.SECP256R1())
    .private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    .decode()
)
CONFIG = (
    listener()
    + table(
        "plugins.a2a",
        card_key=CARD_KEY,
        grpc={"port": 0},
        push={"http": True, "private": ["127.0.0.0/8"], "backoff": 0.05},
    )
    + backend("rover-alpha", use="sim", world="empty", noise=0, time_scale=10)
    + backend("rover-beta", "beta", use="sim", world="empty")
    + role("asks", approve=["/action/dock"], approve_own=True)
    + key("operator", OPERATOR)
    + key("careful", CAREFUL, role=["operator", "asks"])
    + key("beta", BETA, role="operator", tenants=["beta"])
)


@asynccontextmanager
async def rovers() -> AsyncGenerator[str]:
    """Run the gateway while entered; returns its URL."""
    configure("error", "json")
    async with serve(parse(CONFIG, "test")) as served:
        yield next(f["url"] for f in served.server.status.transports if "url" in f)
