"""A CANopen node described by its EDS: dictionary objects as parameters, accessed by SDO."""

from __future__ import annotations

import asyncio
from collections.abc import Generator, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from typing import TYPE_CHECKING, Any

from rcp_can.binding import Part
from rcp_can.bus import Bus
from rcp_can.config_node import NodeConfig
from rcp_can.eds_file import load_eds
from rcp_can.eds_types import Entry, entry_of, slug
from rcp_can.health import Health
from rcp_can.node_state import NodeWatch
from rcp_can.sdo import Sdo
from rcp_kernel.errors import ConfigError, RcpError
from rcp_kernel.model import Operation, Resource
from rcp_kernel.spi import Host, check_fence

if TYPE_CHECKING:
    from canopen.objectdictionary import ObjectDictionary, ODVariable

__all__ = ["COMMANDS", "EdsPart"]

_PERIOD = 1.0  # s between two polls of a subscribed parameter
COMMANDS = frozenset((0x6040, 0x6060, 0x6071, 0x607A, 0x60B0, 0x60B1, 0x60B2, 0x60C1, 0x60FF))
"""Objects that move a drive: controlled by the motor, read-only here."""


class EdsPart(Part):
    """The parameters of one node.

    :raises ConfigError: the file cannot be read, or has no such objects.
    """

    def __init__(
        self, name: str, config: NodeConfig, bus: Bus, sdo: Sdo, host: Host, health: Health
    ) -> None:
        self._name, self._config, self._bus, self._host = name, config, bus, host
        self._sdo = sdo
        self.watched = NodeWatch(name, config, bus, host, health)
        self._entries: dict[str, Entry] = {}
        self._texts: dict[str, str] = {}
        for path, text, variable in _variables(load_eds(f"nodes.{name}", config.eds, config.node)):
            entry = entry_of(variable)
            if entry is None or not any(a <= entry.index <= b for a, b in config.ranges):
                continue
            full = f"param/{name}/{path}"
            if full in self._entries:
                full += f"_{entry.index:04x}_{entry.sub}"
            self._entries[full], self._texts[full] = entry, text
        if not self._entries:
            raise ConfigError(f"nodes.{name}.objects: {config.eds} has none of these objects")

    def resources(self) -> list[Resource]:
        """List the objects as resources."""
        found: list[Resource] = []
        for path, entry in self._entries.items():
            may = Operation.NONE
            if entry.readable:
                may |= Operation.READ | Operation.SUBSCRIBE
            if entry.writable and entry.index not in COMMANDS:
                may |= Operation.WRITE
            found.append(
                Resource(
                    name=path,
                    description=f"{self._texts[path]}.",
                    value=entry.type,
                    operations=may,
                    moves=any(a <= entry.index <= b for a, b in self._config.moving),
                    meta={
                        "bus": self._bus.name,
                        "node": self._config.node,
                        "index": f"0x{entry.index:04X}",
                        "subindex": entry.sub,
                    },
                )
            )
        shown = [resource for resource in found if resource.operations]
        return [*self.watched.resources(), *shown]

    async def read(self, name: str) -> Any:
        """Read an object from the node; the node's state is the last one received."""
        if name == self.watched.path:
            return self.watched.value
        if name not in self._entries:
            return await super().read(name)
        entry = self._entries[name]
        return entry.unpack(await self._sdo.upload(entry.index, entry.sub))

    async def write(self, name: str, value: Any) -> Any:
        """Write an object, read it back, and return the value read."""
        entry = self._entries[name]
        check_fence()
        await self._sdo.download(entry.index, entry.sub, entry.pack(value))
        if not entry.readable:
            return value
        taken = await self.read(name)
        self._host.publish(name, taken)
        return taken

    def watch(self, name: str) -> AbstractContextManager[object]:
        """Poll an object while a client subscribes."""
        return self._watched(name) if name in self._entries else super().watch(name)

    @contextmanager
    def _watched(self, name: str) -> Generator[None]:
        polling = asyncio.create_task(self._poll(name), name=f"can watch {name}")
        try:
            yield
        finally:
            polling.cancel()

    async def _poll(self, name: str) -> None:
        while True:
            with suppress(RcpError):  # readers get the error themselves
                self._host.publish(name, await self.read(name))
            await asyncio.sleep(_PERIOD)


def _variables(dictionary: ObjectDictionary) -> Iterator[tuple[str, str, ODVariable]]:
    """Yield every variable with its path below the node and its descriptive name."""
    from canopen.objectdictionary import ODVariable

    for each in dictionary.values():
        if isinstance(each, ODVariable):
            yield slug(each.name), each.name, each
            continue
        for sub, variable in each.items():
            if sub:
                yield (
                    f"{slug(each.name)}/{slug(variable.name)}",
                    f"{each.name}: {variable.name}",
                    variable,
                )
