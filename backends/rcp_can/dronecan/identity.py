"""What a node is: its name, versions and number."""

from __future__ import annotations

from typing import Any

from rcp_can.drive import Identity
from rcp_can.dronecan.library import make, text_of
from rcp_can.dronecan.port import Port

__all__ = ["identity_of", "read_info", "version_of"]

_HAS_COMMIT = 1


async def read_info(port: Port, node: int) -> Any:
    """Ask a node what it is.

    :raises DeviceTimeout: it does not answer.
    """
    return await port.request(node, make("protocol.GetNodeInfo.Request"), "what it is")


async def identity_of(port: Port, node: int) -> Identity:
    """Return what a node is.

    :raises DeviceTimeout: it does not answer.
    """
    info = await read_info(port, node)
    return Identity(
        model=text_of(info.name) or None,
        firmware=version_of(info.software_version),
        serial=bytes(info.hardware_version.unique_id).hex(),
    )


def version_of(software: Any) -> str:
    """Return the version of a node's firmware, with its commit if it tells it."""
    text = f"{software.major}.{software.minor}"
    if software.optional_field_flags & _HAS_COMMIT:
        text += f" ({software.vcs_commit:08x})"
    return text
