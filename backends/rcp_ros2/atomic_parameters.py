"""A service that sets several parameters of a node atomically."""

from __future__ import annotations

from typing import Any

import msgspec

from rcp_kernel.errors import InvalidValue
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress
from rcp_ros2.binding import Binding, Shared, common
from rcp_ros2.config import Mapping
from rcp_ros2.parameters import Described, NodeParameters

__all__ = ["AtomicParameters"]


class AtomicParameters(Binding):
    """The service for one node."""

    def __init__(
        self,
        shared: Shared,
        name: str,
        mapping: Mapping,
        node: NodeParameters,
        described: list[Described],
    ) -> None:
        self._node = node
        self._kinds = {f"p{n}": one for n, one in enumerate(described)}
        """Field names: parameter names are not always Python identifiers."""
        text = f"Set parameters of {node.node} atomically: all of them, or none"
        facts = common(name, mapping, text, node=node.node)
        super().__init__(shared, Resource(input=self._input(mapping), **facts), mapping)

    def _input(self, mapping: Mapping) -> Any:
        fields = [
            (field, one.type(mapping.unit) | msgspec.UnsetType, msgspec.UNSET)
            for field, one in self._kinds.items()
        ]
        return msgspec.defstruct(
            "Parameters",
            fields,
            rename={field: one.name for field, one in self._kinds.items()},
            frozen=True,
            forbid_unknown_fields=True,
        )

    async def execute(self, value: Any, progress: Progress) -> None:
        """Set the given parameters.

        :raises DeviceRejected: the node refused, and has changed none of them.
        """
        wanted = {
            one.name: (one.kind, new)
            for field, one in self._kinds.items()
            if (new := getattr(value, field)) is not msgspec.UNSET
        }
        if not wanted:
            raise InvalidValue(
                "no parameter given", remedy="Give at least one parameter with its new value."
            )
        await self._node.set_together(wanted, self.admit)
