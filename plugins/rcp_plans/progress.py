"""Progress reports of a running plan: step changes, overall progress, full state."""

from __future__ import annotations

from typing import Any

import msgspec

from rcp_kernel.clock import iso, now
from rcp_kernel.spi import Progress
from rcp_kernel.values import Encoding, dump
from rcp_kernel.wire import encode_body
from rcp_plans.model import PlanResult, State, StepState
from rcp_plans.node import Checked, Node, every

__all__ = ["LONGEST", "ProgressReport"]

LONGEST = 262_144
"""Maximum size of a reported result, bytes."""
_TOGETHER = 1_048_576  # bytes of all reported results of a plan
_FEEDBACK = 16_384  # bytes of a result or feedback in one message


class ProgressReport:
    """The states of all steps of one plan."""

    def __init__(self, checked: Checked) -> None:
        self._nodes = list(every(checked.nodes))
        self._counts = frozenset(n.id for top in checked.nodes for n in _counted(top))
        self._room = _TOGETHER
        self._sizes: dict[str, int] = {}
        self._done = 0.0
        self._ended = 0
        self._partly: dict[str, float] = {}
        """Progress of the unfinished steps."""
        self.progress: Progress | None = None
        """Where feedback is sent while the plan runs."""

    def change(self, node: Node, state: State, **facts: Any) -> None:
        """Set and report a step's new state."""
        self.quietly(node, state)
        for name, fact in facts.items():
            setattr(node.state, name, fact)
        if node.state.progress and node.id in self._counts and not node.ended:
            self._partly[node.id] = node.state.progress
        if self.progress is not None:
            report = self._short(node)
            self.progress(report, fraction=self._fraction())

    def quietly(self, node: Node, state: State) -> None:
        """Set a state that its group reports."""
        ended = node.ended
        node.state.state = state
        if node.id in self._counts:
            self._ended += node.ended - ended
            self._partly.pop(node.id, None)
        if state == "pending":
            fresh = StepState(step=node.id, do=node.step.do, path=node.path)
            fresh.tries = node.state.tries
            node.state = fresh
        elif state != "running":
            node.state.ended = iso(now())

    def result(self, node: Node) -> None:
        """Store a result, or only its length if it is too long to report."""
        state = node.state
        size = 0 if node.raw is None else len(encode_body(node.raw, Encoding.JSON))
        self._room += self._sizes.pop(node.id, 0)
        state.omitted = None
        state.result = node.raw
        if size > LONGEST or size > self._room:
            state.result, state.omitted = None, size
            return
        self._sizes[node.id] = size
        self._room -= size

    def _short(self, node: Node) -> StepState:
        state = msgspec.structs.replace(node.state)
        if self._sizes.get(node.id, 0) > _FEEDBACK and state.result is not None:
            state.result, state.omitted = None, self._sizes[node.id]
        if state.feedback is not None and len(dump(state.feedback, Encoding.JSON)) > _FEEDBACK:
            state.feedback = None
        return state

    def _fraction(self) -> float:
        """Return the completed fraction; repeating a step does not reduce it."""
        done = self._ended + sum(self._partly.values())
        self._done = max(self._done, done / len(self._counts))
        return self._done

    def outcome(self, *, over: bool = False) -> PlanResult:
        """Return the state of every step; with `over`, unfinished steps are reported as ended."""
        steps = [msgspec.structs.replace(node.state) for node in self._nodes]
        for state in steps:
            if over and state.state == "running":
                state.state = "cancelled"
            elif over and state.state == "pending":
                state.state = "skipped"
        return PlanResult(steps=steps)


def _counted(node: Node) -> list[Node]:
    """List the steps that count for progress: fallbacks are not expected to run."""
    if node.leaf:
        return [node]
    return [leaf for child in node.children for leaf in _counted(child)]
