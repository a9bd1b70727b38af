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


def assigned(target: ast.expr, value: ast.expr) -> Iterator[tuple[str, ast.expr]]:
    """List the names and attributes that an assignment sets, each with its value."""
    match target, value:
        case ast.Tuple(targets), ast.Tuple(values) if len(targets) == len(values):
            for one, other in zip(targets, values, strict=True):
                yield from assigned(one, other)
        case ((ast.Attribute(_, name) | ast.Name(name)), _):
            yield name, value
        case _:
            pass


def zero_marks(source: str) -> set[str]:
    """Return what a module sets to a time, and to 0.0 elsewhere."""
    zero, times = set[str](), set[str]()
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Assign(targets, value):
                found = [pair for target in targets for pair in assigned(target, value)]
            case ast.AnnAssign(target, _, ast.expr() as value):
                found = [*assigned(target, value)]
            case _:
                continue
        for name, value in found:
            if isinstance(value, ast.Constant) and type(value.value) is float and not value.value:
                zero.add(name)
            elif is_time(value):
                times.add(name)
    return zero & times


def test_no_mark_begins_with_zero() -> None:
    found = [
        f"{path.relative_to(ROOT)}: {name}"
        for path in SOURCES
        for name in zero_marks(path.read_text())
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
    assert zero_marks(source) == {"last", "_seen", "_told", "_at"}
