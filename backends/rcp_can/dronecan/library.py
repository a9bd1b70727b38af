"""The library `dronecan`: the types of DSDL, and the encoding of transfers."""

from __future__ import annotations

from functools import reduce
from importlib import import_module
from typing import Any

from rcp_kernel.errors import ConfigError

__all__ = ["make", "text_of", "transport", "type_id", "type_name"]

try:
    _library: Any = import_module("dronecan")
    transport: Any = import_module("dronecan.transport")
except ImportError as error:
    raise ConfigError(
        f"DroneCAN needs a library: {error}; try: pip install 'rcp-gateway[dronecan]'"
    ) from error


def _type(name: str) -> Any:
    """Return a type by its full name without `uavcan`: `equipment.esc.Status`."""
    return reduce(getattr, name.split("."), _library.uavcan)


def make(type_name: str, /, **fields: Any) -> Any:
    """Create a message; `protocol.GetNodeInfo.Request` and the like are halves of a service."""
    return _type(type_name)(**fields)


def type_id(name: str) -> int:
    """Return the number of a type."""
    return int(_type(name).default_dtid)


def type_name(payload: Any) -> str:
    """Return the full name of a message's type."""
    return str(transport.get_dronecan_data_type(payload).full_name)


def text_of(characters: Any) -> str:
    """Return an array of characters as text, whatever a node has put into it."""
    return bytes(characters).decode("utf-8", "replace")
