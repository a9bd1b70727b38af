"""The configuration of a device that a DBC file describes."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import Meta, Struct

from rcp_can.config_names import BusName, Seconds

__all__ = ["DeviceConfig"]

MessageName = Annotated[str, Meta(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]


class DeviceConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What of a database is shown, and what may be sent."""

    bus: BusName
    dbc: str
    """The file: DBC, KCD, SYM or whatever else cantools reads."""
    read: tuple[MessageName, ...] = ()
    """Messages that become sensors; all that are not in `write` if empty."""
    write: tuple[MessageName, ...] = ()
    """Messages that become actuators."""
    safe: dict[MessageName, dict[str, Any]] = {}
    """What the dead-man and `halt` send, by message; one without it stands for ever."""
    valid_for: Seconds = 0.5
    """Seconds that a message with a safe value stands."""

    def __post_init__(self) -> None:
        for name in self.safe:
            if name not in self.write:
                raise ValueError(f"`safe` contains {name!r}, which is not in `write`")
