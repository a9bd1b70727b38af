"""The PDO mapping: as the gateway sets it, or as the drive's EDS describes it."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

from rcp_can.codec import Field, Layout
from rcp_can.eds_file import load_eds
from rcp_can.profiles.cia402_objects import OBJECTS, OFFSET_PDO, PDOS, Pdo
from rcp_kernel.errors import ConfigError

if TYPE_CHECKING:
    from canopen.objectdictionary import ObjectDictionary

__all__ = ["MappedPdo", "PdoMap", "eds_map", "own_map", "own_pdos"]

_NAMES = {(index, sub): (name, code) for name, (index, sub, code) in OBJECTS.items()}
_NEEDED = {
    "receive": ("controlword", "mode", "target_position"),
    "transmit": ("statusword", "mode_shown", "position"),
}
_INVALID = 0x8000_0000


class MappedPdo(NamedTuple):
    """One mapped PDO of a node."""

    cob: int
    layout: Layout


class PdoMap:
    """All PDOs of one node: those that command it, and its feedback by identifier."""

    def __init__(self, commands: Iterable[MappedPdo], feedback: dict[int, Layout]) -> None:
        self.commands, self.feedback = tuple(commands), feedback
        self._carrying: dict[tuple[str, ...], tuple[MappedPdo, ...]] = {}

    def carrying(self, *names: str) -> tuple[MappedPdo, ...]:
        """Return a small set of command PDOs that together carry some objects.

        Those with a target come first: the control word that makes it valid must not arrive before
        it.
        """
        found = self._carrying.get(names)
        if found is None:
            few = self._fewest(self.commanded.intersection(names))
            found = tuple(sorted(few, key=lambda pdo: "target_position" not in pdo.layout.names))
            self._carrying[names] = found
        return found

    def _fewest(self, names: frozenset[str]) -> Iterator[MappedPdo]:
        left = set(names)
        while left:
            best = max(self.commands, key=lambda pdo: len(left.intersection(pdo.layout.names)))
            left.difference_update(best.layout.names)
            yield best

    @property
    def commanded(self) -> frozenset[str]:
        """The objects that can be commanded."""
        return frozenset(name for pdo in self.commands for name in pdo.layout.names)


def own_pdos(*, offset: bool = False) -> list[Pdo]:
    """Return the PDOs that the gateway maps; with `offset`, a torque is fed forward."""
    return list((PDOS | {"command_rate": OFFSET_PDO} if offset else PDOS).values())


def own_map(node: int, *, offset: bool = False) -> PdoMap:
    """Return the PDOs as the gateway maps them."""
    pdos = own_pdos(offset=offset)
    commands = [MappedPdo(pdo.cob + node, pdo.layout) for pdo in pdos if pdo.parameters < 0x1800]
    feedback = {pdo.cob + node: pdo.layout for pdo in pdos if pdo.parameters >= 0x1800}
    return PdoMap(commands, feedback)


def eds_map(file: str, node: int) -> PdoMap:
    """Return the PDO mapping that an EDS describes; the drive may have been remapped since.

    :raises ConfigError: required objects are not mapped, or the file cannot be read.
    """
    dictionary = load_eds(f"node {node}", file, node)
    found = PdoMap(
        _pdos(dictionary, range(0x1400, 0x1600)),
        {pdo.cob: pdo.layout for pdo in _pdos(dictionary, range(0x1800, 0x1A00))},
    )
    seen = frozenset(name for layout in found.feedback.values() for name in layout.names)
    for direction, has in (("receive", found.commanded), ("transmit", seen)):
        if missing := [name for name in _NEEDED[direction] if name not in has]:
            words = ", ".join(f"0x{OBJECTS[name][0]:04X} ({name})" for name in missing)
            raise ConfigError(
                f"{file}: no {direction} PDO carries {words}; let the gateway map the PDOs (map_pdos = true)"
            )
    return found


def _pdos(dictionary: ObjectDictionary, parameters: Iterable[int]) -> Iterator[MappedPdo]:
    for index in parameters:
        if index not in dictionary or index + 0x200 not in dictionary:
            continue
        record: Any = dictionary[index]
        mapping: Any = dictionary[index + 0x200]
        cob = record[1].default
        count = mapping[0].default or 0
        if cob is None or cob & _INVALID or not count:
            continue
        words = [mapping[sub].default or 0 for sub in range(1, count + 1)]
        yield MappedPdo(cob & 0x7FF, Layout("<", *map(_field, words)))


def _field(word: int) -> Field:
    """Return the field of a mapped object; padding for one that the profile does not know."""
    bits = word & 0xFF
    if bits % 8:
        raise ConfigError(
            f"0x{word:08X} is mapped with {bits} bits, which is not a whole number of bytes"
        )
    name, code = _NAMES.get((word >> 16, word >> 8 & 0xFF), ("", ""))
    if not name or 8 * struct.calcsize(code) != bits:
        return Field("", f"{bits // 8}x")
    return Field(name, code)
