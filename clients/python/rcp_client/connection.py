"""Creation of a client from arguments and the environment."""

from __future__ import annotations

import os
from collections.abc import Callable
from ssl import SSLContext
from typing import Literal

from rcp_client.address import DEFAULT_URL, Address
from rcp_client.client import Client
from rcp_client.credentials import find_token
from rcp_client.messages import Notice
from rcp_client.settings import Settings
from rcp_client.tls import check_secrecy, secured
from rcp_protocol.values import Encoding

__all__ = ["connect"]


def connect(
    url: str | None = None,
    *,
    token: str | None = None,
    tenant: str | None = None,
    encoding: Literal["msgpack", "json", "cbor"] = "msgpack",
    deadline: float = 10.0,
    connect_timeout: float = 5.0,
    patience: float | None = 120.0,
    heartbeat: float = 5.0,
    on_notice: Callable[[Notice], None] | None = None,
    cacert: str | None = None,
    cert: str | None = None,
    key: str | None = None,
    ssl: SSLContext | None = None,
    plaintext: bool = False,
    client: str = "rcp-client/python",
) -> Client:
    """Create a client; `async with` connects it.

    Defaults come from `RCP_URL`, `RCP_TOKEN` and `RCP_TENANT`; then the gateway on this machine,
    and, with a single address, the token that `rcpd demo` has stored for this user. Times are in seconds: `deadline` for
    requests without their own, `connect_timeout` for one attempt, `patience` for reconnecting after
    a lost connection (None never gives up), `heartbeat` for detecting a dead connection.

    Several addresses with commas between them are those of one gateway, or of the hubs of a fleet:
    the client uses the first that answers, and goes on to the next when it is lost.

    For https the gateway's certificate is verified, against the CA in the file `cacert` if given;
    `cert` and `key` are files of a client certificate (`RCP_CACERT`, `RCP_CERT`, `RCP_KEY`), and
    `ssl` is a context that replaces all three. A token is sent to another machine over plain http
    only with `plaintext`.

    :raises ValueError: the address is invalid, a file does not load, or the token would be exposed.
    """
    url = url or os.environ.get("RCP_URL") or DEFAULT_URL
    first, *others = addresses = [Address.parse(one.strip()) for one in url.split(",")]
    token = token or find_token(None if others else first.url)  # a stored one is for one gateway
    for address in addresses:
        check_secrecy(address, token, plaintext=plaintext)
    secure = next((address for address in addresses if address.secure), first)
    return Client(
        Settings(
            address=first,
            others=tuple(others),
            token=token,
            tenant=tenant or os.environ.get("RCP_TENANT") or None,
            encoding=Encoding(encoding),
            deadline=deadline,
            connect_timeout=connect_timeout,
            patience=patience,
            heartbeat=heartbeat,
            client=client,
            ssl=ssl or secured(secure, cacert, cert, key),
            on_notice=on_notice,
        )
    )
