"""Type support for types without compiled code.

A subscription to serialized messages needs only a type's name and hash: the middleware never calls
its conversion functions, so those of another message are used as placeholders. The messages of
services and actions have functions of their own (`carrier.py`).
"""

from __future__ import annotations

import ctypes
import hashlib
import json
from typing import Any

from rcp_ros2.idl import MissingType, Primitive, Ref, Sequence, Text, Type, fields_of, full_name

__all__ = ["IDS", "forge", "forge_action", "forge_service", "function_capsule", "type_hash"]

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


class _ServiceSupport(ctypes.Structure):
    """rosidl_service_type_support_t."""

    _fields_ = (
        ("identifier", ctypes.c_char_p),
        ("data", ctypes.c_void_p),
        ("find", ctypes.c_void_p),
        ("request", ctypes.c_void_p),
        ("response", ctypes.c_void_p),
        ("event", ctypes.c_void_p),
        ("create_event", ctypes.c_void_p),
        ("destroy_event", ctypes.c_void_p),
        ("hash", ctypes.c_void_p),
        ("description", ctypes.c_void_p),
        ("sources", ctypes.c_void_p),
    )


class _ServiceCallbacks(ctypes.Structure):
    """service_type_support_callbacks_t of rosidl_typesupport_fastrtps_cpp."""

    _fields_ = (
        ("namespace", ctypes.c_char_p),
        ("name", ctypes.c_char_p),
        ("request", ctypes.c_void_p),
        ("response", ctypes.c_void_p),
    )


class _ActionSupport(ctypes.Structure):
    """rosidl_action_type_support_t."""

    _fields_ = (
        ("send_goal", ctypes.c_void_p),
        ("get_result", ctypes.c_void_p),
        ("cancel", ctypes.c_void_p),
        ("feedback", ctypes.c_void_p),
        ("status", ctypes.c_void_p),
        ("hash", ctypes.c_void_p),
        ("description", ctypes.c_void_p),
        ("sources", ctypes.c_void_p),
    )


def forge(cls: Any, fields: Any, functions: Any = None) -> Any:
    """Return a capsule that rclpy accepts as the type support of a class.

    Its messages are sent and received in serialized form, unless there are `functions` of its own.

    :raises MissingType: this does not work with the active middleware.
    """
    name = full_name(cls)
    package, middle, leaf = name.split("/")
    lent, library = _lent(name)
    borrowed = ctypes.cast(lent.data, ctypes.POINTER(_Callbacks)).contents
    used = borrowed.functions if functions is None else functions
    callbacks = _Callbacks(f"{package}::{middle}".encode(), leaf.encode(), used, None)
    find = ctypes.cast(library.get_message_typesupport_handle_function, ctypes.c_void_p)
    support = _Support(
        _FASTRTPS,
        ctypes.addressof(callbacks),
        find,
        _hash_function(type_hash(name, fields)),
        lent.description,
        lent.sources,
    )
    _kept.extend((callbacks, support))
    return _capsule(ctypes.addressof(support))


def forge_service(cls: Any, fields: Any) -> Any:
    """Return the type support of a service class, whose request and response have theirs.

    :raises MissingType: this does not work with the active middleware.
    """
    name = full_name(cls)
    package, middle, leaf = name.split("/")
    lent, library = _lent(name)
    request, response, event = map(_pointer_of, (cls.Request, cls.Response, cls.Event))
    callbacks = _ServiceCallbacks(f"{package}::{middle}".encode(), leaf.encode(), request, response)
    support = _ServiceSupport(
        _FASTRTPS,
        ctypes.addressof(callbacks),
        ctypes.cast(library.get_service_typesupport_handle_function, ctypes.c_void_p),
        request,
        response,
        event,
        None,  # events of a client are published only where it is configured
        None,
        _hash_function(type_hash(name, fields)),
        lent.description,
        lent.sources,
    )
    _kept.extend((callbacks, support))
    return _capsule(ctypes.addressof(support))


def forge_action(cls: Any, fields: Any) -> Any:
    """Return the type support of an action class, whose services and messages have theirs.

    :raises MissingType: this does not work with the active middleware.
    """
    lent, _ = _lent(full_name(cls))
    impl = cls.Impl
    support = _ActionSupport(
        _pointer_of(impl.SendGoalService),
        _pointer_of(impl.GetResultService),
        _pointer_of(impl.CancelGoalService),
        _pointer_of(impl.FeedbackMessage),
        _pointer_of(impl.GoalStatusMessage),
        _hash_function(type_hash(full_name(cls), fields)),
        lent.description,
        lent.sources,
    )
    _kept.append(support)
    return _capsule(ctypes.addressof(support))


def _hash_function(digest: bytes) -> Any:
    """Return a C function that returns a type's hash."""
    found = _Hash(1, (ctypes.c_uint8 * 32)(*digest))

    @ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p)
    def hash_of(_support: Any) -> int:
        return ctypes.addressof(found)

    _kept.extend((found, hash_of))
    return ctypes.cast(hash_of, ctypes.c_void_p)


def function_capsule(function: Any) -> Any:
    """Return a capsule of a C function that is kept elsewhere."""
    return _capsule(ctypes.cast(function, ctypes.c_void_p))


def _capsule(address: Any) -> Any:
    capsule = ctypes.pythonapi.PyCapsule_New
    capsule.restype = ctypes.py_object
    capsule.argtypes = (ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)
    return capsule(address, None, None)


def _pointer_of(cls: Any) -> int:
    """Return the address of the type support of a class, installed or made."""
    kind: Any = cls.__class__
    if kind._TYPE_SUPPORT is None:  # noqa: SLF001 - the name rclpy uses
        kind.__import_type_support__()
    pointer = ctypes.pythonapi.PyCapsule_GetPointer
    pointer.restype = ctypes.c_void_p
    pointer.argtypes = (ctypes.py_object, ctypes.c_char_p)
    return pointer(kind._TYPE_SUPPORT, None)  # noqa: SLF001


def _lent(name: str) -> tuple[_Support, Any]:
    """Return the support of a standard message, and the library that contains it.

    :raises MissingType: this does not work with the active middleware.
    """
    from rcl_interfaces.msg import Log

    try:
        library = ctypes.CDLL("librosidl_runtime_c.so")
        find = library.get_message_typesupport_handle
        find.restype = ctypes.POINTER(_Support)
        find.argtypes = (ctypes.c_void_p, ctypes.c_char_p)
        return find(_pointer_of(Log), _FASTRTPS).contents, library  # ValueError on a null pointer
    except (OSError, AttributeError, ValueError) as error:
        raise MissingType(name, f"and no substitute can be created for it: {error}") from error


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
