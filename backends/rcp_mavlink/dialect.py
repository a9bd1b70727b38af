"""The messages of a dialect, from the classes that pymavlink generates from its XML."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Annotated, Any

import msgspec

from rcp_kernel.errors import ConfigError
from rcp_kernel.types import quantity
from rcp_mavlink.component_messages import COMPONENT_MESSAGES
from rcp_mavlink.message_builder import Field, making
from rcp_mavlink.units import converted
from rcp_mavlink.xml_dialect import module_of

__all__ = ["Definition", "Dialect", "Field", "dialect"]

_LINE = re.compile(r"^ +(\w+) +: (.*?)(?: \[[^\]]*\])? \(type:[^)]*\)$", re.MULTILINE)
_SENTINEL = re.compile(r"\b(U?INT(?:8|16|32)_MAX)\b")
_MINUS_ONE = re.compile(r"(?<![\w.-])-1\b(?:[:,]| (?:means|if|for|indicates))")
_SENTINELS = {
    "UINT8_MAX": 255, "UINT16_MAX": 65535, "UINT32_MAX": 2**32 - 1,
    "INT8_MAX": 127, "INT16_MAX": 32767, "INT32_MAX": 2**31 - 1,
}  # fmt: skip
_NAME = re.compile(r"\w+\Z")
_SIZES = {
    "char": 1, "uint8_t": 1, "int8_t": 1, "uint16_t": 2, "int16_t": 2, "uint32_t": 4,
    "int32_t": 4, "float": 4, "uint64_t": 8, "int64_t": 8, "double": 8,
}  # fmt: skip
_TIMES = {"time_boot_ms": "uint32_t", "time_usec": "uint64_t"}
_CLOCKS = ("SYSTEM_TIME", "TIMESYNC")
_NEEDED = {
    "ATTITUDE", "COMMAND_ACK", "COMMAND_INT", "COMMAND_LONG", "EXTENDED_SYS_STATE",
    "FILE_TRANSFER_PROTOCOL", "GLOBAL_POSITION_INT", "HEARTBEAT", "HOME_POSITION", "LOG_DATA",
    "LOG_ENTRY", "MISSION_ACK", "MISSION_COUNT", "MISSION_CURRENT", "MISSION_ITEM_INT",
    "MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_REQUEST_LIST", "PARAM_REQUEST_LIST",
    "PARAM_REQUEST_READ", "PARAM_SET", "PARAM_VALUE", "SET_ATTITUDE_TARGET",
    "SET_POSITION_TARGET_LOCAL_NED", "STATUSTEXT", "SYS_STATUS",
}  # fmt: skip
"""Messages required to control a vehicle."""


class Definition:
    """One message of a dialect: its decoder and its type in the tree."""

    def __init__(self, module: Any, cls: Any) -> None:
        self.cls = cls
        self.name: str = cls.msgname
        self.id: int = cls.id
        self.crc_extra: int = cls.crc_extra
        self.unpack: Callable[[bytes], tuple[Any, ...]] = cls.unpacker.unpack
        self.size: int = cls.unpacker.size
        self._module = module

    @cached_property
    def description(self) -> str:
        """Its description in the dialect."""
        text = re.sub(r"\s+", " ", self.cls.__doc__ or "").strip()
        return text if text.endswith(".") else f"{text or self.name}."

    @cached_property
    def fields(self) -> tuple[Field, ...]:
        """Its fields, in the order of the XML."""
        cls, found = self.cls, list[Field]()
        encode = getattr(self._module.MAVLink, f"{self.name.lower()}_encode", None)
        descriptions = dict(_LINE.findall(encode.__doc__ or "")) if encode is not None else {}
        for at, name in enumerate(cls.fieldnames):
            order = cls.orders[at]
            kind, length = cls.fieldtypes[at], cls.array_lengths[order]
            unit, factor = converted(cls.fieldunits_by_name.get(name, ""), kind)
            description = descriptions.get(name, "")
            place = sum(cls.lengths[:order])
            found.append(
                Field(name, kind, unit, factor, length, self._words(name), _missing(description, kind), description, place)
            )  # fmt: skip
        return tuple(found)

    @cached_property
    def stamp(self) -> tuple[int, int, int] | None:
        """Offset and size (bytes) of the time of measurement in the payload, and its unit in ns."""
        cls, place = self.cls, 0
        kinds = dict(zip(cls.fieldnames, cls.fieldtypes, strict=True))
        for name, length in zip(cls.ordered_fieldnames, cls.array_lengths, strict=True):
            size = _SIZES[kinds[name]]
            if _TIMES.get(name) == kinds[name] and self.name not in _CLOCKS:
                return place, size, 1_000_000 if size == 4 else 1000
            place += size * max(1, length)
        return None

    def _words(self, field: str) -> dict[int, str] | None:
        """Return the names of an enumeration field; None for numbers and bit masks."""
        name = self.cls.fieldenums_by_name.get(field)
        entries = self._module.enums.get(name)
        if entries is None or entries.bitmask:
            return None
        words = {n: e.name for n, e in entries.items() if not e.name.endswith("_ENUM_END")}
        start = f"{name}_"
        return {n: word.removeprefix(start).lower() for n, word in words.items()}

    @cached_property
    def type(self) -> Any:
        """The type of its values in the tree."""
        fields = [(field.name, _type(field)) for field in self.fields]
        name = "".join(part.title() for part in self.name.split("_"))
        return msgspec.defstruct(name, fields, frozen=True, module="rcp_mavlink.messages")

    @cached_property
    def _made(self) -> Callable[[tuple[Any, ...]], Any]:
        return making(self.type, self.fields)

    def decode(self, payload: bytes) -> Any:
        """Return the value of a payload, in the units of the tree."""
        return self._made(self.raw(payload))

    def fields_of(self, payload: bytes) -> dict[str, Any]:
        """Return the fields of a payload as on the wire; arrays are lists."""
        values = self.raw(payload)
        return {
            f.name: list(values[f.place : f.place + f.length])
            if f.length and f.kind != "char"
            else values[f.place]
            for f in self.fields
        }

    def raw(self, payload: bytes) -> tuple[Any, ...]:
        """Unpack a payload; restores truncated zeros."""
        return self.unpack(payload[: self.size].ljust(self.size, b"\0"))


def _missing(description: str, kind: str) -> float | None:
    if kind in ("float", "double", "char"):
        return None
    if (found := _SENTINEL.search(description)) is not None:
        return _SENTINELS[found[1]]
    return -1 if _MINUS_ONE.search(description) and kind.startswith("int") else None


def _type(field: Field) -> Any:
    if field.kind == "char":
        return str
    if field.length and field.kind == "uint8_t" and field.unit == "1":
        return bytes
    one = _one(field)
    return list[one] if field.length else one


def _one(field: Field) -> Any:
    text = field.description or None
    if field.enum is not None:
        return str
    if field.kind in ("float", "double"):
        return quantity(field.unit, may_be_nonfinite=True, description=text)
    if field.factor != 1:
        number: Any = quantity(field.unit, description=text)
    elif field.kind == "uint64_t":
        extra: Any = {"unit": field.unit, "maximum": 2**64 - 1}
        number = Annotated[int, msgspec.Meta(ge=0, extra_json_schema=extra)]
    else:
        number = quantity(field.unit, int, description=text)
    return number | None if field.missing is not None else number


class Dialect:
    """All messages of a dialect by id and by name; `module` builds messages to send."""

    def __init__(self, module: Any) -> None:
        self.module = module
        classes = COMPONENT_MESSAGES | module.mavlink_map
        self.by_id = {n: Definition(module, cls) for n, cls in classes.items()}
        self.by_name = {definition.name: definition for definition in self.by_id.values()}


def dialect(name: str) -> Dialect:
    """Load a dialect by its name, or from an XML file, which takes seconds.

    :raises ConfigError: it does not exist, or lacks a required message.
    """
    found = Dialect(module_of(Path(name))) if name.endswith(".xml") else _of_pymavlink(name)
    missing = sorted(_NEEDED - found.by_name.keys())
    if missing:
        raise ConfigError(
            f"`dialect`: {name} has no {', '.join(missing[:3])}{', …' if missing[3:] else ''}: "
            "include common.xml"
        )
    return found


@lru_cache(maxsize=8)
def _of_pymavlink(name: str) -> Dialect:
    if not _NAME.match(name):
        raise ConfigError(f"`dialect`: {name!r} is neither a dialect nor an XML file")
    try:
        return Dialect(importlib.import_module(f"pymavlink.dialects.v20.{name}"))
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"`dialect`: pymavlink has no {name!r}; use one of its dialects, or an XML file"
        ) from error
