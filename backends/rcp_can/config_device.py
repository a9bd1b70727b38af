"""The configuration of a device that a DBC file describes."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import Meta, Struct

from rcp_can.config_names import BusName, Seconds

__all__ = ["DeviceConfig"]

MessageName = Annotated[str, Meta(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]


class DeviceConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The messages of a database to receive and to send."""

    bus: BusName
    dbc: str
    """The file: DBC, KCD, SYM or another format that cantools reads."""
    read: tuple[MessageName, ...] = ()
    """Messages that become sensors; if empty, all that are not in `write`."""
    write: tuple[MessageName, ...] = ()
    """Messages that become actuators."""
    safe: dict[MessageName, dict[str, Any]] = {}
    """Values that the dead-man and `halt` send, by message; without one, it never expires."""
    valid_for: Seconds = 0.5
    """Validity in s of a message with a safe value."""

    def __post_init__(self) -> None:
        for name in self.safe:
            if name not in self.write:
                raise ValueError(f"`safe` contains {name!r}, which is not in `write`")
