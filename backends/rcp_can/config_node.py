"""The configuration of a CANopen node that an EDS file describes."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from rcp_can.config_names import BusName, IdRange, Seconds, id_ranges

__all__ = ["NodeConfig"]


class NodeConfig(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which objects of a node's dictionary are shown as parameters."""

    bus: BusName
    node: Annotated[int, Meta(ge=1, le=127)]
    eds: str
    """The file: EDS or DCF."""
    objects: tuple[IdRange, ...] = ("0x2000-0xFFFF",)
    """Indices, `"0x6083"` or `"0x2000-0x5FFF"`; those of the communication are left out unless named."""

    heartbeat: Seconds | None = None
    """Within which a heartbeat must come; without it none is missed."""

    @property
    def ranges(self) -> list[tuple[int, int]]:
        """The indices of `objects` as closed ranges."""
        return id_ranges(self.objects)
