"""A plan being run: its steps as a tree, each with its state."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from typing import Any

from rcp_conditions import Condition
from rcp_kernel.errors import PreconditionFailed
from rcp_kernel.values import Encoding, dump, to_plain
from rcp_kernel.wire import Body
from rcp_plans.model import Group, Plan, Step, StepState
from rcp_protocol.plain import is_index, is_list, is_map

__all__ = ["MARK", "Checked", "Filling", "Node", "every", "references"]

MARK = "$result"
_ROOM = 1_048_576  # bytes of all results in one value
_STEP = 512  # values visited per step


class Node:
    """One step."""

    __slots__ = (
        "children",
        "fallback",
        "id",
        "path",
        "place",
        "raw",
        "refers",
        "robot",
        "state",
        "step",
        "tenant",
        "until",
        "when",
    )

    def __init__(self, id_: str, step: Step) -> None:
        self.id = id_
        self.step = step
        self.children: list[Node] = []
        self.fallback: list[Node] = []
        self.path: str | None = None
        """The full path of an operation."""
        self.tenant: str | None = None
        self.robot: str | None = None
        """The robot whose values its conditions use."""
        self.place: dict[str, Any] | None = None
        """Where the place is to which a step that needs approval goes by name."""
        self.refers = False
        """Whether its value refers to results of other steps."""
        self.when: Condition | None = None
        self.until: Condition | None = None
        self.raw: Any = None
        """The whole result; if it is too long to report, as it was read."""
        self.state = StepState(step=id_, do=step.do)

    @property
    def ended(self) -> bool:
        """Whether the state is final."""
        return self.state.state not in ("pending", "running")

    @property
    def leaf(self) -> bool:
        """Whether it is an operation or a wait."""
        return not isinstance(self.step, Group)


class Checked:
    """A plan that has passed its check."""

    def __init__(self, plan: Plan, nodes: list[Node]) -> None:
        self.plan = plan
        self.nodes = nodes
        self.touches: dict[str, None] = {}
        """Paths named in the plan and its conditions, in order."""
        self.asks: list[str] = []
        """Ids of the steps that require approval."""
        self.asked: list[str] = []
        """The paths that they require it for."""

    def ask(self, node: Node, path: str) -> None:
        """Note that a step requires approval for a path."""
        self.asked.append(path)
        if node.id not in self.asks:
            self.asks.append(node.id)

    def plain(self) -> list[dict[str, Any]]:
        """List the requests that would be sent."""
        out: list[dict[str, Any]] = []
        for node in every(self.nodes):
            facts: dict[str, Any] = {"step": node.id, "do": node.step.do, "path": node.path}
            facts["value"] = getattr(node.step, "value", None)
            facts["place"] = node.place
            facts["approval"] = (node.id in self.asks) or None
            out.append({key: fact for key, fact in facts.items() if fact is not None})
        return out


def every(nodes: Iterable[Node]) -> Iterator[Node]:
    """Iterate over steps in plan order: each before its nested steps and its fallback."""
    for node in nodes:
        yield node
        yield from every(node.children)
        yield from every(node.fallback)


def references(value: Any) -> Generator[None, None, list[str]]:
    """Return the references to results in a value, in steps: `id/field/…`."""
    found: list[str] = []
    waiting: list[Any] = [value]
    count = 0
    while waiting:
        one = waiting.pop()
        if is_map(one):
            wanted = one.get(MARK)
            if len(one) == 1 and isinstance(wanted, str):
                found.append(wanted)
            else:
                waiting.extend(one.values())
        elif is_list(one):
            waiting.extend(one)
        count += 1
        if not count % _STEP:
            yield
    return found


class Filling:
    """Inserts results of other steps into a value, up to a size limit."""

    def __init__(self, known: dict[str, Node]) -> None:
        self._known = known
        self._room = _ROOM

    def fill(self, value: Any) -> Generator[None, None, Any]:
        """Return a value with its references replaced by results, in steps.

        :raises PreconditionFailed: a step has no result, or not this field, or the results are too
            long.
        """
        if is_map(value):
            wanted = value.get(MARK)
            if len(value) == 1 and isinstance(wanted, str):
                yield
                return self._take(wanted)
            out: dict[str, Any] = {}
            for number, (key, item) in enumerate(value.items(), 1):
                out[key] = (yield from self.fill(item)) if is_map(item) or is_list(item) else item
                if not number % _STEP:
                    yield
            return out
        items: list[Any] = []
        for number, item in enumerate(value, 1):
            items.append((yield from self.fill(item)) if is_map(item) or is_list(item) else item)
            if not number % _STEP:
                yield
        return items

    def _take(self, wanted: str) -> Any:
        result = _result(wanted, self._known)
        self._room -= len(dump(result, Encoding.JSON))
        if self._room < 0:
            raise PreconditionFailed(
                f"the results that the value refers to have more than {_ROOM} bytes",
                remedy="Refer to fields of the results, or send the values by yourself.",
            )
        return result


def _result(wanted: str, known: dict[str, Node]) -> Any:
    id_, *fields = wanted.split("/")
    node = known[id_]
    if node.state.state != "completed":
        raise PreconditionFailed(
            f"step '{id_}' has no result: it is {node.state.state}",
            remedy="Add a fallback to that step, or a `when` to this one.",
        )
    if isinstance(node.raw, Body):
        node.raw = to_plain(node.raw.value)
    value = node.raw
    for field in fields:
        if is_map(value) and field in value:
            value = value[field]
        elif is_list(value) and is_index(field) and int(field) < len(value):
            value = value[int(field)]
        else:
            raise PreconditionFailed(f"the result of step '{id_}' has no '{field}'")
    return value
