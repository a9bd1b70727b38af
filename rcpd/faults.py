"""All faults of a table at once: each is noted, taken out, and the rest read on."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from datetime import date, time
from typing import Any, get_args, get_origin

import msgspec

from rcp_protocol.plain import is_list, is_map
from rcp_protocol.similarity import closest
from rcp_protocol.validation import fault_of
from rcp_toml.positions import Place
from rcpd.words import choices, expected, members, split_annotated

__all__ = ["FAULTY", "Collector", "Fault", "place_in"]

FAULTY: Any = object()
"""Stands for a node of which nothing is left."""


class Fault(msgspec.Struct, frozen=True):
    """One fault of a configuration."""

    place: Place
    message: str
    """What is wrong and what to write instead."""
    missing: str | None = None
    """The key that is not there and has to be."""
    line: int | None = None
    """Where the file has no node at the place: that of a fault of the form itself."""
    file: str | None = None
    """The included file of such a line."""
    partial: bool = False
    """Whether the gateway starts all the same, and serves whatever else there is."""


class Collector:
    """Reads plain data by types, up to a number of faults."""

    def __init__(
        self, show: Callable[[Place, Any], str], top: Collection[str], most: int = 100
    ) -> None:
        self.faults: list[Fault] = []
        self.full = False
        """Whether there were more faults than are kept."""
        self._show = show
        self._top = top
        self._most = most
        self._kept: dict[Place, list[int]] = {}

    def add(
        self,
        place: Place,
        message: str,
        *,
        missing: str | None = None,
        line: int | None = None,
        file: str | None = None,
        partial: bool = False,
    ) -> None:
        """Note a fault, unless there is one at this place that says the same."""
        fault = Fault(place, message, missing, line, file, partial)
        if fault in self.faults:
            return
        if len(self.faults) < self._most:
            self.faults.append(fault)
        else:
            self.full = True

    def original(self, place: Place) -> Place:
        """Return the place in the file of a node of what was left."""
        found: Place = ()
        for step in place:
            kept = self._kept.get(found)
            if isinstance(step, int) and kept is not None and step < len(kept):
                found = (*found, kept[step])
            else:
                found = (*found, step)
        return found

    def read(self, node: Any, type_: Any, place: Place, known: Collection[str] = ()) -> Any:
        """Return what is left of a node without its faults; `known` are keys read elsewhere."""
        if self.full or node is FAULTY:
            return FAULTY
        bare = _branch(node, type_)
        if bare is Any:
            return node
        before = len(self.faults)
        origin = get_origin(bare) or bare
        if is_map(node) and isinstance(bare, type) and issubclass(bare, msgspec.Struct):
            left = self._struct(node, bare, place, known)
        elif is_map(node) and isinstance(origin, type) and issubclass(origin, Mapping):
            left = self._map(node, get_args(bare), place)
        elif is_list(node) and (item := _item(bare)) is not None:
            left = self._list(node, item, place)
        else:
            left = node
        if left is FAULTY:
            return FAULTY
        # What is said of the whole may be wrong only because something was taken out of it.
        return self._whole(left, type_, place, quiet=len(self.faults) > before)

    def _struct(
        self,
        node: dict[str, Any],
        type_: type[msgspec.Struct],
        place: Place,
        known: Collection[str],
    ) -> Any:
        fields = {field.encode_name: field for field in msgspec.structs.fields(type_)}
        lacking = [name for name, field in fields.items() if field.required and name not in node]
        settings = type_.__struct_config__
        left: dict[str, Any] = {}
        whole = True
        for key, value in node.items():
            if key == settings.tag_field:
                left[key] = value
            elif key in fields:
                read = self.read(value, fields[key].type, (*place, key))
                if read is not FAULTY:
                    left[key] = read
                elif fields[key].required:
                    whole = False
            elif settings.forbid_unknown_fields:
                near = self._unknown(key, value, [*fields, *known], (*place, key))
                if near in lacking:
                    lacking.remove(near)
                    whole = False
        for name in lacking:
            self.add(place, f"needs `{name}`: {expected(fields[name].type)}", missing=name)
        return left if whole and not lacking else FAULTY

    def _unknown(self, key: str, value: Any, allowed: list[str], place: Place) -> str | None:
        if key in self._top and len(place) > 1:
            mend = f"write [{key}]" if is_map(value) else "move it above the first table"
            self.add(place, f"belongs to the top level of the file: {mend}")
            return None
        near = closest(key, allowed)
        advice = f"did you mean `{near}`? Allowed: " if near else "allowed: "
        words = ", ".join(sorted(set(allowed))) or "none"
        self.add(place, f"unknown key; {advice}{words}")
        return near

    def _map(self, node: dict[str, Any], types: tuple[Any, ...], place: Place) -> Any:
        key_type, value_type = types if len(types) == 2 else (Any, Any)
        left: dict[str, Any] = {}
        for key, value in node.items():
            try:
                msgspec.convert(key, key_type)
            except msgspec.ValidationError:
                self.add((*place, key), f"the name does not fit: write {expected(key_type)}")
                continue
            read = self.read(value, value_type, (*place, key))
            if read is not FAULTY:
                left[key] = read
        return left

    def _list(self, node: list[Any], item: Any, place: Place) -> Any:
        left: list[Any] = []
        kept: list[int] = []
        for index, value in enumerate(node):
            read = self.read(value, item, (*place, index))
            if read is not FAULTY:
                left.append(read)
                kept.append(index)
        self.keep(place, kept)
        return left

    def keep(self, place: Place, kept: list[int]) -> None:
        """Note which items are left of a list."""
        self._kept[place] = kept

    def _whole(self, node: Any, type_: Any, place: Place, *, quiet: bool) -> Any:
        """Check what a type says of the whole node."""
        try:
            msgspec.convert(node, type_, strict=True)
        except msgspec.ValidationError as error:
            if quiet:
                return FAULTY
            fault = fault_of(error)
            at = _inside(node, fault.place, place)
            if is_map(node) and fault.what.startswith(("Expected", "Object", "Invalid")):
                self.add(at, f"write {expected(type_)}")
            elif is_map(node):  # its own words
                self.add(place_in(fault.what, node, place), fault.what)
            else:
                self.add(place, self._unfit(node, type_, place))
            return FAULTY
        return node

    def _unfit(self, node: Any, type_: Any, place: Place) -> str:
        words = choices(type_)
        near = closest(node, words) if words and isinstance(node, str) else None
        advice = f'; did you mean "{near}"?' if near else ""
        if isinstance(node, str) and expected(type_).startswith("a list"):
            advice = ", with [ ] around it"
        elif isinstance(node, (date, time)) and expected(type_).startswith("a text"):
            advice = ", in quotes"
        return f"{self._show(place, node)} does not fit: write {expected(type_)}{advice}"


def _branch(node: Any, type_: Any) -> Any:
    """Return the member of a union that is meant by the form of a node, without annotations."""
    bare, _ = split_annotated(type_)
    several = [split_annotated(one)[0] for one in members(bare)]
    if len(several) == 1:
        return bare
    maps = [one for one in several if _is_table(one)]
    if is_map(node) and len(maps) == 1:
        return maps[0]
    if is_map(node):
        return next((one for one in maps if _tagged(one, node)), object)
    if is_list(node):
        return next((one for one in several if _item(one) is not None), object)
    return object


def _is_table(type_: Any) -> bool:
    origin = get_origin(type_) or type_
    return isinstance(origin, type) and issubclass(origin, (msgspec.Struct, Mapping))


def _tagged(type_: Any, node: dict[str, Any]) -> bool:
    settings = getattr(type_, "__struct_config__", None)
    return settings is not None and (
        settings.tag_field is not None and node.get(settings.tag_field) == settings.tag
    )


def _item(type_: Any) -> Any:
    """Return the type of a list's items; None if it is no list of one type."""
    origin, types = get_origin(type_), get_args(type_)
    if origin is tuple:
        return types[0] if len(types) == 2 and types[1] is Ellipsis else None
    if origin in (list, set, frozenset) or getattr(origin, "__name__", "") == "Sequence":
        return types[0]
    return None


_STEP = re.compile(r"[^.\[\]]+")


def _inside(node: Any, path: str, place: Place) -> Place:
    """Return the place of a path as msgspec writes it, as far as the node has it."""
    for step in _STEP.findall(path):
        if is_map(node) and step in node:
            node, place = node[step], (*place, step)
        elif is_list(node) and step.isdigit() and int(step) < len(node):
            node, place = node[int(step)], (*place, int(step))
        else:
            break
    return place


_QUOTED = re.compile(r"`([\w.-]+)`|([\w-]+(?:\.[\w-]+|\[\d+\])*)(?=[ :=])")


def place_in(message: str, node: Any, place: Place) -> Place:
    """Return the place that a message names: by a key in backticks or in front, or by its value."""
    for found in _QUOTED.finditer(message.partition(" needs ")[0]):
        at = _inside(node, found[1] or found[2], place)
        if at != place and (found[1] or found.start() == 0):
            return at
    quoted = _VALUE.search(message)
    at = quoted and _place_of(quoted[1], node, place)
    return _beside(at, message, node, place) if at else place


def _beside(at: Place, message: str, node: Any, place: Place) -> Place:
    """Return the place of a key that a message names in the table of a value, or that of the value."""
    table = node
    for step in at[len(place) : -1]:
        table = table[step]
    named = (found[1] for found in _QUOTED.finditer(message) if found[1])
    key = next((one for one in named if is_map(table) and one in table), None)
    return (*at[:-1], key) if key else at


_VALUE = re.compile(r"'([^']+)'")


def _place_of(value: str, node: Any, place: Place) -> Place | None:
    """Return the place of a string within a node."""
    if is_map(node):
        steps: list[tuple[str | int, Any]] = list(node.items())
    elif is_list(node):
        steps = list(enumerate(node))
    else:
        return place if node == value else None
    found = (_place_of(value, item, (*place, step)) for step, item in steps)
    return next((one for one in found if one is not None), None)
