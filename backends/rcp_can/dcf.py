"""Device configuration files (CiA 306): the values of a dictionary as text, and back."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from rcp_can.eds_types import Entry, entry_of
from rcp_kernel.errors import InvalidValue

if TYPE_CHECKING:
    from canopen.objectdictionary import ObjectDictionary, ODVariable

__all__ = ["Object", "objects_of", "read_dcf", "value_text", "write_dcf"]


class Object(NamedTuple):
    """One object of a dictionary."""

    name: str
    entry: Entry
    variable: ODVariable

    @property
    def address(self) -> tuple[int, int]:
        """Index and sub-index."""
        return self.entry.index, self.entry.sub


def objects_of(dictionary: ObjectDictionary) -> list[Object]:
    """List the readable objects of a dictionary that have a value."""
    from canopen.objectdictionary import ODVariable

    found: list[Object] = []
    for each in dictionary.values():
        if isinstance(each, ODVariable):
            parts = [(each.name, each)]
        else:
            parts = [(f"{each.name}: {part.name}", part) for part in each.values()]
        for name, variable in parts:
            entry = entry_of(variable)
            if entry is not None and entry.readable:
                found.append(Object(name, entry, variable))
    return found


def write_dcf(dictionary: ObjectDictionary, values: Mapping[tuple[int, int], Any]) -> str:
    """Return a DCF with these values; changes the dictionary."""
    import canopen

    for each in objects_of(dictionary):
        variable: Any = each.variable
        known = each.address in values
        variable.value = None
        # In decimal: canopen writes negative numbers so that nobody can read them.
        variable.value_raw = value_text(values[each.address]) if known else None
    text = io.StringIO()
    canopen.export_od(dictionary, text, doc_type="dcf")
    return text.getvalue()


def read_dcf(text: str, node: int) -> dict[tuple[int, int], Any]:
    """Return the values in a DCF, as objects of CANopen.

    :raises InvalidValue: it is not a DCF, or has no values.
    """
    from canopen.objectdictionary.eds import import_eds

    try:
        dictionary: Any = import_eds(io.StringIO(text), node)
        found = {
            each.address: each.variable.value
            for each in objects_of(dictionary)
            if each.variable.value is not None
        }
    except Exception as error:
        raise InvalidValue(
            f"this is not a DCF: {error}",
            details={"pointer": "/text"},
            remedy="Give the text of a .dcf file, such as `dump` returns.",
        ) from error
    if not found:
        raise InvalidValue(
            "the file has no values (`ParameterValue`)",
            details={"pointer": "/text"},
            remedy="Give the text of a .dcf file; an .eds file has only defaults.",
        )
    return found


def value_text(value: Any) -> str:
    """Return a value as a DCF has it, with numbers in decimal."""
    if isinstance(value, bytes):
        return value.hex()
    return str(int(value)) if isinstance(value, bool) else str(value)
