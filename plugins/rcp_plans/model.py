"""What a plan looks like on the wire, and what is told of each of its steps."""

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
"""`recovered`: it failed, and its fallback completed."""


class Retry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Try a failed step again."""

    times: Annotated[int, Meta(ge=1, le=100, extra_json_schema={"unit": "1"})]
    """Further tries at most."""
    delay: _Delay = 0.0
    """Between two tries."""
    on: tuple[str, ...] = ()
    """Only after these error codes; those that say `retryable` if none is named."""


class _Step(
    msgspec.Struct,
    frozen=True,
    forbid_unknown_fields=True,
    kw_only=True,
    omit_defaults=True,
    tag_field="do",
):
    """What every step may have."""

    id: _Id | None = None
    """For results and reports; its place in the plan (`2`, `2.1`) if not given."""
    when: _Condition | None = None
    """CEL over live values; the step is skipped unless it holds."""
    robot: Annotated[str, Meta(max_length=64)] | None = None
    """Whose values conditions mean; that of the path, or the tenant's own, if not given."""
    deadline: _Seconds | None = None
    """For the step with all its tries."""
    retry: Retry | None = None
    fallback: tuple[Step, ...] = ()
    """Steps that are run if this one fails; the plan goes on after them."""
    after: tuple[str, ...] = ()
    """In a `parallel`: earlier steps of it that have to complete first."""


class Read(_Step, frozen=True, tag="read"):
    """Read a resource, or all of a pattern; `value` has the options of `read`."""

    do: ClassVar[Literal["read"]] = "read"
    path: _Path
    value: Any = None


class Write(_Step, frozen=True, tag="write"):
    """Write a value."""

    do: ClassVar[Literal["write"]] = "write"
    path: _Path
    value: Any
    valid_for: Annotated[float, Meta(gt=0, le=3600, extra_json_schema={"unit": "s"})] | None = None


class Execute(_Step, frozen=True, tag="execute"):
    """Run an action or a service to its end."""

    do: ClassVar[Literal["execute"]] = "execute"
    path: _Path
    value: Any = None


class Sequence(_Step, frozen=True, tag="sequence"):
    """Run steps one after the other."""

    do: ClassVar[Literal["sequence"]] = "sequence"
    steps: Annotated[tuple[Step, ...], Meta(min_length=1)]


class Parallel(_Step, frozen=True, tag="parallel"):
    """Run steps side by side."""

    do: ClassVar[Literal["parallel"]] = "parallel"
    steps: Annotated[tuple[Step, ...], Meta(min_length=1)]
    limit: Annotated[int, Meta(ge=1, extra_json_schema={"unit": "1"})] | None = None
    """At once; without it all of them."""
    need: Literal["all", "any"] = "all"
    """`all`: the first failure cancels the others; `any`: the first that completes does."""


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
    """For people."""
    steps: tuple[Step, ...] | None = None
    """Run one after the other."""
    symbolic: str | None = None
    """What a PDDL planner prints: `(move_to alpha 1.0 2.0)`, one action a line."""
    lines: str | None = None
    """The command syntax: `execute /action/move_to {"x": 1}`, one command a line."""


class StepState(msgspec.Struct, omit_defaults=True, kw_only=True):
    """What has become of a step."""

    step: str
    """Its id."""
    do: Literal["read", "write", "execute", "sequence", "parallel", "wait"]
    state: State = msgspec.field(default_factory=lambda: "pending")  # always written
    path: str | None = None
    tries: Annotated[int, Meta(extra_json_schema={"unit": "1"})] = 0
    progress: Annotated[float, Meta(ge=0, le=1, extra_json_schema={"unit": "1"})] | None = None
    """The part done that the robot reports."""
    feedback: Any = None
    """What the robot reported last, while it runs."""
    result: Any = None
    omitted: Annotated[int, Meta(extra_json_schema={"unit": "By"})] | None = None
    """Length of a result that is too long to be told here."""
    truncated: bool = False
    """Whether `result` is only the first page of what a pattern reads; `cursor` leads on."""
    cursor: str | None = None
    error: dict[str, Any] | None = None
    message: str | None = None
    command: str | None = None
    """Of an execute: the gateway's id of its command."""
    started: Time | None = None
    ended: Time | None = None


class PlanResult(msgspec.Struct, omit_defaults=True, kw_only=True):
    """The outcome of every step, in the order of the plan."""

    steps: list[StepState] = msgspec.field(default_factory=list[StepState])


class PlanState(msgspec.Struct, omit_defaults=True, kw_only=True):
    """A plan that runs or ran."""

    command: str
    """Its command's id: by it the plan is cancelled and followed."""
    status: str
    principal: str
    created: Time
    name: str | None = None
    finished: Time | None = None
    message: str | None = None
    steps: list[Any] = msgspec.field(default_factory=list[Any])
