"""The configuration of a CANopen node that an EDS file describes."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from rcp_can.config_names import BusName, IdRange, Seconds, id_ranges

__all__ = ["NodeConfig"]


class NodeConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The objects of a node's dictionary that become parameters."""

    bus: BusName
    node: Annotated[int, Meta(ge=1, le=127)]
    eds: str
    """The file: EDS or DCF."""
    objects: tuple[IdRange, ...] = ("0x2000-0xFFFF",)
    """Indices, `"0x6083"` or `"0x2000-0x5FFF"`; communication objects are left out unless
    listed."""
    moves: tuple[IdRange, ...] = ("0x1F50-0x1F8F", "0x6000-0x9FFF")
    """Objects whose writing may start or move something, and is refused during an e-stop:
    programs, the
    NMT of other nodes, and the device profile; add manufacturer-specific ones here."""
    heartbeat: Seconds | None = None
    """Maximum time between heartbeats; without it, heartbeats are not monitored."""

    @property
    def ranges(self) -> list[tuple[int, int]]:
        """The indices of `objects` as closed ranges."""
        return id_ranges(self.objects)

    @property
    def moving(self) -> list[tuple[int, int]]:
        """The indices of `moves` as closed ranges."""
        return id_ranges(self.moves)
