"""Messages of types without compiled code, on their way through the middleware and back.

A service client or a subscription of an action cannot be given serialized messages: rclpy converts each
object to a C struct, and the middleware encodes that with functions of its type support. Here a number
takes the place of the struct, and these functions copy the bytes that belong to it.
"""

from __future__ import annotations

import ctypes
import itertools
from functools import lru_cache
from typing import Any, NamedTuple

import structlog

from rcp_ros2.cdr import Codec, Malformed
from rcp_ros2.support import function_capsule
from rcp_ros2.writer import writer

__all__ = ["Conversion", "conversion_of", "encoding"]

log = structlog.get_logger("rcp.ros2")
_HEADER = 4  # bytes that the middleware itself writes before a message
_LARGEST = 2**31  # bytes
_UNBOUNDED = b"\0"
_SAMPLE, _ROOM, _WORDS = 64, 256, 256  # a buffer, and room for the objects of the library
_bytes: dict[int, bytes] = {}
"""The serialized messages, by the number that stands for each."""
_numbers = itertools.count(1)
_kept: list[Any] = []
"""Functions that rclpy and the middleware call until the process ends."""


class Conversion(NamedTuple):
    """What rclpy expects at a message class, as capsules."""

    create: Any
    destroy: Any
    from_python: Any
    to_python: Any


class _Cdr(NamedTuple):
    """Fast CDR, called with the interpreter's lock held."""

    place: Any
    """Return the current position of a Cdr."""
    start: Any
    """Return the first byte of its buffer."""
    jump: Any
    """Move its position, if there is room: unlike the functions that write, it does not throw."""
    end: int
    """The word of a Cdr that has the end of its buffer."""


@lru_cache(maxsize=1)
def _cdr() -> _Cdr:
    """Return the library.

    :raises OSError: it is not there.
    :raises AttributeError: it is older than version 2, or another one altogether.
    """
    library = ctypes.PyDLL("libfastcdr.so.2")
    names = ("20get_current_positionEv", "18get_buffer_pointerEv", "4jumpEm")
    place, start, jump = (getattr(library, f"_ZN8eprosima7fastcdr3Cdr{name}") for name in names)
    place.restype = start.restype = ctypes.c_void_p
    place.argtypes = start.argtypes = (ctypes.c_void_p,)
    jump.restype, jump.argtypes = ctypes.c_bool, (ctypes.c_void_p, ctypes.c_size_t)
    return _Cdr(place, start, jump, _word_of_end(library))


def _word_of_end(library: Any) -> int:
    """Find the word in a Cdr over a known buffer: its place is not part of the interface.

    :raises AttributeError: there is no such word.
    """
    data = ctypes.create_string_buffer(_SAMPLE)
    buffer, cdr = ctypes.create_string_buffer(_ROOM), (ctypes.c_size_t * _WORDS)()
    make_buffer = library._ZN8eprosima7fastcdr10FastBufferC1EPcm  # noqa: SLF001 - a C++ name
    make = library._ZN8eprosima7fastcdr3CdrC1ERNS0_10FastBufferENS1_10EndiannessENS0_10CdrVersionE  # noqa: SLF001
    make_buffer(ctypes.byref(buffer), ctypes.byref(data), ctypes.c_size_t(_SAMPLE))
    make(ctypes.byref(cdr), ctypes.byref(buffer), ctypes.c_int(1), ctypes.c_int(1))
    try:
        return list(cdr).index(ctypes.addressof(data) + _SAMPLE)
    except ValueError:
        raise AttributeError("the library has another form than is known") from None


@ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, ctypes.c_void_p)
def _encode(number: int, cdr: int) -> bool:
    """Copy a message into the middleware's buffer."""
    library = _cdr()
    body = _bytes[number][_HEADER:]
    if not library.jump(cdr, len(body)):
        return False
    ctypes.memmove(library.place(cdr) - len(body), body, len(body))
    return True


@ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, ctypes.c_void_p)
def _decode(cdr: int, number: int) -> bool:
    """Copy a message out of the middleware's buffer: all of it, with its header."""
    library = _cdr()
    begin = library.start(cdr)
    size = ctypes.cast(cdr, ctypes.POINTER(ctypes.c_size_t))[library.end] - begin
    if not _HEADER <= size < _LARGEST:
        return False
    _bytes[number] = ctypes.string_at(begin, size)
    return True


@ctypes.CFUNCTYPE(ctypes.c_uint32, ctypes.c_void_p)
def _size(number: int) -> int:
    return len(_bytes[number]) - _HEADER


@ctypes.CFUNCTYPE(ctypes.c_size_t, ctypes.c_void_p)
def _most(bounds: int) -> int:
    ctypes.memmove(bounds, _UNBOUNDED, 1)
    return 1


@ctypes.PYFUNCTYPE(ctypes.c_void_p)
def _create() -> int:
    return next(_numbers)


@ctypes.PYFUNCTYPE(None, ctypes.c_void_p)
def _destroy(number: int) -> None:
    _bytes.pop(number, None)


@ctypes.PYFUNCTYPE(ctypes.c_bool, ctypes.py_object, ctypes.c_void_p)
def _from_python(message: Any, number: int) -> bool:
    _bytes[number] = writer(type(message))(message)
    return True


def encoding() -> Any:
    """Return the functions for the middleware, as an array.

    :raises OSError: Fast CDR is not there.
    :raises AttributeError: it is older than version 2.
    """
    _cdr()
    functions = (_encode, _decode, _size, _most)
    return (ctypes.c_void_p * 4)(*(ctypes.cast(one, ctypes.c_void_p) for one in functions))


def conversion_of(cls: Any) -> Conversion:
    """Return the functions for rclpy.

    What arrives becomes a typed value; a message that cannot be decoded becomes an empty object of the
    class, because an exception would end the executor.
    """
    decode = Codec(cls).decode

    @ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p)
    def to_python(number: int) -> Any:
        try:
            return decode(_bytes[number])
        except (Malformed, KeyError) as error:
            log.warning("ros_message_malformed", type=cls.__name__, detail=str(error))
            return cls()

    _kept.append(to_python)
    return Conversion(*map(function_capsule, (_create, _destroy, _from_python, to_python)))
