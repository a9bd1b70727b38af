"""What `/system/triggers`, `/system/alarms` and `/system/firings` carry."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from rcp_kernel.types import Time
from rcp_triggers.machine import State
from rcp_triggers.spec import NAME, Severity, Spec

__all__ = [
    "AlarmRequest",
    "AlarmState",
    "Firing",
    "NewTrigger",
    "RobotState",
    "TestResult",
    "TriggerReply",
    "TriggerRequest",
    "TriggerState",
]

_Name = Annotated[str, Meta(pattern=NAME, max_length=64)]
_Count = Annotated[int, Meta(extra_json_schema={"unit": "1"})]
Known = Literal["true", "false", "unknown"]


class NewTrigger(Spec, frozen=True, kw_only=True):
    """A trigger that somebody makes."""

    name: _Name


class TriggerRequest(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True
):
    """One thing to do."""

    add: NewTrigger | None = None
    remove: str | None = None
    """The name of a trigger."""
    test: str | None = None
    """The name of a trigger: what would it do now?"""


class TestResult(msgspec.Struct, kw_only=True, omit_defaults=True):
    """What a trigger would do for one robot now."""

    __test__ = False
    robot: str
    condition: Known
    unknown: dict[str, str] = {}
    values: dict[str, Any] = {}
    would: list[str] = []
    refused: str | None = None
    """Why its command would be refused."""


class TriggerReply(msgspec.Struct, kw_only=True, omit_defaults=True):
    """What was done."""

    did: Literal["added", "removed", "tested"]
    trigger: str
    robots: list[TestResult] = []
    ends: str | None = None
    """When it stops with the credentials of its maker; None: not by itself."""


class RobotState(msgspec.Struct, kw_only=True, omit_defaults=True):
    """A trigger on one robot."""

    robot: str
    condition: Known
    state: State
    unknown: dict[str, str] = {}
    """Names in the condition whose values are not known, each with the reason."""
    since: Time | None = None
    """When it came into this state."""
    fired: Time | None = None
    """When it fired last."""
    firings: _Count = 0
    suppressed: _Count = 0
    """Firings that a limit or the cool-down swallowed."""
    limited: bool = False
    """Whether firings are suppressed now because there were too many."""
    outcome: str | None = None
    """What came of its last command: `completed`, or an error code."""
    detail: str | None = None


class TriggerState(msgspec.Struct, kw_only=True, omit_defaults=True):
    """A trigger."""

    trigger: str
    spec: Spec
    by: str | None = None
    """Who made it; None: it is in the configuration."""
    made: Time | None = None
    stopped: str | None = None
    """Why it is not evaluated."""
    robots: list[RobotState] = []


class AlarmRequest(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True
):
    """Acknowledges an alarm."""

    acknowledge: Annotated[str, Meta(min_length=1, max_length=64)]
    """Its id."""
    comment: Annotated[str, Meta(max_length=1000)] = ""


class AlarmState(msgspec.Struct, kw_only=True, omit_defaults=True):
    """An alarm: open until it has cleared and somebody has acknowledged it."""

    alarm: str
    trigger: str
    tenant: str
    robot: str
    severity: Severity
    message: str
    raised: Time
    last: Time
    """When its trigger fired last."""
    state: Literal["active", "acknowledged", "cleared", "closed"] = msgspec.field(
        default_factory=lambda: "active"  # always written
    )
    """`active`: nobody has acknowledged it; `acknowledged`: it has not cleared; `cleared`: it has,
    and nobody has acknowledged it."""
    count: _Count = 1
    cleared: Time | None = None
    acknowledged: Time | None = None
    by: str | None = None
    comment: str = ""
    paths: tuple[str, ...] = ()
    """The resources that it is about."""


class Firing(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What happened to a trigger."""

    id: str
    time: Time
    trigger: str
    tenant: str
    robot: str
    what: Literal["fired", "cleared", "limited", "command", "stopped", "resumed"]
    severity: Severity
    message: str
    condition: str
    values: dict[str, Any] = {}
    alarm: str | None = None
    outcome: str | None = None
    """For a command: `completed`, an error code, or `unknown` if nobody waited for its end."""
    detail: str | None = None
    by: str | None = None
    """Who made the trigger."""
    paths: tuple[str, ...] = ()
    """The resources that it is about."""
