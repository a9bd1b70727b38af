"""The words of the contract as data: paths, patterns, kinds, operations, resources, samples.

A path is a plain `str` wherever speed counts; the functions here make sure it is a good one.
"""

from __future__ import annotations

import re
from enum import IntFlag, StrEnum
from typing import Any, Literal

import msgspec

from rcp_protocol.errors import InvalidPath

__all__ = [
    "BRANCHES",
    "MAX_PATH",
    "MOVING",
    "Kind",
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

MAX_PATH = 512  # characters: longer texts are refused unread
MAX_DEEP = 3  # `**` in one pattern
_SEGMENT = re.compile(r"[A-Za-z0-9_.-]+\Z")
_PATH = re.compile(r"(?:/[A-Za-z0-9_.-]+)+\Z")

Policy = Literal["reject", "queue", "preempt", "parallel"]


class Kind(StrEnum):
    """What a resource is; for tenants' resources the same word as the branch of its path."""

    SENSOR = "sensor"
    ACTUATOR = "actuator"
    PARAM = "param"
    ACTION = "action"
    SERVICE = "service"
    EVENT = "event"


class Operation(IntFlag):
    """What may be done with a resource; `DISCOVER` is a right, never an offer of a resource."""

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
"""Each branch with the operations its resources offer unless they declare fewer."""

MOVING = frozenset((Kind.ACTUATOR, Kind.ACTION))
"""Kinds that move something unless their resource says otherwise."""

_ORDER = (
    Operation.READ,
    Operation.WRITE,
    Operation.EXECUTE,
    Operation.SUBSCRIBE,
    Operation.DISCOVER,
)


def operation_names(operations: Operation) -> list[str]:
    """List the operations in the contract's order and spelling."""
    return [op.name.lower() for op in _ORDER if op in operations and op.name]


def parse_path(text: str, tenant: str | None) -> str:
    """Return the full path that `text` means for a session of `tenant`.

    :raises InvalidPath: for anything that is not a path of the tree.
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
    """Place a backend's own `name` (`sensor/pose`) in the tree, under its robot if it has one."""
    branch, _, rest = name.partition("/")
    return f"/tenant/{tenant}/{branch}/{robot}/{rest}" if robot else f"/tenant/{tenant}/{name}"


def tenant_of(path: str) -> str | None:
    """Return the tenant of a full path, or None for the gateway's own branch."""
    parts = path.split("/", 3)
    return parts[2] if parts[1] == "tenant" and len(parts) > 2 else None


def kind_of(name: str) -> Kind:
    """Return the kind that the first segment of a resource's own name says.

    :raises InvalidPath: if the name is not `<branch>/<segment>[/<segment>…]`.
    """
    branch, _, rest = name.partition("/")
    if branch not in BRANCHES or not rest or not _PATH.match("/" + name) or len(name) > MAX_PATH:
        raise InvalidPath(
            f"{name!r} is not a valid resource name",
            remedy=f"Use <branch>/<name>, where branch is one of {', '.join(Kind)}.",
        )
    return Kind(branch)


class Pattern:
    """A path in which `*` stands for one segment and `**` for any number, none included.

    :raises InvalidPath: if the text is neither a path nor a pattern.
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
        """The pattern with its tenant written out."""
        wild = next((i for i, s in enumerate(segments) if s in ("*", "**")), None)
        self.literal = wild is None
        """Whether the pattern is a plain path."""
        self.prefix = self.text if wild is None else "".join("/" + s for s in segments[:wild])
        """The longest run of leading segments without a wildcard."""
        if segments.count("**") > MAX_DEEP:  # each one multiplies the ways to match a path
            raise InvalidPath(
                f"{text[:80]!r} has more than {MAX_DEEP} '**'",
                remedy=f"Use at most {MAX_DEEP} '**' in one pattern, or several patterns.",
            )
        self._match = re.compile("".join(map(_expression, segments)) + r"\Z").match

    def matches(self, path: str) -> bool:
        """Tell whether a full path is one of those the pattern stands for."""
        return self._match(path) is not None

    def __repr__(self) -> str:
        return f"Pattern({self.text!r})"


def _expression(segment: str) -> str:
    if segment == "**":
        return r"(?:/[^/]+)*"
    return r"/[^/]+" if segment == "*" else "/" + re.escape(segment)


class Resource(msgspec.Struct, frozen=True, kw_only=True):
    """One addressable thing of a robot, as its backend declares it."""

    name: str
    """Branch and name below the tenant, without a leading slash: `sensor/pose`."""
    description: str
    """One sentence for a person or a model, ending in a full stop."""
    value: Any = None
    """Type of the value of a sensor, actuator, param or event: anything msgspec decodes.

    Numbers carry their unit: `Annotated[float, Meta(ge=0, extra_json_schema={"unit": "m/s"})]`,
    or `types.quantity("m/s", ge=0)` for short; `"1"` is the unit of a ratio or a count."""
    input: Any = None
    """Type of the input of an action or service; None takes no input."""
    output: Any = None
    """Type of the result of an action or service; None has no result."""
    feedback: Any = None
    """Type of the feedback of an action; None reports progress only."""
    robot: str | None = None
    """Which robot it is part of, where a backend fronts several and can halt each alone
    (`Backend.halt_robot`): the segment after the branch."""
    operations: Operation | None = None
    """Fewer operations than the branch offers (a read-only param); None offers them all."""
    examples: tuple[Any, ...] = ()
    """Good values (or inputs), as plain JSON-like data; each is checked against the type."""
    live: bool = False
    """The backend publishes every change by itself, watched or not; reads are then answered from
    the latest sample."""
    deadline: float | None = None
    """Seconds after which a value without a successor counts as stale."""
    timeout: float | None = None
    """Seconds a read, write or execute may take; None takes the gateway's default for its kind."""
    policy: Policy | None = None
    """What an execute does while another one runs; None: actions reject, services run beside."""
    outlives: bool = True
    """A command goes on when the session that sent it ends."""
    max_age: float | None = None
    """Seconds; an older `timestamp` on a command is refused as `stale_command`."""
    valid_for: float | None = None
    """Seconds a write stands before the dead-man writes `safe`; None has no dead-man."""
    safe: Any = None
    """Value that brings the actuator to rest."""
    moves: bool | None = None
    """Whether it may move something: refused under a latched e-stop. None: actuators and actions
    do, the rest does not."""
    energises: bool = False
    """Whether it arms the robot or gives its motors torque: refused under a latched e-stop."""
    history: int = 128
    """Samples kept for `history` and for resume while somebody may want them."""
    native: str | None = None
    """Name of the backend's own serialised type (`nav_msgs/msg/Odometry`), where it has one."""
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
