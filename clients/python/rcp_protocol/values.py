"""Value types: validators, encoders and published schema, all derived from one msgspec type.

Decoding an inbound value validates it. An outbound value is checked once, and encoded once per
encoding for all receivers.
"""

from __future__ import annotations

import hashlib
import math
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
from rcp_protocol.instance_check import InstanceCheck, compile_check
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
    "parse",
    "sound",
    "to_plain",
    "value_type",
]

DEPTH = 64
"""Maximum nesting of lists and maps, unless the type limits it."""
_WIDE_DIGITS = b"," + b"0" * 16  # of an integer, not after a decimal point
_HUGE_DIGITS = b"0" * 19  # may exceed 64 bits, which only msgspec accepts
_ZEROS = bytes.maketrans(b"0123456789-:[", b"0" * 10 + b"," * 3)
_STEP = re.compile(r"\.([^.\[\]]+)|\[(\d+|\.\.\.)\]")
_BROKEN = {">=": "<", "<=": ">", ">": "<=", "<": ">="}


class Encoding(StrEnum):
    """An encoding of messages and values, as named in subprotocols and `encoding`."""

    JSON = "json"
    CBOR = "cbor"
    MSGPACK = "msgpack"


# Local names: in Python 3.11 an enum member access takes 0.1 µs.
_JSON, _MSGPACK = Encoding.JSON, Encoding.MSGPACK
_to_json = msgspec.json.Encoder().encode
_to_msgpack = msgspec.msgpack.Encoder().encode
_NATIVE_BYTES = (bytes, bytearray, memoryview)


def to_plain(value: Any) -> Any:
    """Convert a value to dictionaries, lists and scalars; bytes stay bytes."""
    return msgspec.to_builtins(value, builtin_types=_NATIVE_BYTES, str_keys=True)


def dump(value: Any, encoding: Encoding) -> bytes:
    """Encode an untyped value; in JSON by the protocol's rules for special numbers."""
    return ANY.encode(value, encoding)


class ValueType:
    """The compiled form of one value type."""

    __slots__ = (
        "_blobs",
        "_bottomless",
        "_from_json",
        "_from_msgpack",
        "_recognises",
        "_schema",
        "_schema_id",
        "_shape",
        "_wide",
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
        self._recognises: InstanceCheck | None = self._compile
        """Recognises valid Structs; None: values of this type have to be encoded and decoded."""
        self._blobs = self._shape.blobs
        self._wide = self._shape.has_wide_int
        self.probes_null = self._shape.has_float
        self.grows = self._shape.grows
        """Whether values may have any length: strings, bytes, lists, maps."""
        self._schema: dict[str, Any] | None = None
        self._schema_id: str | None = None

    @property
    def schema(self) -> dict[str, Any]:
        """The self-contained JSON Schema (2020-12), with units and `$id`."""
        if self._schema is None:
            bare = published(msgspec.json.schema(self.type))
            digest = hashlib.sha256(msgspec.json.encode(bare, order="sorted")).hexdigest()[:12]
            self._schema_id = f"{_type_name(self.type)}.{digest}"
            self._schema = {"$id": f"rcp:schema:{self._schema_id}", **bare}
        return self._schema

    @property
    def schema_id(self) -> str:
        """The schema's id: type name and digest, which changes with the schema."""
        _ = self.schema
        assert self._schema_id is not None
        return self._schema_id

    def has_field(self, dotted: str) -> bool:
        """Return whether a projection such as `position.x` is a part of this type."""
        return self._shape.has_field(dotted)

    def decode(self, raw: bytes | msgspec.Raw, encoding: Encoding, label: str = "value") -> Any:
        """Decode and validate a client's value.

        :raises InvalidValue: it does not match the type; `details.pointer` names the field.
        :raises OutOfRange: it violates only a bound.
        :raises BadRequest: it is malformed in this encoding, or nested too deep.
        """
        if self._bottomless:
            _check_depth(raw, encoding)
        if encoding is _JSON:
            if not (self._shape.has_wide_int and _has_digits(raw, _HUGE_DIGITS)):
                try:
                    return self._from_json.decode(raw)
                except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
                    pass  # the slow path explains the error and accepts "NaN"
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
        """Decode a long value in steps; see `decode`.

        :raises InvalidValue, OutOfRange, BadRequest: as for `decode`.
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
        """Validate plain data (as from `json.loads`) and return the typed value.

        :raises InvalidValue: as for `decode`.
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
        """Validate a published value; return it typed, and its JSON if that was produced.

        :raises InvalidValue: it does not match the type.
        """
        if self.type is float and type(value) is float and math.isfinite(value):
            return value, None  # the usual value of a gauge or a set-point: a tenth of the time
        recognises = self._recognises
        if recognises is not None:
            try:
                if recognises(value):
                    return value, _to_json(value) if self.probes_null or self._wide else None
            except AttributeError:  # of a field that is not set
                pass
        if isinstance(value, msgspec.Struct):
            try:
                self._from_msgpack.decode(_to_msgpack(value))
            except (msgspec.MsgspecError, TypeError, OverflowError) as error:
                raise InvalidValue(str(error)) from None
        else:
            value = self.convert(value)
        if not (self.probes_null or self._wide):
            return value, None
        return value, self.encode(value, _JSON)

    def _compile(self, value: Any) -> bool:
        """Compile the check of values, most of which nobody publishes, and call it."""
        self._recognises = compile_check(self.type)
        return self._recognises is not None and self._recognises(value)

    def check_in_steps(self, value: Any) -> Generator[None, None, tuple[Any, bytes | None]]:
        """Validate as `check`; encodes values without a declared type in steps.

        :raises InvalidValue: as for `check`.
        """
        if self.type is not Any:
            return self.check(value)
        value = self.convert(value)
        yield
        return value, (yield from pieces(value, partial(self.encode, encoding=_JSON)))

    def encode(self, value: Any, encoding: Encoding) -> bytes:
        """Encode a value of this type.

        :raises InvalidValue: it contains a non-finite number or an integer that its type forbids.
        """
        if encoding is not _JSON:
            try:
                if encoding is _MSGPACK:
                    return _to_msgpack(value)
                return cbor2.dumps(to_plain(value))
            except OverflowError as error:
                raise InvalidValue(f"an integer is too large: {error}") from None
        data = _to_json(value if self._blobs is None else lifted(value, self._blobs))
        if (
            self.probes_null and data.find(b"null") >= 0 and data.count(b"null") != _nones(value)
        ) or (
            self._wide
            and len(data) >= len(_WIDE_DIGITS) - 1
            and _has_digits(b"," + data, _WIDE_DIGITS)
        ):
            return self._encode_odd(value)
        return data

    def _encode_odd(self, value: Any) -> bytes:
        try:
            return _to_json(self._shape.outward(to_plain(value), ""))
        except ValueError as error:
            pointer, why = error.args[:2] if len(error.args) > 1 else ("", str(error))
            raise InvalidValue(f"{_named('value', pointer)} {why}") from None

    def _beyond(self, label: str, pointer: str, found: Any, bound: str) -> OutOfRange:
        unit = self._shape.unit(pointer)
        operator, _, limit = bound.partition(" ")
        tail = f" {unit}" if unit and unit != "1" else ""
        return OutOfRange(
            f"{_failed(label)}{_named(label, pointer)} exceeds allowed range: "
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


def _failed(label: str) -> str:
    """Return how the paper's status message of a parameter begins."""
    return "Failed to apply configuration: " if label.startswith("parameter ") else ""


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
    """Count the fields that are None: with as many nulls in the JSON, none was a NaN."""
    if isinstance(value, msgspec.Struct):
        return msgspec.structs.astuple(value).count(None)
    return value is None


def _has_digits(data: bytes | msgspec.Raw, zeros: bytes) -> bool:
    """Return whether there is a long run of digits: a regular expression is ten times slower."""
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
    """Decode to plain data.

    :raises BadRequest: it is malformed in that encoding, or nested too deep.
    """
    if encoding is Encoding.JSON:
        return _parse_json(raw)
    try:
        if encoding is Encoding.MSGPACK:
            return msgspec.msgpack.decode(raw)
        return sound(cbor2.loads(bytes(raw)))
    except RecursionError:
        raise BadRequest("the message is nested too deep") from None
    except Exception as error:  # cbor2 raises many exception types for malformed input
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
    """Check that JSON could represent the value.

    :raises BadRequest: it has a tag, a key that is not a string, or an integer of more than 64
        bits.
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
    """Return the compiled form of a type; cached.

    :raises PluginError: msgspec cannot decode the type.
    """
    try:
        return _cached(type_)
    except TypeError:  # unhashable: an Annotated with a dictionary in its Meta
        return ValueType(type_)


ANY = ValueType(Any)
"""The type of any value: for bodies without a declared type."""
