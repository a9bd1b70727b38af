"""The check of a whole plan before its first step: reports every fault and changes nothing.

Whatever depends on the state of a robot (conditions, rate limits, running actions) may have changed
when a step begins; it is checked then, as for any request.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from itertools import islice
from typing import Any

import msgspec

from rcp_kernel.contract.paths import EVERYTHING
from rcp_kernel.errors import (
    BY_CODE,
    BadRequest,
    DuplicateRequest,
    InvalidValue,
    OutOfRange,
    PreconditionFailed,
    RcpError,
    UnknownPath,
    UnsupportedOperation,
)
from rcp_kernel.features import ActionHost
from rcp_kernel.features.approval import ApprovalService
from rcp_kernel.features.control import ControlService
from rcp_kernel.model import Operation, Pattern
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.scope import Scope
from rcp_kernel.values import Encoding, ValueType, dump
from rcp_plans.config import PlansConfig
from rcp_plans.fault import Fault, refusal
from rcp_plans.lines import from_lines
from rcp_plans.looking import looked_at
from rcp_plans.model import Execute, Group, Operate, Parallel, Plan, Read, Retry, Step, Write
from rcp_plans.names import NameScope
from rcp_plans.node import MARK, Checked, Node, references
from rcp_plans.pace import Allowance
from rcp_plans.places import place_in
from rcp_plans.reading import ConditionReader
from rcp_plans.symbolic import from_symbolic
from rcp_protocol.plain import is_map
from rcp_protocol.similarity import Nearest, nearest
from rcp_scheduling.turns import Work

__all__ = ["PlanChecker"]

_OPERATIONS = {
    "read": Operation.READ,
    "write": Operation.WRITE,
    "execute": Operation.EXECUTE,
}
_NOT_HERE = ("/system/plans", "/system/approvals")
_SEARCHES = 5  # misspelt names per plan for which similar names are searched
_STEP = 32  # resources checked per step
_COMPARED = 2000  # resources of which the paths are compared with an unknown one
_AT_ONCE = 400  # names compared in one step
_MARK = f'"{MARK}"'.encode()


@dataclass(frozen=True, slots=True)
class PlanChecker:
    """Checks plans against everything that their steps will have to pass."""

    host: ActionHost
    control: ControlService
    approvals: ApprovalService
    config: PlansConfig
    allowance: Allowance
    """Time budgets of the principals that send conditions."""

    def check(self, session: Session, plan: Plan) -> Generator[None, None, Checked]:
        """Return a valid plan, or refuse it with all its faults; runs in steps.

        :raises RateLimited: the sender has used up the time for compiling conditions.
        :raises RcpError: with the code of the first fault, and all faults in `details.faults`.
        """
        return _Check(self, session).check(plan)


class _Check:
    """One check."""

    def __init__(self, against: PlanChecker, session: Session) -> None:
        self._host, self._approvals = against.host, against.approvals
        self._control = against.control
        self._session = session
        self._limits = against.config
        self._faults: list[Fault] = []
        self._ids: dict[str, Node] = {}
        self._types: dict[str, ValueType] = {}
        """References to the results of steps."""
        self._count = 0
        self._reader = ConditionReader(against.allowance, session.principal.name)
        self._searches = 0
        self._gained: list[Scope] = []
        """Scopes of which earlier steps gain control."""
        self._checked: Checked | None = None

    def check(self, plan: Plan) -> Generator[None, None, Checked]:
        steps = yield from self._steps(plan)
        checked = self._checked = Checked(plan, [])
        checked.nodes = yield from self._level(steps, "", 1)
        if any(n.step.when or getattr(n.step, "until", None) for n in self._ids.values()):
            self._reader.check()
        yield from self._relate(checked.nodes, {})
        if not steps and not self._faults:
            raise InvalidValue("the plan has no steps", details={"pointer": "/steps"})
        if self._faults:
            raise refusal(self._faults)
        return checked

    def _steps(self, plan: Plan) -> Generator[None, None, list[Step]]:
        given = [n for n in ("steps", "symbolic", "lines") if getattr(plan, n) is not None]
        if len(given) != 1:
            raise InvalidValue(
                "a plan needs exactly one of `steps`, `symbolic` and `lines`",
                details={"given": given},
            )
        if plan.steps is not None:
            return list(plan.steps)
        most = self._limits.steps + 1  # one more than allowed, which is refused by its number
        if plan.lines is not None:
            steps, self._faults = from_lines(plan.lines, most)
            return steps
        naming = NameScope(self._host.registry, self._session)
        yield from naming.prepare()
        steps, self._faults = yield from from_symbolic(
            plan.symbolic or "", self._limits, naming, most
        )
        return steps

    # -- the tree, and each step by itself -----------------------------------------------------

    def _level(
        self, steps: list[Step] | tuple[Step, ...], place: str, depth: int
    ) -> Generator[None, None, list[Node]]:
        if depth > self._limits.depth:
            raise OutOfRange(f"the plan is nested deeper than {self._limits.depth} levels")
        nodes: list[Node] = []
        for number, step in enumerate(steps, 1):
            self._count += 1
            if self._count > self._limits.steps:
                raise OutOfRange(
                    f"the plan has more than {self._limits.steps} steps",
                    remedy="Split it into several plans.",
                    details={"limit": self._limits.steps},
                )
            node = Node(step.id or f"{place}{number}", step)
            if node.id in self._ids:
                self._fault(node, DuplicateRequest(f"two steps have the id '{node.id}'"))
            self._ids[node.id] = node
            if isinstance(step, Group):
                node.children = yield from self._level(step.steps, f"{node.id}.", depth + 1)
            node.fallback = yield from self._level(step.fallback, f"{node.id}.fallback.", depth + 1)
            yield from self._try(node, self._codes(step.retry))
            nodes.append(node)
        return nodes

    def _fault(self, node: Node, error: RcpError) -> None:
        error.path = error.path or node.path
        self._faults.append(Fault(node.id, error))

    def _try(self, node: Node, look: Work) -> Work:
        try:
            yield from look
        except RcpError as error:
            self._fault(node, error)
        yield

    def _codes(self, retry: Retry | None) -> Work:
        """Refuse unknown error codes in `retry`: they would never match.

        :raises InvalidValue: a code is unknown.
        """
        for code in retry.on if retry is not None else ():
            if code not in BY_CODE:
                near = nearest(code, BY_CODE) if self._may_search() else []
                raise InvalidValue(
                    f"`retry` has the unknown error code '{code[:64]}'",
                    remedy=f"Did you mean {', '.join(near)}?" if near else None,
                    details={"near": near, "pointer": "/retry/on"},
                )
        yield

    def _may_search(self) -> bool:
        """Return whether another search for similar names is allowed: it is expensive."""
        self._searches += 1
        return self._searches <= _SEARCHES

    # -- relations between steps -----------------------------------------------------------------

    def _relate(
        self, nodes: list[Node], known: dict[str, Node]
    ) -> Generator[None, None, dict[str, Node]]:
        """Check consecutive steps; return the steps that have ended after them."""
        for node in nodes:
            if node.step.after:
                error = BadRequest("`after` is allowed only in the steps of a `parallel`")
                self._fault(node, error)
            known = yield from self._inside(node, known)
        return known

    def _inside(self, node: Node, known: dict[str, Node]) -> Generator[None, None, dict[str, Node]]:
        step = node.step
        node.tenant, node.robot = self._session.tenant, step.robot
        if isinstance(step, Operate):
            yield from self._try(node, self._operation(node, step, known))
        for text, name in ((step.when, "when"), (getattr(step, "until", None), "until")):
            if text is not None:
                yield from self._try(node, self._condition(node, text, name))
        if isinstance(step, Parallel):
            within = yield from self._side_by_side(node, known)
        else:
            within = yield from self._relate(node.children, known)
        ended = yield from self._relate(node.fallback, within)
        return {**ended, node.id: node}

    def _side_by_side(
        self, node: Node, known: dict[str, Node]
    ) -> Generator[None, None, dict[str, Node]]:
        ends: dict[str, dict[str, Node]] = {}
        for child in node.children:
            before = dict(known)
            for id_ in dict.fromkeys(child.step.after):
                if id_ not in ends:
                    text = (
                        f"`after` refers to '{id_[:64]}', which is not an earlier step of "
                        "this `parallel`"
                    )
                    self._fault(child, BadRequest(text))
                before |= ends.get(id_, {})
                yield
            ends[child.id] = yield from self._inside(child, before)
        out = dict(known)
        for end in ends.values():
            out |= end
        return out

    def _references(
        self, node: Node, step: Operate, known: dict[str, Node]
    ) -> Generator[None, None, bool]:
        if step.value is None or _MARK not in dump(step.value, Encoding.JSON):
            return False
        found = yield from references(step.value)
        for wanted in dict.fromkeys(found):
            id_, *fields = wanted.split("/")
            if id_ not in known:
                there = id_ in self._ids
                why = "does not end before this step" if there else "is not in the plan"
                near = (
                    [] if there or not self._may_search() else nearest(id_, islice(known, _AT_ONCE))
                )
                advice = f"Did you mean {', '.join(near)}? " if near else ""
                raise InvalidValue(
                    f"the value refers to the result of step '{id_[:64]}', which {why}",
                    remedy=f"{advice}Refer to an earlier step by its `id`.",
                    details={"near": near} if near else None,
                )
            type_ = self._types.get(id_)
            if fields and type_ is not None and not type_.has_field(".".join(fields)):
                raise InvalidValue(f"the result of step '{id_}' has no '{'/'.join(fields)[:80]}'")
            yield
        node.refers = bool(found)
        return node.refers

    # -- operations ----------------------------------------------------------------------------

    def _operation(self, node: Node, step: Operate, known: dict[str, Node]) -> Work:
        refers = yield from self._references(node, step, known)
        if isinstance(step, Read) and "*" in step.path:
            yield from self._pattern(node, step)
            return
        if isinstance(step, Write) and step.path is None:
            yield from self._atomic(node, step, refers=refers)
            return
        entry = yield from self._entry(step)
        node.path = node.state.path = entry.path
        if step.robot is None and entry.tenant is not None:
            node.tenant, node.robot = entry.tenant, entry.robot
        assert self._checked is not None
        self._checked.touches[entry.path] = None
        self._types[node.id] = entry.output_type if isinstance(step, Execute) else entry.value_type
        if isinstance(step, Read):
            if self._host.is_personal(entry.path):
                self._checked.touches[EVERYTHING] = None  # it shows the sender only its own plans
            if not refers:
                self._host.check_read(step.value)
            return
        value, complete = (None, False) if refers else self._value(step, entry)
        self._admit(entry, value, complete=complete)
        if self._approvals.wanted(self._session, entry, value):
            self._checked.ask(node, entry.path)
            if isinstance(step, Execute):
                node.place = place_in(self._host, self._session, entry, step.value)
        if isinstance(step, Execute):
            gained = self._control.gains(self._session, entry, step.value)
            self._gained += [] if gained is None else [gained]
        yield

    def _atomic(self, node: Node, step: Write, *, refers: bool) -> Work:
        """Check a write of several paths as one."""
        if not is_map(step.value) or not step.value:
            raise InvalidValue(
                "a write without `path` maps paths to values", details={"pointer": "/value"}
            )
        assert self._checked is not None
        entries: list[Entry] = []
        for path, own in step.value.items():
            alone = msgspec.structs.replace(step, path=path, value=own)
            entry = yield from self._entry(alone)
            entries.append(entry)
            self._checked.touches[entry.path] = None
            value, complete = (None, False) if refers else self._value(alone, entry)
            self._admit(entry, value, complete=complete)
            if self._approvals.wanted(self._session, entry, value):
                self._checked.ask(node, entry.path)
            yield
        self._host.check_group(entries)
        if step.robot is None:
            node.tenant, node.robot = entries[0].tenant, entries[0].robot

    def _pattern(self, node: Node, step: Read) -> Work:
        pattern = Pattern(step.path, self._session.tenant)
        node.path = node.state.path = pattern.text
        self._host.check_read(step.value)
        permits = self._session.rights.permits
        found = iter(self._host.registry.match(pattern))
        assert self._checked is not None
        while some := list(islice(found, _STEP)):
            named = [e.path for e in some if permits(e, Operation.READ)]
            self._checked.touches |= dict.fromkeys(named)
            yield

    def _entry(self, step: Operate) -> Generator[None, None, Entry]:
        operation, path = _OPERATIONS[step.do], step.path or ""
        try:
            entry = self._host.resolve(self._session, path, operation)
        except UnknownPath as error:
            near = yield from self._near(error.path or path, operation)
            if near:
                error.remedy = f"Did you mean {', '.join(near)}? {error.remedy}"
                error.details = {"near": near}
            raise
        if entry.path in _NOT_HERE and not isinstance(step, Read):
            raise UnsupportedOperation(
                f"{entry.path} is not allowed in a plan",
                path=entry.path,
                remedy="Copy the steps of the other plan into this one."
                if entry.path == "/system/plans"
                else "Decide on approvals with a separate request.",
            )
        return entry

    def _near(self, path: str, operation: Operation) -> Generator[None, None, list[str]]:
        if not self._may_search():
            return []
        near = Nearest(path)
        tenants = self._session.rights.tenants
        permitted = self._session.rights.mask
        entries = islice(list(self._host.registry.entries.values()), _COMPARED)
        while some := list(islice(entries, _STEP)):
            for entry in some:
                if (
                    entry.operations & operation
                    and ("*" in tenants or entry.tenant in tenants)
                    and permitted(entry.path)
                ):
                    near.compare(entry.path)
            yield
        return near.found()

    def _value(self, step: Write | Execute, entry: Entry) -> tuple[Any, bool]:
        """Return the value of a step, and whether it is the one that the robot will get."""
        called = isinstance(step, Execute)
        if called and entry.resource.input is None and step.value in (None, {}):
            return None, True
        if called:
            try:
                goal = self._host.goal(self._session, entry, step.value)
            except PreconditionFailed:  # for want of a pose, which its step will need
                return None, False
            if goal is not None:  # by then, the robot may be elsewhere
                return goal, False
        type_ = entry.input_type if called else entry.value_type
        label = f"input of {entry.label}" if called else entry.label
        return self._decode(type_, step.value, label), True

    @staticmethod
    def _decode(type_: ValueType, value: Any, label: str) -> Any:
        return type_.decode(dump(value, Encoding.JSON), Encoding.JSON, label)

    def _admit(self, entry: Entry, value: Any, *, complete: bool) -> None:
        gained = any(scope.covers(entry.path) for scope in self._gained)
        self._host.foresee(self._session, entry, value, gained=gained, complete=complete)

    def _condition(self, node: Node, text: str, name: str) -> Work:
        """Compile a condition of a step, which may use only values that the sender may read."""
        found = self._reader.read(text, name)
        yield
        assert self._checked is not None
        paths = looked_at(self._host.conditions, self._session, node, found)
        self._checked.touches |= dict.fromkeys(paths)
        if name == "when":
            node.when = found
        else:
            node.until = found
        yield
