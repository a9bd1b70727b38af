"""One type of values: its validators, encoders and published schema, all made from one msgspec type.

Inbound, decoding is validating. Outbound, a value is checked once and encoded once for each
encoding, however many are to receive it.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Generator
from enum import StrEnum
from functools import lru_cache, partial
from typing import Any

import cbor2
import msgspec

from rcp_protocol.base64_strings import lifted
from rcp_protocol.depth import is_deep, is_deep_json
from rcp_protocol.errors import BadRequest, InvalidValue, OutOfRange, PluginError
from rcp_protocol.pieces import is_long, pieces
from rcp_protocol.plain import is_list, is_map
from rcp_protocol.published_schema import published
from rcp_protocol.shape import Beyond, Shape, unescaped
from rcp_protocol.validation import Fault, fault_of

__all__ = [
    "ANY",
    "DEPTH",
    "Encoding",
    "ValueType",
    "dump",
    "is_long",
    "sound",
    "to_plain",
    "value_type",
]

DEPTH = 64
"""How deep lists and maps may stand in each other where a type sets no bound itself."""
_WIDE_DIGITS = b"," + b"0" * 16  # of an integer, not behind a decimal point
_HUGE_DIGITS = b"0" * 19  # may lie past 64 bits, which msgspec alone lets through
_ZEROS = bytes.maketrans(b"0123456789-:[", b"0" * 10 + b"," * 3)
_STEP = re.compile(r"\.([^.\[\]]+)|\[(\d+|\.\.\.)\]")
_BROKEN = {">=": "<", "<=": ">", ">": "<=", "<": ">="}


class Encoding(StrEnum):
    """How a message or value is written; the words of subprotocols and of `encoding`."""

    JSON = "json"
    CBOR = "cbor"
    MSGPACK = "msgpack"


# Names of their own: Python 3.11 takes 0.1 µs to look a member up in its enum.
_JSON, _MSGPACK = Encoding.JSON, Encoding.MSGPACK
_json = msgspec.json.Encoder()
_msgpack = msgspec.msgpack.Encoder()
_NATIVE_BYTES = (bytes, bytearray, memoryview)


def to_plain(value: Any) -> Any:
    """Turn a value into dictionaries, lists and scalars; bytes stay bytes."""
    return msgspec.to_builtins(value, builtin_types=_NATIVE_BYTES, str_keys=True)


def dump(value: Any, encoding: Encoding) -> bytes:
    """Encode a value of no declared type; JSON follows the contract's rules for odd numbers."""
    return ANY.encode(value, encoding)


class ValueType:
    """Everything the gateway needs to know of one type of values."""

    __slots__ = (
        "_bottomless",
        "_from_json",
        "_from_msgpack",
        "_schema",
        "_schema_id",
        "_shape",
        "grows",
        "probes_null",
        "type",
    )

    def __init__(self, type_: Any) -> None:
        self.type = type_
        try:
            self._shape = Shape(type_)
            self._from_json = msgspec.json.Decoder(type_)
            self._from_msgpack = msgspec.msgpack.Decoder(type_)
        except (TypeError, ValueError) as error:
            raise PluginError(f"msgspec cannot decode the type {type_!r}: {error}") from error
        self._bottomless = self._shape.open or self._shape.endless
        self.probes_null = self._shape.has_float
        self.grows = self._shape.grows
        """Whether values may be of any length: text, bytes, lists, maps."""
        self._schema: dict[str, Any] | None = None
        self._schema_id: str | None = None

    @property
    def schema(self) -> dict[str, Any]:
        """The JSON Schema (2020-12), self-contained, with units and `$id`."""
        if self._schema is None:
            bare = published(msgspec.json.schema(self.type))
            digest = hashlib.sha256(msgspec.json.encode(bare, order="sorted")).hexdigest()[:12]
            self._schema_id = f"{_type_name(self.type)}.{digest}"
            self._schema = {"$id": f"rcp:schema:{self._schema_id}", **bare}
        return self._schema

    @property
    def schema_id(self) -> str:
        """The schema's id: type name and digest, so that it changes when the schema does."""
        _ = self.schema
        assert self._schema_id is not None
        return self._schema_id

    def has_field(self, dotted: str) -> bool:
        """Tell whether a projection such as `position.x` leads to a part of this type."""
        return self._shape.has_field(dotted)

    def decode(self, raw: bytes | msgspec.Raw, encoding: Encoding, label: str = "value") -> Any:
        """Decode and validate what a client sent.

        :raises InvalidValue: it does not fit; `details.pointer` names the field.
        :raises OutOfRange: it fits but for a bound.
        :raises BadRequest: it is not text of the encoding at all, or nested too deep.
        """
        if self._bottomless:
            _check_depth(raw, encoding)
        if encoding is _JSON:
            if not (self._shape.has_wide_int and _has_digits(raw, _HUGE_DIGITS)):
                try:
                    return self._from_json.decode(raw)
                except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
                    pass  # decoded again the slow way, which can explain and accepts "NaN"
            return self.convert(_parse_json(raw), label)
        if encoding is _MSGPACK and not self.probes_null and not self._shape.has_wide_int:
            try:
                return self._from_msgpack.decode(raw)
            except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
                pass
        plain = parse(raw, encoding)
        return self.convert(sound(plain) if self._shape.open else plain, label)

    def decode_in_steps(
        self, raw: bytes | msgspec.Raw, encoding: Encoding, label: str = "value"
    ) -> Generator[None, None, Any]:
        """Do as `decode` does, in steps, for what is long.

        :raises InvalidValue, OutOfRange, BadRequest: as `decode` does.
        """
        if self._bottomless:
            _check_depth(raw, encoding)
            yield
        if encoding is _JSON:
            huge = self._shape.has_wide_int and _has_digits(raw, _HUGE_DIGITS)
            yield
            if not huge:
                try:
                    return self._from_json.decode(raw)
                except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
                    yield
        plain = parse(raw, encoding)
        yield
        if encoding is not _JSON and self._shape.open:
            plain = sound(plain)
            yield
        return self.convert(plain, label)

    def convert(self, plain: Any, label: str = "value") -> Any:
        """Validate plain data (what `json.loads` would give) and return the typed value.

        :raises InvalidValue: as `decode` does.
        """
        try:
            fixed = self._shape.inward(plain, "")
            return msgspec.convert(fixed, self.type)
        except msgspec.ValidationError as error:
            raise self._explain(fault_of(error), plain, label) from None
        except Beyond as error:
            pointer, _, bound = error.args
            raise self._beyond(label, pointer, _at(plain, pointer), bound) from None
        except ValueError as error:
            pointer, why = error.args if len(error.args) == 2 else ("", str(error))
            raise InvalidValue(
                f"{_named(label, pointer)} {why}: {_shown(_at(plain, pointer))}",
                details={"pointer": pointer},
            ) from None
        except RecursionError:
            raise BadRequest("the value is nested too deep") from None

    def check(self, value: Any) -> tuple[Any, bytes | None]:
        """Validate a value that a backend published; return it typed, with its JSON if made.

        :raises InvalidValue: it does not fit the type.
        """
        if isinstance(value, msgspec.Struct):
            try:
                self._from_msgpack.decode(_msgpack.encode(value))
            except (msgspec.MsgspecError, TypeError, OverflowError) as error:
                raise InvalidValue(str(error)) from None
        else:
            value = self.convert(value)
        if not self.probes_null and not self._shape.has_wide_int:
            return value, None
        return value, self.encode(value, _JSON)

    def check_in_steps(self, value: Any) -> Generator[None, None, tuple[Any, bytes | None]]:
        """Do as `check` does; what has no declared type is written in steps.

        :raises InvalidValue: as `check` does.
        """
        if self.type is not Any:
            return self.check(value)
        value = self.convert(value)
        yield
        return value, (yield from pieces(value, partial(self.encode, encoding=_JSON)))

    def encode(self, value: Any, encoding: Encoding) -> bytes:
        """Encode a value of this type.

        :raises InvalidValue: it holds a non-finite number or integer that its type forbids.
        """
        if encoding is _JSON:
            blobs = self._shape.blobs
            data = _json.encode(value if blobs is None else lifted(value, blobs))
            if (self.probes_null and data.count(b"null") != _nones(value)) or (
                self._shape.has_wide_int and _has_digits(b"," + data, _WIDE_DIGITS)
            ):
                return self._encode_odd(value)
            return data
        try:
            if encoding is _MSGPACK:
                return _msgpack.encode(value)
            return cbor2.dumps(to_plain(value))
        except OverflowError as error:
            raise InvalidValue(f"an integer is too large: {error}") from None

    def _encode_odd(self, value: Any) -> bytes:
        try:
            return _json.encode(self._shape.outward(to_plain(value), ""))
        except ValueError as error:
            pointer, why = error.args[:2] if len(error.args) > 1 else ("", str(error))
            raise InvalidValue(f"{_named('value', pointer)} {why}") from None

    def _beyond(self, label: str, pointer: str, found: Any, bound: str) -> OutOfRange:
        unit = self._shape.unit(pointer)
        operator, _, limit = bound.partition(" ")
        tail = f" {unit}" if unit and unit != "1" else ""
        return OutOfRange(
            f"{_named(label, pointer)} exceeds allowed range: "
            f"{found} {_BROKEN[operator]} {limit}{tail}",
            details={"pointer": pointer, "value": found, "bound": bound, "unit": unit},
        )

    def _explain(self, fault: Fault, plain: Any, label: str) -> InvalidValue:
        pointer = "".join("/" + (m[1] or m[2]) for m in _STEP.finditer(fault.place))
        found = _at(plain, pointer)
        if fault.bound and isinstance(found, (int, float)) and not isinstance(found, bool):
            return self._beyond(label, pointer, found, " ".join(fault.bound))
        details: dict[str, Any] = {"pointer": pointer}
        if plain is None:
            details["missing"] = ""
        elif fault.missing is not None:
            details["missing"] = f"{pointer}/{fault.missing}"
        return InvalidValue(f"{_named(label, pointer)}: {fault.what}", details=details)


def _named(label: str, pointer: str) -> str:
    if not pointer:
        return label
    return f"field '{'.'.join(map(unescaped, pointer[1:].split('/')))}' of {label}"


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _at(plain: Any, pointer: str) -> Any:
    for step in [unescaped(p) for p in pointer.split("/") if p]:
        if is_map(plain) and step in plain:
            plain = plain[step]
        elif is_list(plain) and step.isdigit() and int(step) < len(plain):
            plain = plain[int(step)]
        else:
            return None
    return plain


def _nones(value: Any) -> int:
    """Count the fields that are None: as many nulls in its JSON leave none that was a NaN."""
    if isinstance(value, msgspec.Struct):
        return msgspec.structs.astuple(value).count(None)
    return value is None


def _has_digits(data: bytes | msgspec.Raw, zeros: bytes) -> bool:
    """Tell whether so many digits stand side by side: an expression would take ten times as long."""
    return zeros in bytes(data).translate(_ZEROS)


def _check_depth(raw: bytes | msgspec.Raw, encoding: Encoding) -> None:
    if encoding is not _JSON:
        deep = is_deep(parse(raw, encoding), DEPTH)
    else:
        data = bytes(raw)
        deep = data.count(b"[") + data.count(b"{") > DEPTH and is_deep_json(data, DEPTH)
    if deep:
        raise BadRequest(f"the value is nested deeper than {DEPTH}")


def parse(raw: bytes | msgspec.Raw, encoding: Encoding) -> Any:
    """Decode text of an encoding to plain data.

    :raises BadRequest: it is not text of that encoding, or nested too deep.
    """
    if encoding is Encoding.JSON:
        return _parse_json(raw)
    try:
        if encoding is Encoding.MSGPACK:
            return msgspec.msgpack.decode(raw)
        return sound(cbor2.loads(bytes(raw)))
    except RecursionError:
        raise BadRequest("the message is nested too deep") from None
    except Exception as error:  # cbor2 raises a dozen kinds for malformed input
        if isinstance(error, BadRequest):
            raise
        raise BadRequest(f"not well-formed {encoding.value}: {error}") from None


def _parse_json(raw: bytes | msgspec.Raw) -> Any:
    try:
        return msgspec.json.decode(raw)
    except RecursionError:
        raise BadRequest("the message is nested too deep") from None
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadRequest(f"not well-formed JSON: {error}") from None


_PLAIN = (type(None), bool, int, float, str, bytes)
_SHORT = frozenset((type(None), bool, float, str, bytes))


def sound(value: Any) -> Any:
    """Keep what JSON could have carried as well.

    :raises BadRequest: there is a tag, an odd key or an integer of more than 64 bits.
    """
    if is_map(value):
        keys: Any = value
        if not all(isinstance(key, str) for key in keys):
            raise BadRequest("a map has a key that is not a string")
        return {key: sound(item) for key, item in value.items()}
    if is_list(value):
        kinds = set(map(type, value))
        if kinds <= _SHORT or (kinds == {int} and min(value) >= -(2**63) and max(value) < 2**64):
            return value
        return [sound(item) for item in value]
    if not isinstance(value, _PLAIN):
        raise BadRequest(f"{type(value).__name__} is not allowed in an envelope")
    if isinstance(value, int) and not -(2**63) <= value < 2**64:
        raise BadRequest("an integer is longer than 64 bits")
    return value


def _type_name(type_: Any) -> str:
    while hasattr(type_, "__metadata__"):
        type_ = type_.__origin__
    return re.sub(r"[^A-Za-z0-9_]+", "_", getattr(type_, "__name__", str(type_))).strip("_")


@lru_cache(maxsize=4096)
def _cached(type_: Any) -> ValueType:
    return ValueType(type_)


def value_type(type_: Any) -> ValueType:
    """Return the compiled form of a type; the same one for the same type.

    :raises PluginError: msgspec cannot decode the type.
    """
    try:
        return _cached(type_)
    except TypeError:  # unhashable: an Annotated with a dictionary in its Meta
        return ValueType(type_)


ANY = ValueType(Any)
"""The type of anything: for bodies of no declared type."""
