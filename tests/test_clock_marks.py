"""No mark of when something last happened begins with 0: that is just now on a machine that has booted.

The monotonic clock counts from there, and a robot's gateway starts a few seconds later: what was
never heard would count as heard, and a first message as one too many. Marks begin with -inf or None.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
SOURCES = sorted(
    path
    for pattern in ("rcp_*", "rcpd", "backends/*", "plugins/*", "transports/*", "clients/python/*")
    for path in ROOT.glob(f"{pattern}/**/*.py")
    if not {"sim", "rcp_mavlink_sim"} & set(path.parts)  # their clocks begin with them
)
CLOCKS = {"monotonic", "_monotonic", "perf_counter", "_clock", "_now"}
MOMENTS = {"now", "moment"}
NO_MARKS = {
    ("excitation.py", "told"),  # since it began
    ("socket_client.py", "_began"),  # 0 while nothing is measured: asked for each message
}


def is_time(value: ast.expr) -> bool:
    """Return whether an expression is the present time of a monotonic clock, as far as names tell."""
    if isinstance(value, ast.Name):
        return value.id in MOMENTS
    if not isinstance(value, ast.Call):
        return False
    match value.func:
        case ast.Attribute(owner, "time"):
            return ast.unparse(owner) != "time"  # of a loop
        case ast.Attribute(_, name) | ast.Name(name):
            return name in CLOCKS
        case _:
            return False


def statements(tree: ast.AST) -> Iterator[tuple[ast.expr, ast.expr]]:
    """List what is set in a module, each target with its value."""
    for node in ast.walk(tree):
        match node:
            case ast.Assign(targets, value):
                for target in targets:
                    yield from assigned(target, value)
            case ast.AnnAssign(target, _, ast.expr() as value):
                yield from assigned(target, value)
            case _:
                pass


def assigned(target: ast.expr, value: ast.expr) -> Iterator[tuple[ast.expr, ast.expr]]:
    """List the targets of an assignment, each with its value."""
    match target, value:
        case ast.Tuple(targets), ast.Tuple(values) if len(targets) == len(values):
            for one, other in zip(targets, values, strict=True):
                yield from assigned(one, other)
        case _:
            yield target, value


def name_of(target: ast.expr) -> str | None:
    """Return the name of a variable or of an attribute, whosever it is."""
    match target:
        case ast.Attribute(_, name) | ast.Name(name):
            return name
        case _:
            return None


def is_zero(value: ast.expr) -> bool:
    return isinstance(value, ast.Constant) and type(value.value) is float and not value.value


def zero_marks(*sources: str) -> list[set[str]]:
    """Return what begins with 0.0 in each module, or is looked up with that, and is a time.

    A time is set to it in the same module, or in another one to an attribute of that name of an
    object that is not its own, or to an item of a table of that name.
    """
    trees = [ast.parse(source) for source in sources]
    pairs = [[*statements(tree)] for tree in trees]
    everywhere, tables = set[str | None](), set[str | None]()
    for target, value in (pair for of_one in pairs for pair in of_one):
        match target:
            case ast.Attribute(ast.Name("self"), _):
                pass
            case ast.Attribute(_, name) if is_time(value):
                everywhere.add(name)
            case ast.Subscript(table, _) if is_time(value):
                tables.add(name_of(table))
            case _:
                pass
    found = list[set[str]]()
    for tree, of_one in zip(trees, pairs, strict=True):
        zero = {name_of(target) for target, value in of_one if is_zero(value)}
        times = {name_of(target) for target, value in of_one if is_time(value)}
        aliases = {name_of(target) for target, value in of_one if name_of(value) in tables}
        marks = zero & (times | everywhere)
        marks |= {name for name in defaulted(tree) if name in tables | aliases}
        found.append({name for name in marks if name is not None})
    return found


def defaulted(tree: ast.AST) -> Iterator[str | None]:
    """List the tables from which something is looked up with 0.0 as the default."""
    for node in ast.walk(tree):
        match node:
            case ast.Call(ast.Attribute(table, "get" | "pop" | "setdefault"), [_, default]):
                if is_zero(default):
                    yield name_of(table)
            case _:
                pass


def test_no_mark_begins_with_zero() -> None:
    marks = zero_marks(*(path.read_text() for path in SOURCES))
    found = [
        f"{path.relative_to(ROOT)}: {name}"
        for path, names in zip(SOURCES, marks, strict=True)
        for name in names
        if (path.name, name) not in NO_MARKS
    ]
    assert not found, f'let them begin with float("-inf"), or with None: {found}'


def test_marks_are_recognised() -> None:
    source = """
class Link:
    last: float = 0.0
    def __init__(self):
        self._seen = self._told = 0.0
        self._count, self._at = 0, 0.0
        self._due = 0.0
    def take(self, now):
        self._seen, self._at = now, loop.time()
        self._told = self.last = time.monotonic()
        self._due = now + 1.0
"""
    assert zero_marks(source) == [{"last", "_seen", "_told", "_at"}]


def test_marks_that_another_module_sets_are_recognised() -> None:
    fields = """
class State:
    beat: float = 0.0
    rest: float = 0.0
    def __init__(self):
        self.heard, self.level = 0.0, 0.0
"""
    setter = """
def take(state, now):
    state.beat = state.heard = now
    state.rest = now + 1.0
"""
    assert zero_marks(fields) == [set()]
    assert zero_marks(fields, setter) == [{"beat", "heard"}, set()]


def test_defaults_of_tables_are_recognised() -> None:
    table = """
class Vehicle:
    def take(self, name, now):
        self.received_at[name] = now
        self.later[name] = now + 1.0
"""
    reader = """
def fresh(vehicle, now):
    received = vehicle.received_at
    return now - received.get("POSE", 0.0) < 1.0 and now > vehicle.later.get("POSE", 0.0)
"""
    assert zero_marks(table, reader) == [set(), {"received"}]
    assert zero_marks(table, reader.replace('"POSE", 0.0', '"POSE"')) == [set(), set()]
