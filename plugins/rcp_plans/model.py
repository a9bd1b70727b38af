"""The wire format of plans, and the reported state of each step."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

import msgspec
from msgspec import Meta

from rcp_kernel.types import Time

__all__ = [
    "PATH",
    "Execute",
    "Group",
    "Operate",
    "Parallel",
    "Plan",
    "PlanResult",
    "PlanState",
    "Read",
    "Retry",
    "Sequence",
    "State",
    "Step",
    "StepState",
    "Wait",
    "Write",
]

PATH = "/system/plans"
_Seconds = Annotated[float, Meta(gt=0, le=86_400, extra_json_schema={"unit": "s"})]
_Delay = Annotated[float, Meta(ge=0, le=3600, extra_json_schema={"unit": "s"})]
_Id = Annotated[str, Meta(pattern="^[A-Za-z_][A-Za-z0-9_-]*$", max_length=64)]
_Path = Annotated[str, Meta(max_length=512)]
_Condition = Annotated[str, Meta(min_length=1, max_length=2000)]
State = Literal["pending", "running", "completed", "recovered", "failed", "skipped", "cancelled"]
"""`recovered`: the step failed, and its fallback completed."""


class Retry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How a failed step is repeated."""

    times: Annotated[int, Meta(ge=1, le=100, extra_json_schema={"unit": "1"})]
    """Maximum number of repetitions."""
    delay: _Delay = 0.0
    """Delay between two attempts."""
    on: tuple[str, ...] = ()
    """Repeat only after these error codes; by default after those marked `retryable`."""


class _Step(
    msgspec.Struct,
    frozen=True,
    forbid_unknown_fields=True,
    kw_only=True,
    omit_defaults=True,
    tag_field="do",
):
    """Fields common to all steps."""

    id: _Id | None = None
    """Used in results and reports; by default the position in the plan (`2`, `2.1`)."""
    when: _Condition | None = None
    """CEL expression over live values; the step is skipped if it is false."""
    robot: Annotated[str, Meta(max_length=64)] | None = None
    """Robot whose values conditions use; by default that of the path, or the tenant's own."""
    deadline: _Seconds | None = None
    """Maximum duration of the step, including all attempts."""
    retry: Retry | None = None
    fallback: tuple[Step, ...] = ()
    """Steps that run if this one fails; the plan continues after them."""
    after: tuple[str, ...] = ()
    """In a `parallel`: earlier steps that must complete first."""


class Read(_Step, frozen=True, tag="read"):
    """Read a resource, or all resources of a pattern; `value` has the options of `read`."""

    do: ClassVar[Literal["read"]] = "read"
    path: _Path
    value: Any = None


class Write(_Step, frozen=True, kw_only=True, tag="write"):
    """Write a value; without `path`, `value` maps paths to values that are written as one."""

    do: ClassVar[Literal["write"]] = "write"
    path: _Path | None = None
    value: Any
    valid_for: Annotated[float, Meta(gt=0, le=3600, extra_json_schema={"unit": "s"})] | None = None


class Execute(_Step, frozen=True, tag="execute"):
    """Run an action or a service to its end."""

    do: ClassVar[Literal["execute"]] = "execute"
    path: _Path
    value: Any = None


class Sequence(_Step, frozen=True, tag="sequence"):
    """Run steps in sequence."""

    do: ClassVar[Literal["sequence"]] = "sequence"
    steps: Annotated[tuple[Step, ...], Meta(min_length=1)]


class Parallel(_Step, frozen=True, tag="parallel"):
    """Run steps concurrently."""

    do: ClassVar[Literal["parallel"]] = "parallel"
    steps: Annotated[tuple[Step, ...], Meta(min_length=1)]
    limit: Annotated[int, Meta(ge=1, extra_json_schema={"unit": "1"})] | None = None
    """Maximum number of concurrent steps; unlimited by default."""
    need: Literal["all", "any"] = "all"
    """`all`: the first failure cancels the others; `any`: the first completion does."""


class Wait(_Step, frozen=True, tag="wait"):
    """Wait until a condition holds."""

    do: ClassVar[Literal["wait"]] = "wait"
    until: _Condition
    deadline: _Seconds  # pyright: ignore[reportGeneralTypeIssues] - a wait has to end


Operate = Read | Write | Execute
Group = Sequence | Parallel
Step = Read | Write | Execute | Sequence | Parallel | Wait


class Plan(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True
):
    """A plan in one of its notations: `steps`, `symbolic` or `lines`."""

    name: Annotated[str, Meta(max_length=128)] | None = None
    """A name for display."""
    steps: tuple[Step, ...] | None = None
    """Steps, run in sequence."""
    symbolic: str | None = None
    """Output of a PDDL planner: `(move_to alpha 1.0 2.0)`, one action per line."""
    lines: str | None = None
    """Command lines: `execute /action/move_to {"x": 1}`, one per line."""


class StepState(msgspec.Struct, omit_defaults=True, kw_only=True):
    """The state of a step."""

    step: str
    """Id of the step."""
    do: Literal["read", "write", "execute", "sequence", "parallel", "wait"]
    state: State = msgspec.field(default_factory=lambda: "pending")  # always written
    path: str | None = None
    tries: Annotated[int, Meta(extra_json_schema={"unit": "1"})] = 0
    progress: Annotated[float, Meta(ge=0, le=1, extra_json_schema={"unit": "1"})] | None = None
    """Progress as reported by the robot."""
    feedback: Any = None
    """Last feedback from the robot, while the step runs."""
    result: Any = None
    omitted: Annotated[int, Meta(extra_json_schema={"unit": "By"})] | None = None
    """Size of a result that is too long to report."""
    truncated: bool = False
    """Whether `result` is only the first page of a pattern; continue with `cursor`."""
    cursor: str | None = None
    error: dict[str, Any] | None = None
    message: str | None = None
    command: str | None = None
    """For an execute: the gateway's id of its command."""
    started: Time | None = None
    ended: Time | None = None


class PlanResult(msgspec.Struct, omit_defaults=True, kw_only=True):
    """The outcome of every step, in the order of the plan."""

    steps: list[StepState] = msgspec.field(default_factory=list[StepState])


class PlanState(msgspec.Struct, omit_defaults=True, kw_only=True):
    """A running or finished plan."""

    command: str
    """Id of its command, by which the plan is followed and cancelled."""
    status: str
    principal: str
    created: Time
    name: str | None = None
    finished: Time | None = None
    message: str | None = None
    steps: list[Any] = msgspec.field(default_factory=list[Any])
