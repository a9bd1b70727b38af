"""The fixed tools: argument types, descriptions and hints."""

from __future__ import annotations

from typing import Annotated, Any, Literal, NamedTuple

import msgspec
from mcp import types
from msgspec import Meta

from rcp_kernel.values import ValueType, value_type
from rcp_mcp.schemas import arguments

__all__ = [
    "FIXED",
    "INVENTORY",
    "PLANS",
    "Cancel",
    "Discover",
    "Execute",
    "Plan",
    "Read",
    "Robots",
    "Status",
    "Watch",
    "Write",
    "WriteAll",
]

INVENTORY = "/system/robots"
PLANS = "/system/plans"

_Seconds = Meta(gt=0, le=86_400, extra_json_schema={"unit": "s"})
_PATH = "Such as `/sensor/pose`, or with its tenant `/tenant/alpha/sensor/pose`."
_APPROVAL = "Id of the approval, from the refusal."
_KEY = "The same key is not executed twice."
_CURSOR = "From the previous result."


_ValidFor = Annotated[
    float,
    Meta(
        gt=0,
        le=3600,
        description="Time after which the robot is stopped unless the value is written again.",
        extra_json_schema={"unit": "s"},
    ),
]


class _Call(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of the arguments; unknown ones are refused."""


class Robots(_Call, frozen=True):
    """Which robots to list; all arguments are optional."""

    q: (
        Annotated[
            str,
            Meta(
                description="Words that must all occur in the path, kind, model or profiles, such "
                "as `drone` or `arm`."
            ),
        ]
        | None
    ) = None
    details: Annotated[
        bool, Meta(description="Include vendor, model, limits, dimensions and frames (long).")
    ] = False
    limit: Annotated[int, Meta(ge=1, le=200)] = 50
    cursor: Annotated[str, Meta(description=_CURSOR)] | None = None


class Discover(_Call, frozen=True):
    """What to search for; all arguments are optional."""

    q: (
        Annotated[str, Meta(description="Words that must all occur in the path or description.")]
        | None
    ) = None
    path: Annotated[str, Meta(description="A pattern: `*` is one segment, `**` any number.")] = (
        "/**"
    )
    kind: Literal["sensor", "actuator", "param", "action", "service", "event"] | None = None
    op: Literal["read", "write", "execute", "subscribe"] | None = None
    schemas: Annotated[bool, Meta(description="Include schemas and examples (long).")] = False
    limit: Annotated[int, Meta(ge=1, le=200)] = 50
    cursor: Annotated[str, Meta(description=_CURSOR)] | None = None


_Part = Annotated[float, Meta(ge=0, le=1)]


class Read(_Call, frozen=True):
    """The values to read."""

    path: Annotated[
        Annotated[str, Meta(min_length=1)]
        | Annotated[tuple[str, ...], Meta(min_length=1, max_length=20)],
        Meta(description=_PATH + " A pattern or a list reads several."),
    ]
    fields: (
        Annotated[tuple[str, ...], Meta(description="Only these, such as `position.x`.")] | None
    ) = None
    fresh: Annotated[bool, Meta(description="Ask the robot, even if a recent value is known.")] = (
        False
    )
    frame: (
        Annotated[
            str,
            Meta(
                description="Frame of the values: `map`, `base_link`, `earth` (latitude, longitude)."
            ),
        ]
        | None
    ) = None
    size: (
        Annotated[int, Meta(ge=16, le=4096, description="Longest side of pictures, in pixels.")]
        | None
    ) = None
    crop: (
        Annotated[
            tuple[_Part, ...],
            Meta(
                min_length=4,
                max_length=4,
                description="Part of pictures: left, top, width, height, as fractions.",
            ),
        ]
        | None
    ) = None
    since: (
        Annotated[
            str, Meta(description="`mark` of an earlier result: only what has changed since.")
        ]
        | None
    ) = None
    cursor: Annotated[str, Meta(description=_CURSOR)] | None = None


class Write(_Call, frozen=True):
    """The value to write."""

    path: Annotated[str, Meta(description=_PATH)]
    value: Any
    valid_for: _ValidFor | None = None
    dry_run: Annotated[bool, Meta(description="Check the request without changing anything.")] = (
        False
    )
    idempotency_key: Annotated[str, Meta(max_length=256, description=_KEY)] | None = None
    approval: Annotated[str, Meta(max_length=128, description=_APPROVAL)] | None = None


class WriteAll(_Call, frozen=True):
    """The values to write as one."""

    values: Annotated[
        dict[str, Any],
        Meta(min_length=1, max_length=64, description="Each path with its value."),
    ]
    valid_for: _ValidFor | None = None
    dry_run: Annotated[bool, Meta(description="Check the request without changing anything.")] = (
        False
    )
    idempotency_key: Annotated[str, Meta(max_length=256, description=_KEY)] | None = None
    approval: Annotated[str, Meta(max_length=128, description=_APPROVAL)] | None = None


class Execute(_Call, frozen=True):
    """The action or service to run, with its input."""

    path: Annotated[str, Meta(description="Such as `/action/move_to`.")]
    input: Any = None
    deadline: Annotated[float, _Seconds] | None = None
    wait: Annotated[float, Meta(ge=0, le=3600, extra_json_schema={"unit": "s"})] | None = None
    dry_run: Annotated[bool, Meta(description="Check the command without running it.")] = False
    idempotency_key: Annotated[str, Meta(max_length=256, description=_KEY)] | None = None
    approval: Annotated[str, Meta(max_length=128, description=_APPROVAL)] | None = None


class Cancel(_Call, frozen=True):
    """The command to cancel: by its id, or whatever runs on a path."""

    command: str | None = None
    path: str | None = None


class Plan(_Call, frozen=True):
    """The plan to run."""

    plan: Annotated[
        dict[str, Any] | str,
        Meta(
            description='`{"steps": […]}` with steps such as `{"do": "execute", "path": …, '
            '"value": …}`, or commands, one per line: `execute /action/dock`.'
        ),
    ]
    deadline: Annotated[float, _Seconds] | None = None
    wait: Annotated[float, Meta(ge=0, le=3600, extra_json_schema={"unit": "s"})] | None = None
    dry_run: bool = False
    idempotency_key: Annotated[str, Meta(max_length=256)] | None = None
    approval: Annotated[str, Meta(max_length=128)] | None = None


class Status(_Call, frozen=True):
    """Status of the gateway, or of one command."""

    command: Annotated[str, Meta(description="Command id from the result of a call.")] | None = None
    wait: Annotated[
        float,
        Meta(
            ge=0,
            le=3600,
            description="Wait at most this time for the command to end.",
            extra_json_schema={"unit": "s"},
        ),
    ] = 0.0


class Watch(_Call, frozen=True):
    """What to record: until the number of samples or the time is reached, whichever is first."""

    paths: Annotated[tuple[str, ...], Meta(min_length=1, max_length=20, description=_PATH)]
    samples: Annotated[int, Meta(ge=1, le=500)] = 10
    seconds: Annotated[float, Meta(gt=0, le=600, extra_json_schema={"unit": "s"})] = 10.0
    rate: (
        Annotated[
            float,
            Meta(
                gt=0,
                le=100,
                description="Maximum samples per second and path.",
                extra_json_schema={"unit": "Hz"},
            ),
        ]
        | None
    ) = None
    on_change: Annotated[
        bool, Meta(description="Only samples that differ from the previous one.")
    ] = False
    each: Annotated[bool, Meta(description="Return every sample.")] = False


class Fixed(NamedTuple):
    """One fixed tool."""

    tool: types.Tool
    takes: ValueType
    needs: str | None
    """The operation that the caller must be allowed somewhere."""
    of: str | None
    """A resource that the caller must see."""


def _fixed(
    name: str,
    takes: type[_Call],
    words: str,
    examples: list[Any],
    *,
    needs: str | None = None,
    of: str | None = None,
    changes: bool = False,
    stops: bool = False,
) -> Fixed:
    type_ = value_type(takes)
    schema = arguments(type_.schema, examples, {}).schema
    del schema["description"]  # the tool has one
    hints = types.ToolAnnotations(
        read_only_hint=not changes,
        destructive_hint=changes and not stops,
        idempotent_hint=not changes or stops or name.startswith("write"),
        open_world_hint=changes,
    )
    tool = types.Tool(
        name=name,
        description=words,
        input_schema=schema,
        annotations=hints,
    )
    return Fixed(tool, type_, needs, of)


FIXED: dict[str, Fixed] = {
    one.tool.name: one
    for one in (
        _fixed(
            "robots",
            Robots,
            "List the robots: path, kind, state, mode, battery (0 to 1), position, profiles, and "
            "who has control. Start here; then `discover` the resources of one, such as "
            "`/tenant/alpha/*/r1/**` for the robot `/tenant/alpha/r1`.",
            [{}, {"q": "drone"}],
            of=INVENTORY,
        ),
        _fixed(
            "discover",
            Discover,
            "List resources (sensors, actuators, parameters, actions, services, events) with the "
            "operations you may use, the unit and an example; search with `q`; `schemas` of one "
            "path describe its input.",
            [{}, {"q": "battery"}, {"path": "/action/*", "schemas": True}],
        ),
        _fixed(
            "read",
            Read,
            "Read current values, also of several robots: cameras and maps return pictures with "
            "the robot's pose, scans the nearest obstacle by sector (`fields` for the raw values), "
            "`/system/places` the named places.",
            [{"path": "/sensor/pose"}, {"path": ["/sensor/camera", "/sensor/scan"], "size": 320}],
            needs="read",
        ),
        _fixed(
            "write",
            Write,
            "Set a parameter or command an actuator. A velocity command is valid for a short "
            "time only: the robot stops unless it is written again.",
            [{"path": "/param/speed_limit", "value": 0.5}],
            needs="write",
            changes=True,
        ),
        _fixed(
            "write_all",
            WriteAll,
            "Write several paths of one robot as one, such as both wheels: all of them come into "
            "force at once, or none. They must have the same `atomic` group in `discover`.",
            [{"values": {"/actuator/left/velocity": 1.0, "/actuator/right/velocity": 1.0}}],
            needs="write",
            changes=True,
        ),
        _fixed(
            "execute",
            Execute,
            "Run an action or service by its path; `discover` with `schemas` describes its input. A "
            "long action returns `in_progress` with a command id.",
            [{"path": "/action/move_to", "input": {"position": {"place": "dock", "distance": 1}}}],
            needs="execute",
            changes=True,
        ),
        _fixed(
            "plan",
            Plan,
            "Check several steps as a whole, then run them as one command, in sequence or "
            "parallel, with conditions and fallbacks. `discover` with path `/system/plans` and "
            "`schemas` describes all that a step can have.",
            [{"plan": "execute /action/dock\nread /sensor/battery", "dry_run": True}],
            of=PLANS,
            changes=True,
        ),
        _fixed(
            "cancel",
            Cancel,
            "Cancel a running command; the robot is informed at once.",
            [{"command": "cmd-0123456789abcdef"}, {"path": "/action/move_to"}],
            needs="execute",
            changes=True,
            stops=True,
        ),
        _fixed(
            "status",
            Status,
            "Return the gateway's health and the running commands; with `command`, the "
            "progress of that command, or its result if it ends within `wait`.",
            [{}, {"command": "cmd-0123456789abcdef", "wait": 30}],
        ),
        _fixed(
            "watch",
            Watch,
            "Record values for a number of samples or seconds and return the trend of each number.",
            [{"paths": ["/sensor/battery"], "samples": 3, "seconds": 10}],
            needs="subscribe",
        ),
    )
}
"""The fixed tools by name."""
