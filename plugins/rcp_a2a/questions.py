"""The questions of a task whose plan cannot continue, and the effect of the answers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Literal

import msgspec

from rcp_a2a.messages import TaskRequest
from rcp_kernel.features import ServiceKey

__all__ = [
    "LINES",
    "Decision",
    "Question",
    "decision_of",
    "is_plan",
    "mended",
    "question_of",
    "with_schemas",
]

Node = dict[str, Any]
Lines = Callable[[str], list[Node]]
LINES: ServiceKey[Lines] = ServiceKey("plans.lines")
"""Service of the feature that runs plans: translates commands, one per line, into steps."""
Decision = Literal["approve", "reject"]
_DECISIONS: dict[str, Decision] = {
    "approve": "approve",
    "yes": "approve",
    "reject": "reject",
    "no": "reject",
}
_COMMANDS = ("read", "write", "execute")
_NOTATIONS = frozenset(("steps", "symbolic", "lines"))


class Question(msgspec.Struct, frozen=True):
    """What is missing."""

    text: str
    """Text for people."""
    approval: str | None = None
    """Id of the approval that the plan requires."""
    missing: tuple[Node, ...] = ()
    """Missing parameters: `step`, `path`, and a JSON Pointer into the step's value."""
    details: Node = {}

    @property
    def plain(self) -> Node:
        """Return the question as data."""
        if self.approval is not None:
            return {"question": "approval", "decisions": ["approve", "reject"], **self.details}
        return {"question": "parameters", "missing": list(self.missing)}


def question_of(facts: Node) -> Question | None:
    """Return the question whose answer would let a refused plan continue."""
    error: Node = facts.get("error") or {}
    details: Node = error.get("details") or {}
    if error.get("code") == "approval_required" and isinstance(details.get("approval"), str):
        return Question(f"{error['message']}.", details["approval"], (), details)
    faults: list[Node] = details.get("faults") or []
    missing = tuple(map(_missing, faults))
    if not missing or not all(missing):
        return None
    places = ", ".join(
        f"step '{m['step']}' {m['pointer'] or 'its whole input'}" for m in missing if m
    )
    return Question(f"Parameters are missing: {places}.", None, tuple(m for m in missing if m))


def with_schemas(question: Question, schema: Callable[[str], Any]) -> Question:
    """Return a question with the schemas of its parameters."""
    missing = tuple({**m, "schema": schema(m["path"])} for m in question.missing)
    return msgspec.structs.replace(question, missing=missing)


def _missing(fault: Node) -> Node | None:
    pointer = (fault.get("details") or {}).get("missing")
    if pointer is None or "path" not in fault:
        return None
    return {
        "step": fault["step"],
        "path": fault["path"],
        "pointer": pointer,
        "message": fault["message"],
    }


def is_plan(answer: TaskRequest) -> bool:
    """Return whether an answer is itself a plan; free text is not."""
    body = answer.body
    if not isinstance(body, dict) or not _NOTATIONS & body.keys():
        return False
    words = str(body.get("lines", "read")).split(maxsplit=1)
    return bool(words) and words[0].lower() in _COMMANDS


def decision_of(answer: TaskRequest) -> Decision | None:
    """Return the decision on an approval; None if the answer contains none."""
    body = answer.body
    if isinstance(body, dict):
        named: Any = body.get("decision")
        if named is None and body.keys() == {"lines"}:
            named = body["lines"]
        if isinstance(named, str):
            return _DECISIONS.get(named.strip().strip(".!").lower())
    return None


def mended(
    plan: TaskRequest, question: Question, answer: TaskRequest, lines: Lines
) -> TaskRequest | None:
    """Return the plan completed by an answer: a whole plan, or the missing parameters.

    Parameters are given by the id of their step, or alone if only one step lacks any. None: the
    answer contains neither.
    """
    if is_plan(answer):
        return answer
    body = _value(answer.body)
    steps = {missing["step"] for missing in question.missing}
    if isinstance(body, dict) and steps & body.keys():
        given: Node = body
    elif len(steps) == 1 and body is not None:
        given = dict.fromkeys(steps, body)
    else:
        return None
    whole = _with_steps(plan.body, lines)
    if whole is None:
        return None
    for id_, step in _every(whole["steps"], ""):
        if id_ in given and id_ in steps:
            step["value"] = _merged(step.get("value"), given[id_])
    return msgspec.structs.replace(plan, body=whole)


def _value(body: Any) -> Any:
    """Parse a text that is not a plan: as JSON, or not at all."""
    if isinstance(body, dict) and body.keys() == {"lines"}:
        try:
            return msgspec.json.decode(body["lines"])
        except (msgspec.DecodeError, RecursionError):
            return None
    return body


def _with_steps(body: Any, lines: Lines) -> Node | None:
    """Return a copy of a plan as a list of steps; None if that is not possible."""
    plan: Any = msgspec.json.decode(msgspec.json.encode(body))
    if not isinstance(plan, dict):
        return None
    if "lines" in plan:
        # Without ids: the gateway numbers them again by position.
        return {"steps": [{**step, "id": None} for step in lines(str(plan["lines"]))]}
    return plan if isinstance(plan.get("steps"), list) else None


def _every(steps: list[Any], place: str) -> Iterator[tuple[str, Node]]:
    """Iterate over all steps with their ids, as the gateway numbers them."""
    for number, step in enumerate(steps, 1):
        if not isinstance(step, dict):
            continue
        id_ = str(step.get("id") or f"{place}{number}")
        yield id_, step
        yield from _every(step.get("steps") or [], f"{id_}.")
        yield from _every(step.get("fallback") or [], f"{id_}.fallback.")


def _merged(value: Any, given: Any) -> Any:
    if isinstance(value, dict) and isinstance(given, dict):
        return {**value, **{name: _merged(value.get(name), item) for name, item in given.items()}}
    return given
