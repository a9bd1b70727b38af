"""Message, service and action classes that are created at run time."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from types import SimpleNamespace
from typing import Any, NamedTuple

from rcp_ros2.carrier import conversion_of, encoding
from rcp_ros2.idl import (
    WIDTHS,
    Field,
    MissingType,
    Primitive,
    Ref,
    Sequence,
    Text,
    Type,
    define,
    fields_of,
    full_name,
    load,
)
from rcp_ros2.support import forge, forge_action, forge_service
from rcp_ros2.types import is_bytes

__all__ = ["Part", "define_action", "define_message", "define_service", "is_made"]

_WORD = re.compile(r"(?:[A-Za-z]\w*/(?:msg|srv|action)/)?[A-Za-z]\w*\Z")


class Part(NamedTuple):
    """A field whose type may not be loaded yet."""

    name: str
    base: str
    """A primitive, or the full name of another message."""
    shape: Callable[[Type], Type] = lambda base: base
    """Builds the field's type from the base type."""


def is_made(cls: Any) -> bool:
    """Return whether a class was created at run time."""
    return isinstance(cls, _Made)


def define_message(name: str, parts: Iterable[Part]) -> None:
    """Define a message, or the message of a service or action.

    :raises MissingType: a name is not valid.
    """
    parts = list(parts)
    bad = next((word for word in (name, *(p.name for p in parts)) if not _WORD.match(word)), None)
    if bad is not None:  # nodes are not trusted
        raise MissingType(name, f"{bad[:80]!r} is not a valid name")
    package, group, leaf = name.split("/")
    kind = type(f"Metaclass_{leaf}", (_Made,), {})  # a metaclass per type holds its support
    define(kind(leaf, (_Message,), {"__module__": f"{package}.{group}", "parts": parts}))


def define_service(name: str) -> None:
    """Define a service, of which the request and the response are defined."""
    define_message(
        f"{name}_Event",
        (
            Part("info", "service_msgs/msg/ServiceEventInfo"),
            Part("request", f"{name}_Request", _at_most_one),
            Part("response", f"{name}_Response", _at_most_one),
        ),
    )
    _define(name, _MadeService)


def define_action(name: str) -> None:
    """Define an action, of which the goal, the result and the feedback are defined."""
    goal_id = Part("goal_id", "unique_identifier_msgs/msg/UUID")
    for ending, parts in {
        "SendGoal_Request": (goal_id, Part("goal", f"{name}_Goal")),
        "SendGoal_Response": (
            Part("accepted", "bool"),
            Part("stamp", "builtin_interfaces/msg/Time"),
        ),
        "GetResult_Request": (goal_id,),
        "GetResult_Response": (Part("status", "int8"), Part("result", f"{name}_Result")),
        "FeedbackMessage": (goal_id, Part("feedback", f"{name}_Feedback")),
    }.items():
        define_message(f"{name}_{ending}", parts)
    for ending in ("SendGoal", "GetResult"):
        define_service(f"{name}_{ending}")
    _define(name, _MadeAction)


def _define(name: str, kind: type) -> None:
    package, group, leaf = name.split("/")
    define(type(f"Metaclass_{leaf}", (kind,), {})(leaf, (), {"__module__": f"{package}.{group}"}))


def _at_most_one(base: Type) -> Type:
    return Sequence(base, None, 1)


class _Message:
    """An object of a message class; it is encoded by `writer.py`."""

    def __init__(self, **given: Any) -> None:
        for field in fields_of(type(self)):
            value = given[field.name] if field.name in given else _blank(field.type)
            setattr(self, field.name, value)


def _blank(type_: Type) -> Any:
    match type_:
        case Primitive("bool"):
            return False
        case Primitive("float32" | "float64"):
            return 0.0
        case Primitive():
            return 0
        case Text():
            return ""
        case Ref(cls):
            return cls()
        case Sequence(item, size, _) if is_bytes(item):
            return bytes(size or 0)
        case Sequence(item, size, _):
            return [_blank(item) for _ in range(size or 0)]


class _Made(type):
    """The metaclass of messages, where rclpy looks for the type support."""

    parts: list[Part]
    _TYPE_SUPPORT: Any = None
    _CREATE_ROS_MESSAGE: Any = ""
    _DESTROY_ROS_MESSAGE: Any = ""
    _CONVERT_FROM_PY: Any = ""
    _CONVERT_TO_PY: Any = ""

    def prepare(cls) -> None:
        """Create the type support that rclpy requires, once."""
        if cls._TYPE_SUPPORT is not None:
            return
        kind = type(cls)
        if full_name(cls).split("/")[1] == "msg":
            kind._TYPE_SUPPORT = forge(cls, cls.described())  # noqa: SLF001 - its own
            return
        try:
            functions = encoding()
        except (OSError, AttributeError) as error:
            raise MissingType(full_name(cls), f"without it, Fast DDS is needed: {error}") from error
        kind._TYPE_SUPPORT = forge(cls, cls.described(), functions)  # noqa: SLF001
        create, destroy, from_python, to_python = conversion_of(cls)
        kind._CREATE_ROS_MESSAGE, kind._DESTROY_ROS_MESSAGE = create, destroy  # noqa: SLF001
        kind._CONVERT_FROM_PY, kind._CONVERT_TO_PY = from_python, to_python  # noqa: SLF001

    def described(cls) -> tuple[Field, ...]:
        """Return the fields; the types they refer to are loaded on demand."""
        return tuple(Field(name, shape(_base(base))) for name, base, shape in cls.parts)


class _MadeService(type):
    """The metaclass of services."""

    _TYPE_SUPPORT: Any = None
    Request: Any
    Response: Any
    Event: Any

    def prepare(cls) -> None:
        """Load its messages, and create the type support that rclpy requires, once."""
        if cls._TYPE_SUPPORT is not None:
            return
        name = full_name(cls)
        for ending in ("Request", "Response", "Event"):
            setattr(cls, ending, load(f"{name}_{ending}"))
        made = tuple(
            Field(f"{ending.lower()}_message", Ref(getattr(cls, ending)))
            for ending in ("Request", "Response", "Event")
        )
        type(cls)._TYPE_SUPPORT = forge_service(cls, made)  # noqa: SLF001 - its own


class _MadeAction(type):
    """The metaclass of actions."""

    _TYPE_SUPPORT: Any = None
    Impl: Any

    def prepare(cls) -> None:
        """Load its parts, and create the type support that rclpy requires, once."""
        if cls._TYPE_SUPPORT is not None:
            return
        name = full_name(cls)
        parts = tuple(
            Field(ending.lower(), Ref(load(f"{name}_{ending}")))
            for ending in ("Goal", "Result", "Feedback")
        )
        for ending in ("Goal", "Result", "Feedback"):
            setattr(cls, ending, load(f"{name}_{ending}"))
        cls.Impl = SimpleNamespace(
            SendGoalService=load(f"{name}_SendGoal"),
            GetResultService=load(f"{name}_GetResult"),
            FeedbackMessage=load(f"{name}_FeedbackMessage"),
            CancelGoalService=load("action_msgs/srv/CancelGoal"),
            GoalStatusMessage=load("action_msgs/msg/GoalStatusArray"),
        )
        type(cls)._TYPE_SUPPORT = forge_action(cls, parts)  # noqa: SLF001 - its own


def _base(text: str) -> Type:
    return Primitive(text) if text in WIDTHS else Ref(load(text))
