"""Symbolic plans in the output format of PDDL planners: `(move_to alpha 1.0 2.0)`, timed or not."""

from __future__ import annotations

import re
from collections.abc import Callable, Generator, Iterator
from itertools import islice
from typing import Any, NamedTuple

import msgspec

from rcp_kernel.errors import BadRequest, InvalidPath, InvalidValue, RcpError
from rcp_plans.config import ARGUMENT, PlansConfig
from rcp_plans.fault import Fault
from rcp_plans.lines import word
from rcp_plans.model import Execute, Parallel, Read, Step, Write
from rcp_protocol.plain import is_list, is_map

__all__ = ["Action", "from_symbolic"]

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_ACTION = re.compile(
    rf"\s*(?:(?P<time>{_NUMBER})\s*:)?\s*\((?P<words>[^()]*)\)\s*(?:\[\s*(?P<length>{_NUMBER})\s*\])?"
)
_SEGMENT = re.compile(r"[A-Za-z0-9_.-]+\Z")
_SYNTAX = "Write one action per line: `(name argument …)`; `; ` starts a comment."


class Action(NamedTuple):
    """One parsed action."""

    name: str
    arguments: list[str]
    line: int
    time: float | None
    length: float


Unlisted = Callable[[Action, dict[str, Any]], tuple[str, Any]]
"""Returns path and value of an action that the table does not define; takes objects by name."""


def from_symbolic(
    text: str, config: PlansConfig, unlisted: Unlisted, most: int
) -> Generator[None, None, tuple[list[Step], list[Fault]]]:
    """Translate at most `most` actions, by the table or else by `unlisted`.

    In a timed plan, actions that overlap run concurrently: each begins when all actions that end
    before it in the plan have completed.
    """
    actions: list[Action] = []
    unread: list[Fault] = []
    faults: list[Fault] = []
    steps: dict[int, Step] = {}
    for found in islice(_parse(text), most):
        yield
        if isinstance(found, Fault):
            unread.append(found)
            continue
        actions.append(found)
        number = len(actions)
        try:
            steps[number - 1] = _step(str(number), found, config, unlisted)
        except RcpError as error:
            faults.append(Fault(f"line {found.line}", error))
    if any(action.time is None for action in actions) or not steps:
        return list(steps.values()), unread + faults
    return [(yield from _timed(actions, steps))], unread + faults


def _parse(text: str) -> Iterator[Action | Fault]:
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.partition(";")[0].rstrip()
        place = 0
        while place < len(line):
            match = _ACTION.match(line, place)
            if match is None:
                what = line[place:].strip()[:80]
                yield Fault(
                    f"line {number}", BadRequest(f"{what!r} is not an action", remedy=_SYNTAX)
                )
                break
            place = match.end()
            words = match["words"].split()
            if not words:
                yield Fault(f"line {number}", BadRequest("an action has no name"))
                continue
            time = None if match["time"] is None else float(match["time"])
            yield Action(words[0], words[1:], number, time, float(match["length"] or 0))


def _step(id_: str, action: Action, config: PlansConfig, unlisted: Unlisted) -> Step:
    table = config.actions.get(action.name) or config.actions.get(action.name.lower())
    if table is None:
        path, value = unlisted(action, config.objects)
        return Execute(id=id_, path=path, value=value)
    path = ARGUMENT.sub(lambda m: _in_path(m, action), table.path)
    value = _fill(table.value, action, config.objects)
    if table.do == "read":
        return Read(id=id_, path=path, value=value, deadline=table.deadline)
    if table.do == "write":
        return Write(id=id_, path=path, value=value, deadline=table.deadline)
    return Execute(id=id_, path=path, value=value, deadline=table.deadline)


def _argument(match: re.Match[str], action: Action) -> str:
    number = int(match[1])
    if number >= len(action.arguments):
        raise InvalidValue(
            f"({action.name} …) has {len(action.arguments)} arguments; its table uses "
            f"{{{number}}}, argument number {number + 1}"
        )
    return action.arguments[number]


def _in_path(match: re.Match[str], action: Action) -> str:
    text = _argument(match, action)
    if not _SEGMENT.match(text):
        raise InvalidPath(f"'{text[:40]}' in ({action.name} …) is not valid in a path")
    return text


def _fill(template: Any, action: Action, objects: dict[str, Any]) -> Any:
    if is_map(template):
        return {k: _fill(v, action, objects) for k, v in template.items()}
    if is_list(template):
        return [_fill(v, action, objects) for v in template]
    if not isinstance(template, str):
        return template
    whole = ARGUMENT.fullmatch(template)
    if whole is not None:
        return _object(whole, action, objects)
    return ARGUMENT.sub(lambda m: str(_object(m, action, objects)), template)


def _object(match: re.Match[str], action: Action, objects: dict[str, Any]) -> Any:
    text = _argument(match, action)
    value = objects[text] if text in objects else word(text)
    for field in match[2].split(".")[1:]:
        if not is_map(value) or field not in value:
            raise InvalidValue(
                f"'{text[:40]}' in ({action.name} …) has no field '{field}'",
                remedy="Use an object in `[plans.objects]` that has it.",
            )
        value = value[field]
    return value


def _timed(actions: list[Action], steps: dict[int, Step]) -> Generator[None, None, Parallel]:
    order = sorted(steps, key=lambda n: (actions[n].time or 0.0, n))
    out: list[Step] = []
    for place, number in enumerate(order):
        start = (actions[number].time or 0.0) + 1e-6
        before = [n for n in order[:place] if (actions[n].time or 0.0) + actions[n].length <= start]
        after = tuple(steps[n].id or "" for n in before)
        out.append(msgspec.structs.replace(steps[number], after=after))
        yield
    return Parallel(id="plan", steps=tuple(out))
