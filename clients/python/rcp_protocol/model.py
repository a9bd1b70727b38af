"""The protocol's model: paths, patterns, kinds, operations, resources, samples.

A path is a plain `str` for speed; the functions here validate it.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from enum import IntFlag, StrEnum
from functools import lru_cache
from typing import Any, Literal

import msgspec

from rcp_protocol.errors import InvalidPath

__all__ = [
    "BRANCHES",
    "MAX_DEEP",
    "MAX_PATH",
    "MOVING",
    "READS",
    "Kind",
    "NativeType",
    "Operation",
    "Pattern",
    "Policy",
    "Resource",
    "full_path",
    "kind_of",
    "operation_names",
    "parse_path",
    "tenant_of",
]

READS: dict[str, Any] = {"hints": {"read_only": True, "destructive": False, "idempotent": True}}
"""`Resource.meta` of a service that changes nothing: models may call it without care."""
MAX_PATH = 512  # characters: longer texts are refused unparsed
MAX_DEEP = 3  # `**` in one pattern
_SEGMENT = re.compile(r"[A-Za-z0-9_.-]+\Z")
_PATH = re.compile(r"(?:/[A-Za-z0-9_.-]+)+\Z")

Policy = Literal["reject", "queue", "preempt", "parallel"]


class Kind(StrEnum):
    """The kind of a resource; for tenants' resources also the branch of its path."""

    SENSOR = "sensor"
    ACTUATOR = "actuator"
    PARAM = "param"
    ACTION = "action"
    SERVICE = "service"
    EVENT = "event"


class Operation(IntFlag):
    """The operations on a resource; `DISCOVER` is only a right."""

    NONE = 0
    READ = 1
    WRITE = 2
    EXECUTE = 4
    SUBSCRIBE = 8
    DISCOVER = 16


BRANCHES: dict[Kind, Operation] = {
    Kind.SENSOR: Operation.READ | Operation.SUBSCRIBE,
    Kind.ACTUATOR: Operation.READ | Operation.WRITE | Operation.SUBSCRIBE,
    Kind.PARAM: Operation.READ | Operation.WRITE | Operation.SUBSCRIBE,
    Kind.ACTION: Operation.EXECUTE,
    Kind.SERVICE: Operation.EXECUTE,
    Kind.EVENT: Operation.READ | Operation.SUBSCRIBE,
}
"""The operations of each branch, unless a resource declares fewer."""

MOVING = frozenset((Kind.ACTUATOR, Kind.ACTION))
"""Kinds that move something unless the resource declares otherwise."""

_ORDER = (
    Operation.READ,
    Operation.WRITE,
    Operation.EXECUTE,
    Operation.SUBSCRIBE,
    Operation.DISCOVER,
)


def operation_names(operations: Operation) -> list[str]:
    """List the operations in the protocol's order and spelling."""
    return [op.name.lower() for op in _ORDER if op in operations and op.name]


def parse_path(text: str, tenant: str | None) -> str:
    """Resolve a path for a session of `tenant`.

    :raises InvalidPath: it is not a valid path.
    """
    if len(text) > MAX_PATH or not _PATH.match(text):
        raise _bad(text)
    return _resolve(text, tenant)


def _resolve(text: str, tenant: str | None) -> str:
    root = text.split("/", 2)[1]
    if root in ("tenant", "system"):
        return text
    if root not in BRANCHES:
        raise _bad(text)
    if tenant is None:
        raise InvalidPath(
            f"'{text[:80]}' is a relative path and this session has no default tenant",
            remedy="Use the full path: /tenant/<tenant>/<branch>/<name>.",
        )
    return f"/tenant/{tenant}{text}"


def _bad(text: str) -> InvalidPath:
    shown = text if len(text) <= 80 else text[:77] + "..."
    return InvalidPath(f"{shown!r} is not a path")


def full_path(tenant: str, robot: str | None, name: str) -> str:
    """Return the path of a backend's `name` (`sensor/pose`), below its robot if it has one."""
    branch, _, rest = name.partition("/")
    return f"/tenant/{tenant}/{branch}/{robot}/{rest}" if robot else f"/tenant/{tenant}/{name}"


def tenant_of(path: str) -> str | None:
    """Return the tenant of a full path, or None for `/system`."""
    parts = path.split("/", 3)
    return parts[2] if parts[1] == "tenant" and len(parts) > 2 else None


@lru_cache(maxsize=1024)  # a declaration asks for the kind three times
def kind_of(name: str) -> Kind:
    """Return the kind given by the first segment of a resource's name.

    :raises InvalidPath: the name is not `<branch>/<segment>[/<segment>…]`.
    """
    branch, _, rest = name.partition("/")
    if branch not in BRANCHES or not rest or not _PATH.match("/" + name) or len(name) > MAX_PATH:
        raise InvalidPath(
            f"{name!r} is not a valid resource name",
            remedy=f"Use <branch>/<name>, where branch is one of {', '.join(Kind)}.",
        )
    return Kind(branch)


class Pattern:
    """A path in which `*` matches one segment and `**` any number, including none.

    :raises InvalidPath: the text is neither a path nor a pattern.
    """

    __slots__ = ("_match", "literal", "prefix", "text")

    def __init__(self, text: str, tenant: str | None = None) -> None:
        if not text.startswith("/") or len(text) > MAX_PATH:
            raise _bad(text)
        segments = text[1:].split("/")
        if not all(s in ("*", "**") or _SEGMENT.match(s) for s in segments):
            raise _bad(text)
        root = segments[0]
        if root not in ("tenant", "system", "**") and tenant is not None:
            if root not in BRANCHES and root != "*":
                raise _bad(text)
            segments = ["tenant", tenant, *segments]
        self.text = "/" + "/".join(segments)
        """The full pattern, including the tenant."""
        wild = next((i for i, s in enumerate(segments) if s in ("*", "**")), None)
        self.literal = wild is None
        """Whether the pattern is a plain path."""
        self.prefix = self.text if wild is None else "".join("/" + s for s in segments[:wild])
        """The longest prefix of segments without a wildcard."""
        if segments.count("**") > MAX_DEEP:  # each multiplies the possible matches of a path
            raise InvalidPath(
                f"{text[:80]!r} has more than {MAX_DEEP} '**'",
                remedy=f"Use at most {MAX_DEEP} '**' in one pattern, or several patterns.",
            )
        self._match = re.compile("".join(map(_expression, segments)) + r"\Z").match

    def matches(self, path: str) -> bool:
        """Return whether a full path matches."""
        return self._match(path) is not None

    def __repr__(self) -> str:
        return f"Pattern({self.text!r})"


def _expression(segment: str) -> str:
    if segment == "**":
        return r"(?:/[^/]+)*"
    return r"/[^/]+" if segment == "*" else "/" + re.escape(segment)


class NativeType(msgspec.Struct, frozen=True, kw_only=True):
    """A backend's own serialised type, for clients that read and write its bytes themselves."""

    name: str
    """`nav_msgs/msg/Odometry`."""
    encoding: str
    """Of the bytes: `cdr`."""
    schema_encoding: str
    """Of `schema`: `ros2msg`."""
    schema: str
    """Everything that a decoder needs."""
    decode: Callable[[bytes], Any] | None = None
    """Returns the value of a command; any error means that the bytes are no such message."""
    encode: Callable[[Any], bytes] | None = None
    """Returns the bytes of a result."""


class Resource(msgspec.Struct, frozen=True, kw_only=True):
    """One addressable resource of a robot, as its backend declares it."""

    name: str
    """Branch and name below the tenant, without a leading slash: `sensor/pose`."""
    description: str
    """One sentence for people and models, ending in a full stop."""
    value: Any = None
    """Value type of a sensor, actuator, param or event: any type that msgspec decodes.

    Numbers carry their unit: `Annotated[float, Meta(ge=0, extra_json_schema={"unit": "m/s"})]`, or
    `types.quantity("m/s", ge=0)` for short; `"1"` is the unit of a ratio or a count.
    """
    input: Any = None
    """Input type of an action or service; None takes no input."""
    output: Any = None
    """Result type of an action or service; None has no result."""
    feedback: Any = None
    """Feedback type of an action; None reports progress only."""
    robot: str | None = None
    """The robot it belongs to, if a backend has several and can halt each separately
    (`Backend.halt_robot`): the segment after the branch."""
    operations: Operation | None = None
    """Fewer operations than the branch offers (a read-only param); None offers all."""
    examples: tuple[Any, ...] = ()
    """Valid values (or inputs) as plain JSON-like data; each is checked against the type."""
    live: bool = False
    """Whether the backend publishes every change even without subscribers; reads then return the
    latest
    sample."""
    deadline: float | None = None
    """Seconds without an update after which a value counts as stale."""
    timeout: float | None = None
    """Seconds a read, write or execute may take; None uses the gateway's default for the kind."""
    policy: Policy | None = None
    """What an execute does while another runs; None: actions reject, services run concurrently."""
    outlives: bool = True
    """Whether a command continues when the session that sent it ends."""
    max_age: float | None = None
    """Maximum age in s of a command's `timestamp`; older ones are refused as `stale_command`."""
    valid_for: float | None = None
    """Validity of a write in s, after which the dead-man writes `safe`; None has no dead-man."""
    safe: Any = None
    """Value that brings the actuator to rest."""
    moves: bool | None = None
    """Whether it may move something and is refused during an e-stop. None: actuators and actions
    do,
    others do not."""
    energises: bool = False
    """Whether it arms the robot or applies torque; refused during an e-stop."""
    atomic: str | None = None
    """Name of the group of resources that the backend can write as one (`Backend.write_together`);
    None: it is only written by itself."""
    history: int = 128
    """Samples kept for `history` and for resuming subscriptions."""
    native: str | None = None
    """Name of the backend's own serialized type (`nav_msgs/msg/Odometry`), if it has one."""
    native_types: dict[str, NativeType] = {}
    """The serialised types of its `value`, or of its `input` and `output`, by these words."""
    meta: dict[str, Any] = {}
    """Further facts for discovery: the topic, node or register behind the path."""
    profiles: tuple[str, ...] = ()
    """The profiles of its robot that it is part of, as `name/version`; set by `rcp_profiles.claim`."""

    def __post_init__(self) -> None:
        kind_of(self.name)
        if self.robot is not None and self.name.split("/")[1] != self.robot:
            raise InvalidPath(
                f"{self.name!r} is not a resource of robot {self.robot!r}",
                remedy=f"Use <branch>/{self.robot}/<name>, or omit `robot`.",
            )
