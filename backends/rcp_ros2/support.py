"""Type support for types without compiled code, sufficient for raw subscriptions.

A subscription to serialized messages needs only a type's name and hash: the middleware never calls
its conversion functions, so those of another message are used as placeholders.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
from typing import Any

from rcp_ros2.idl import MissingType, Primitive, Ref, Sequence, Text, Type, fields_of, full_name

__all__ = ["IDS", "forge", "type_hash"]

_FASTRTPS = b"rosidl_typesupport_fastrtps_c"
IDS = {
    "int8": 2,
    "uint8": 3,
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "bool": 15,
    "octet": 16,
}
"""The number of each primitive in type_description_interfaces/msg/FieldType."""
_ARRAY, _BOUNDED, _UNBOUNDED = 48, 96, 144
_kept: list[Any] = []
"""Objects that the middleware points to until the process ends."""


class _Hash(ctypes.Structure):
    _fields_ = (("version", ctypes.c_uint8), ("value", ctypes.c_uint8 * 32))


class _Support(ctypes.Structure):
    """rosidl_message_type_support_t."""

    _fields_ = (
        ("identifier", ctypes.c_char_p),
        ("data", ctypes.c_void_p),
        ("find", ctypes.c_void_p),
        ("hash", ctypes.c_void_p),
        ("description", ctypes.c_void_p),
        ("sources", ctypes.c_void_p),
    )


class _Callbacks(ctypes.Structure):
    """message_type_support_callbacks_t of rosidl_typesupport_fastrtps_cpp."""

    _fields_ = (
        ("namespace", ctypes.c_char_p),
        ("name", ctypes.c_char_p),
        ("functions", ctypes.c_void_p * 4),
        ("key", ctypes.c_void_p),
    )


def forge(cls: Any, fields: Any) -> Any:
    """Return a capsule that rclpy accepts as the type support of a class.

    :raises MissingType: this does not work with the active middleware.
    """
    name = full_name(cls)
    package, middle, leaf = name.split("/")
    try:
        lent, library = _lent()
    except (OSError, AttributeError, ValueError) as error:
        raise MissingType(name, f"and no substitute can be created for it: {error}") from error
    borrowed = ctypes.cast(lent.data, ctypes.POINTER(_Callbacks)).contents
    callbacks = _Callbacks(f"{package}::{middle}".encode(), leaf.encode(), borrowed.functions, None)
    digest = _Hash(1, (ctypes.c_uint8 * 32)(*type_hash(name, fields)))

    @ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)
    def hash_of(_support: Any) -> int:
        return ctypes.addressof(digest)

    find = ctypes.cast(library.get_message_typesupport_handle_function, ctypes.c_void_p)
    support = _Support(
        _FASTRTPS,
        ctypes.addressof(callbacks),
        find,
        ctypes.cast(hash_of, ctypes.c_void_p),
        lent.description,
        lent.sources,
    )
    _kept.extend((callbacks, digest, hash_of, support))
    capsule = ctypes.pythonapi.PyCapsule_New
    capsule.restype = ctypes.py_object
    capsule.argtypes = (ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)
    return capsule(ctypes.addressof(support), None, None)


def _lent() -> tuple[_Support, Any]:
    """Return the support of a standard message, and the library that contains it."""
    from rcl_interfaces.msg import Log

    kind: Any = Log.__class__
    if kind._TYPE_SUPPORT is None:  # noqa: SLF001 - the name rclpy uses
        kind.__import_type_support__()
    pointer = ctypes.pythonapi.PyCapsule_GetPointer
    pointer.restype = ctypes.c_void_p
    pointer.argtypes = (ctypes.py_object, ctypes.c_char_p)
    library = ctypes.CDLL("librosidl_runtime_c.so")
    find = library.get_message_typesupport_handle
    find.restype = ctypes.POINTER(_Support)
    find.argtypes = (ctypes.c_void_p, ctypes.c_char_p)
    found = find(pointer(kind._TYPE_SUPPORT, None), _FASTRTPS)  # noqa: SLF001
    return found.contents, library  # ValueError on a null pointer


def type_hash(name: str, fields: Any) -> bytes:
    """Return the hash of a type (REP-2016, RIHS01)."""
    referred: dict[str, Any] = {}
    own = _individual(name, fields, referred)
    whole = {
        "type_description": own,
        "referenced_type_descriptions": [referred[key] for key in sorted(referred)],
    }
    return hashlib.sha256(json.dumps(whole).encode()).digest()


def _individual(name: str, fields: Any, referred: dict[str, Any]) -> dict[str, Any]:
    described = [{"name": field.name, "type": _field(field.type, referred)} for field in fields]
    if not described:  # C forbids empty structs
        described.append(
            {"name": "structure_needs_at_least_one_member", "type": _kind(IDS["uint8"])}
        )
    return {"type_name": name, "fields": described}


def _kind(id_: int, capacity: int = 0, text: int = 0, nested: str = "") -> dict[str, Any]:
    return {
        "type_id": id_,
        "capacity": capacity,
        "string_capacity": text,
        "nested_type_name": nested,
    }


def _field(type_: Type, referred: dict[str, Any]) -> dict[str, Any]:
    match type_:
        case Primitive(name):
            return _kind(IDS[name])
        case Text(limit, wide):
            return _kind((17 if limit is None else 21) + wide, text=limit or 0)
        case Ref(cls):
            name = full_name(cls)
            if name not in referred:
                referred[name] = None
                referred[name] = _individual(name, fields_of(cls), referred)
            return _kind(1, nested=name)
        case Sequence(item, size, limit):
            inner = _field(item, referred)
            more = _ARRAY if size is not None else _UNBOUNDED if limit is None else _BOUNDED
            capacity = size or limit or 0
            return inner | {"type_id": inner["type_id"] + more, "capacity": capacity}
