"""A CDR decoder, compiled for each message type: straight-line code, no interpretation.

Runs of fixed-size fields become one `struct` call, alignment is computed at compile time wherever
possible, and only the fields of a projection are built. Values that nobody uses are never decoded:
a `Native` decodes on first access.

The encoding is XCDR version 1, as every ROS 2 middleware writes it: a header of four bytes, then
each primitive aligned to its size, counted from the end of the header.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

from rcp_ros2.idl import WIDTHS, Primitive, Ref, Sequence, Text, Type, fields_of, full_name
from rcp_ros2.types import bare, is_bytes, outward

__all__ = ["Codec", "Malformed", "Value", "is_stamped"]

Decoder = Callable[[bytes], Any]
_ORDERS = {b"\x00\x01": "<", b"\x00\x00": ">"}
_HEADER = 4


class Malformed(ValueError):
    """The bytes are not a valid message of this type."""


class Codec:
    """The decoder of a message type, or of one part of it."""

    def __init__(self, cls: Any, path: str | None = None, unit: str | None = None) -> None:
        self.name = full_name(cls)
        self.type = outward(cls, path, unit)
        self._whole = outward(cls, None, unit)
        self.cls = cls
        self._path = path.split(".") if path else None
        self._stamped = is_stamped(cls)
        self._decoders: dict[bytes, Decoder] = {}

    def decode(self, data: bytes) -> Any:
        """Return the typed value.

        :raises Malformed: the bytes are truncated, or in another encoding.
        """
        decoder = self._decoders.get(data[:2]) or self._compiled(data[:2])
        try:
            return decoder(data)
        except (struct.error, IndexError) as error:
            raise Malformed(f"cannot decode {len(data)} bytes as {self.name}: {error}") from None

    def concerns(self, data: bytes) -> bool:
        """Return whether a message of the topic has a part of the value."""
        return True

    def stamp(self, data: bytes) -> int | None:
        """Return the time in the message's header, ns since the epoch; None without a header."""
        if not self._stamped or len(data) < _HEADER + 8:
            return None
        order = _ORDERS.get(data[:2], "<")
        second, nano = struct.unpack_from(order + "iI", data, _HEADER)
        return second * 1_000_000_000 + nano if second > 0 else None

    def _compiled(self, header: bytes) -> Decoder:
        order = _ORDERS.get(header)
        if order is None:
            raise Malformed(f"encapsulation {header.hex() or 'missing'} of {self.name} is not CDR")
        made = _Module(order).compile(self.cls, self._whole, self._path)
        self._decoders[header] = made
        return made


class Value:
    """A message in serialized form."""

    __slots__ = ("_codec", "data")

    def __init__(self, data: bytes, codec: Codec) -> None:
        self.data = data
        self._codec = codec

    def decode(self) -> Any:
        """Return the typed value."""
        return self._codec.decode(self.data)


def is_stamped(cls: Any) -> bool:
    """Return whether a message begins with a header."""
    fields = fields_of(cls)
    first = fields[0].type if fields else None
    return isinstance(first, Ref) and full_name(first.cls) == "std_msgs/msg/Header"


def _text(data: bytes) -> str:
    return str(data, "utf-8", "replace")


def _wide(data: bytes, at: int, count: int, order: str) -> str:
    """Decode UTF-16 code units, each stored in four bytes."""
    units = struct.unpack_from(f"{order}{count}I", data, at)
    try:
        return struct.pack(f"<{count}H", *units).decode("utf-16-le", "replace")
    except struct.error:
        return "".join(map(chr, units))


class _Module:
    """The functions that together decode one type."""

    def __init__(self, order: str) -> None:
        self.order = order
        self.names: dict[str, Any] = {
            "T": _text,
            "W": _wide,
            "F": struct.unpack_from,
            "Malformed": Malformed,
        }
        self._parts: dict[Any, str] = {}
        self._sources: list[str] = []

    def compile(self, cls: Any, type_: Any, path: list[str] | None) -> Decoder:
        body = _Function(self, offset=0)
        result = body.message(cls, type_, path)
        body.flush()
        source = (
            "def decode(b):\n    e = len(b)\n    p = 4\n"
            + body.text()
            + "    if p > e: raise Malformed('the message is truncated')\n"
            + f"    return {result}\n"
        )
        exec("\n".join([*self._sources, source]), self.names)  # noqa: S102 - made from types alone
        return self.names["decode"]

    def bind(self, value: Any, letter: str) -> str:
        """Return a name by which the generated code can refer to a value."""
        for name, known in self.names.items():
            if known is value:
                return name
        name = f"{letter}{len(self.names)}"
        self.names[name] = value
        return name

    def part(self, cls: Any, type_: Any) -> str:
        """Return the name of a function that decodes one element of a sequence."""
        if type_ not in self._parts:
            name = self._parts[type_] = f"D{len(self._parts)}"
            body = _Function(self)
            result = body.message(cls, type_, None)
            body.flush()
            self._sources.append(
                f"def {name}(b, p):\n    e = len(b)\n{body.text()}    return {result}, p\n"
            )
        return self._parts[type_]


class _Function:
    """A function being generated: its statements so far, and a pending run of fixed fields.

    The position is known modulo `self._mod`, where its remainder is `self._rest`.
    """

    def __init__(self, module: _Module, offset: int | None = None) -> None:
        self._module = module
        self._lines: list[str] = []
        self._indent = "    "
        self._mod, self._rest = (1, 0) if offset is None else (8, offset)
        self._run: list[str] = []
        self._size = 0
        self._count = 0
        self._tuple = ""
        self._tuples = 0

    def text(self) -> str:
        return "".join(f"{self._indent}{line}\n" for line in self._lines)

    # -- fixed runs ------------------------------------------------------------------------------

    def _take(self, letter: str, width: int, count: int = 1, *, packed: bool = False) -> str:
        """Append fixed data to the run; return its expression (a slice if `count` > 1)."""
        align = 1 if packed else width
        pad = self._pad(align)
        if not self._run:
            self._tuples += 1
            self._tuple = f"t{self._tuples}"
        if pad:
            self._run.append(f"{pad}x")
        values = 1 if packed else count
        self._run.append(f"{count}{letter}" if count != 1 or packed else letter)
        self._size += pad + width * count
        self._rest = (self._rest + width * count) % self._mod
        start = self._count
        self._count += values
        if packed or count == 1:
            return f"{self._tuple}[{start}]"
        return f"{self._tuple}[{start}:{start + count}]"

    def _pad(self, align: int) -> int:
        """Return the padding before an aligned field; align at run time if it is unknown."""
        if self._mod < align:
            self.flush()
            if align == 8:
                self._lines.append("p = ((p + 3) & -8) + 4")
            else:
                self._lines.append(f"p = (p + {align - 1}) & -{align}")
            self._mod, self._rest = align, 0
            return 0
        pad = -self._rest % align
        self._rest = (self._rest + pad) % self._mod
        return pad

    def flush(self) -> None:
        """Emit the pending run as one `unpack` call."""
        if not self._run:
            return
        unpack = struct.Struct(self._module.order + "".join(self._run))
        name = self._module.bind(unpack.unpack_from, "S")
        self._lines.append(f"{self._tuple} = {name}(b, p); p += {self._size}")
        self._run, self._size, self._count = [], 0, 0

    # -- types -----------------------------------------------------------------------------------

    def message(self, cls: Any, type_: Any, path: list[str] | None) -> str:
        """Generate the code for a message; return the expression of its value, or of its part.

        Without a type, the message is only skipped.
        """
        fields = fields_of(cls)
        if not fields:  # C forbids empty structs: rosidl inserts one byte
            self._take("B", 1)
        values: list[str] = []
        for field in fields:
            if path and field.name == path[0]:
                return self._value(field.type, _declared(type_, field.name), path[1:] or None)
            inner = None if path or type_ is None else _declared(type_, field.name)
            values.append(self._value(field.type, inner, None))
        if type_ is None:
            return "None"
        return f"{self._module.bind(type_, 'C')}({', '.join(values)})"

    def _value(self, type_: Type, typed: Any, path: list[str] | None) -> str:
        match type_:
            case Primitive(name):
                return self._take(*WIDTHS[name])
            case Text(_, wide):
                return self._string(wide=wide, skipped=typed is None)
            case Ref(cls):
                return self.message(cls, typed, path)
            case Sequence(item, None, _):
                return self._sequence(item, typed)
            case Sequence(item, size, _):
                return self._array(item, size or 0, typed)

    def _length(self) -> str:
        length = self._take("I", 4)
        self.flush()
        name = self._fresh("n")
        self._lines.append(f"{name} = {length}")
        return name

    def _fresh(self, letter: str) -> str:
        return f"{letter}{len(self._lines)}"

    def _string(self, *, wide: bool, skipped: bool) -> str:
        n, v = self._length(), self._fresh("v")
        if wide:
            self._lines.append(f"{v} = W(b, p, {n}, {self._module.order!r}); p += 4 * {n}")
            self._mod, self._rest = 4, 0
            return v
        if not skipped:
            self._lines.append(f"{v} = T(b[p:p + {n} - 1]) if {n} > 1 else ''")
        self._lines.append(f"p += {n}")
        self._mod, self._rest = 1, 0
        return v

    def _array(self, item: Type, size: int, typed: Any) -> str:
        if is_bytes(item):
            return self._take("s", 1, size, packed=True)
        if isinstance(item, Primitive):
            many = self._take(*WIDTHS[item.name], count=size)
            return f"({many},)" if size == 1 else many
        self.flush()
        return self._loop(item, str(size), typed)

    def _sequence(self, item: Type, typed: Any) -> str:
        n = self._length()
        if not isinstance(item, Primitive):
            return self._loop(item, n, typed)
        v = self._fresh("v")
        if is_bytes(item):
            self._lines.append(f"{v} = b[p:p + {n}]; p += {n}")
            self._lines.append(f"if len({v}) != {n}: raise Malformed('the message is truncated')")
            self._mod, self._rest = 1, 0
            return v
        letter, width = WIDTHS[item.name]
        # An empty sequence ends after its length: there is no padding for missing elements.
        align = "p = ((p + 3) & -8) + 4; " if width == 8 else ""
        self._lines.append(f"{v} = ()")
        self._lines.append(
            f"if {n}: {align}{v} = F(f'{self._module.order}{{{n}}}{letter}', b, p); "
            f"p += {width} * {n}"
        )
        self._mod, self._rest = min(width, 4), 0
        return v

    def _loop(self, item: Type, count: str, typed: Any) -> str:
        v = self._fresh("v")
        self._lines.append(f"{v} = []")
        one = self._element(item, typed)
        self._lines.append(f"for _ in range({count}): {one.format(v=v)}")
        self._mod, self._rest = 1, 0
        return v

    def _element(self, item: Type, typed: Any) -> str:
        """Return a statement that decodes an element and appends it to `{v}`."""
        if isinstance(item, Text):
            size = f"F('{self._module.order}I', b, (p := (p + 3) & -4))[0]"
            if item.wide:
                text = f"{{v}}.append(W(b, p + 4, n, {self._module.order!r})); p += 4 + 4 * n"
            else:
                text = "{v}.append(T(b[p + 4:p + 3 + n]) if n > 1 else ''); p += 4 + n"
            return f"n = {size}; {text}"
        assert isinstance(item, Ref)
        part = self._module.part(item.cls, _element_of(typed) if typed else outward(item.cls))
        return f"x, p = {part}(b, p); {{v}}.append(x)"


def _declared(type_: Any, name: str) -> Any:
    """Return the type of a field of a generated type."""
    return bare(type_.__annotations__[name])


def _element_of(type_: Any) -> Any:
    """Return the element type of a list type, bounded or not."""
    return bare(type_).__args__[0]
