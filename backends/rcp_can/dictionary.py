"""The object dictionary of a CANopen node as a file: dump it, or compare the node with one."""

from __future__ import annotations

import asyncio
from typing import Annotated, Any

from msgspec import Meta, Struct

from rcp_can.binding import Part
from rcp_can.config_node import NodeConfig
from rcp_can.dcf import Object, objects_of, read_dcf, value_text, write_dcf
from rcp_can.eds_file import load_eds
from rcp_can.eds_node import COMMANDS
from rcp_can.messages import Count
from rcp_can.sdo import Sdo, SdoAborted
from rcp_kernel.model import READS, Resource
from rcp_kernel.spi import Progress

__all__ = ["Comparison", "DictionaryFile", "DictionaryPart", "Difference", "Dump"]

_TIMEOUT = 300.0  # s; some nodes have thousands of objects
_LONGEST = 2_000_000  # characters of a file


class DictionaryFile(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A file to compare with."""

    text: Annotated[str, Meta(max_length=_LONGEST)]
    """The content of a .dcf file (CiA 306)."""


class Dump(Struct, frozen=True, kw_only=True):
    """The dictionary of a node."""

    text: str
    """A .dcf file with the node's values, which other CANopen tools read."""
    objects: Count
    """How many values it has."""
    refused: list[str]
    """What the node refused to tell, with its reason."""


class Difference(Struct, frozen=True, kw_only=True):
    """An object that is not as in the file."""

    object: str
    """Index and sub-index, such as `0x6098:00`."""
    name: str
    file: str
    node: str


class Comparison(Struct, frozen=True, kw_only=True):
    """How a node differs from a file; objects that only tell or command something are left out."""

    differences: list[Difference]
    compared: Count
    refused: list[str]
    """What the node refused to tell, with its reason."""
    unknown: list[str]
    """Objects of the file that are not in the node's EDS."""


class DictionaryPart(Part):
    """The dictionary of one node."""

    def __init__(self, name: str, config: NodeConfig, sdo: Sdo) -> None:
        self._name, self._config, self._sdo = name, config, sdo
        self._dump, self._compare = f"service/{name}/dump", f"service/{name}/compare"

    def resources(self) -> list[Resource]:
        """List the two services."""
        return [
            Resource(
                name=self._dump,
                description=f"Read the whole object dictionary of node '{self._name}' into a file.",
                output=Dump,
                timeout=_TIMEOUT,
                meta=READS,
            ),
            Resource(
                name=self._compare,
                description=f"Compare the settings of node '{self._name}' with a file.",
                input=DictionaryFile,
                output=Comparison,
                examples=({"text": "[1017]\nParameterName=Heartbeat\nParameterValue=100\n"},),
                timeout=_TIMEOUT,
                meta=READS,
            ),
        ]

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        """Dump or compare.

        :raises InvalidValue: the file cannot be used.
        :raises DeviceTimeout: the node does not respond.
        """
        config = self._config
        if name == self._compare:
            wanted = await asyncio.to_thread(read_dcf, value.text, config.node)
            return await self._compared(wanted)
        dictionary = await self._load()
        dictionary.node_id = config.node
        values, refused = await self._read(objects_of(dictionary))
        text = await asyncio.to_thread(write_dcf, dictionary, values)
        return Dump(text=text, objects=len(values), refused=refused)

    async def _load(self) -> Any:
        config = self._config
        return await asyncio.to_thread(load_eds, f"nodes.{self._name}", config.eds, config.node)

    async def _read(self, objects: list[Object]) -> tuple[dict[tuple[int, int], Any], list[str]]:
        values: dict[tuple[int, int], Any] = {}
        refused: list[str] = []
        for each in objects:
            try:
                values[each.address] = each.entry.unpack(await self._sdo.upload(*each.address))
            except SdoAborted as aborted:
                refused.append(f"{each.name}: {aborted.message}")
        return values, refused

    async def _compared(self, wanted: dict[tuple[int, int], Any]) -> Comparison:
        known = {each.address: each for each in objects_of(await self._load())}
        settings = [
            each
            for address, each in known.items()
            if address in wanted and each.entry.writable and each.entry.index not in COMMANDS
        ]
        values, refused = await self._read(settings)
        found = [
            Difference(
                object=_place(each.address),
                name=each.name,
                file=value_text(wanted[each.address]),
                node=value_text(values[each.address]),
            )
            for each in settings
            if each.address in values and values[each.address] != wanted[each.address]
        ]
        unknown = [_place(address) for address in wanted if address not in known]
        return Comparison(differences=found, compared=len(values), refused=refused, unknown=unknown)


def _place(address: tuple[int, int]) -> str:
    return f"0x{address[0]:04X}:{address[1]:02X}"
