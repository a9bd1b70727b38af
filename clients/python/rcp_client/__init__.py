"""A client of RCP gateways: asyncio, blocking, and `rcpctl` for terminals.

    async with rcp_client.connect() as robot:
        pose = await robot.read("/sensor/pose")

    with rcp_client.Robot() as robot:
        pose = robot.read("/sensor/pose")

Names are imported on first use, so that `rcpctl --help` starts quickly.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rcp_client.blocking import Robot
    from rcp_client.client import Client
    from rcp_client.command import CommandHandle, Feedback
    from rcp_client.connection import connect
    from rcp_client.credentials import token_path
    from rcp_client.errors import ConnectionLost
    from rcp_client.lease import Lease
    from rcp_client.messages import Notice, Reply, ResourceInfo, Update
    from rcp_client.subscription import Subscription

__all__ = [
    "Client",
    "CommandHandle",
    "ConnectionLost",
    "Feedback",
    "Lease",
    "Notice",
    "Reply",
    "ResourceInfo",
    "Robot",
    "Subscription",
    "Update",
    "connect",
    "token_path",
]

_HOMES = {
    "Client": "client",
    "CommandHandle": "command",
    "ConnectionLost": "errors",
    "Feedback": "command",
    "Lease": "lease",
    "Notice": "messages",
    "Reply": "messages",
    "ResourceInfo": "messages",
    "Robot": "blocking",
    "Subscription": "subscription",
    "Update": "messages",
    "connect": "connection",
    "token_path": "credentials",
}


def __getattr__(name: str) -> Any:
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module 'rcp_client' has no attribute {name!r}")
    return getattr(import_module(f"rcp_client.{home}"), name)
