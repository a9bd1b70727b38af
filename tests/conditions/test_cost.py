"""The cost of conditions: what is too dear is refused before anything evaluates it."""

from __future__ import annotations

import time
from typing import Any

import cel
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rcp_conditions import Condition, ConditionTooCostly, condition
from rcp_conditions.cost import ASSUMED, BUDGET, cost, size_of
from rcp_conditions.expression import DEPTH, LENGTH, TERMS, ExpressionError, parse, write
from rcp_kernel.errors import ConfigError

LIST = "sensor.scan.ranges"
SOON = 0.05  # s of the processor that any refusal may take
FEW = 0.05  # s of the processor that any evaluation may take; it takes 4 ms


def nested(levels: int, macro: str = "all", over: str = LIST) -> str:
    return f"{over}.{macro}(x, " * levels + "true" + ")" * levels


@pytest.mark.parametrize(
    "text",
    [
        nested(36, over="sensor.l.v")[:2000],
        nested(15),
        nested(3),
        f"{LIST}.map(x, {LIST}) == {LIST}",
        f"{LIST}.map(x, {LIST}).map(y, y).size() == 1",
        f"{LIST}.filter(x, {LIST}.filter(y, x == y) == {LIST}) == {LIST}",
        "[" + "1," * TERMS + "1].all(x, x > 0)",
        "(" * 500 + "true" + ")" * 500,
        "[" * 500 + "]" * 500 + " == []",
        "!" * 500 + "true",
        "-" * 500 + "1 == 1",
        "true ? 1 : " * 100 + "1 == 1",
        "1+" * 900 + "1 == 1",
        f"sensor.a{'.a' * 500} == 1",
        f"sensor.a{'[0]' * 500} == 1",
        "'" + "a" * LENGTH + "' == 'a'",
        r"mode.matches(r'\w{100}')",
        r"mode.matches('\\pL{200}')",
        "mode.matches('(((a{100}){100}){100}){100}')",
        "mode.matches('a{99999999999999999999}')",
        "mode.matches(mode)",
        "['a', 'b'].exists(p, mode.matches(p))",
        f"{LIST}.all(x, mode.matches(r'\\w'))",
    ],
)
def test_what_is_too_dear_is_refused_at_once_with_the_reason(text: str) -> None:
    began = time.thread_time()
    with pytest.raises(
        ConditionTooCostly,
        match=r"too costly: (it|its estimated cost|the "
        r"pattern) ",
    ) as said:
        Condition(text)
    assert time.thread_time() - began < SOON
    assert len(str(said.value)) < 1000
    assert "fewer comprehensions" in said.value.remedy


@pytest.mark.parametrize(
    "text",
    [
        f"{LIST}.all(x, x > 0.3)",
        f"{LIST}.all(x, {LIST}.all(y, x - y < 1.0))",
        "[1, 2].all(x, [3, 4].all(y, [5, 6].all(z, [7, 8].all(w, x + y < z + w))))",
        "[].all(x, [1, 2].all(y, x > y))",
        r"mode.matches(r'^\d{4}-\d{2}$') || mode.matches('[a-z]+_[0-9]{1,3}')",
        "sensor.joints.exists(j, has(j.position) && j.position > 1.0)",
    ],
)
def test_what_robots_are_asked_for_is_within_the_budget(text: str) -> None:
    Condition(text)


@pytest.mark.parametrize("length", [10, ASSUMED, 300, 1000, 3000, 10_000, 1_000_000])
@pytest.mark.parametrize(
    "text",
    [
        f"{LIST}.all(x, x >= 0.0)",
        f"{LIST}.all(x, {LIST}.all(y, x + y >= 0.0))",
        f"{LIST}.map(x, x + 1.0).filter(x, x > 0.0) == {LIST}",
        f"{LIST}.exists_one(x, x == 1.0) && {LIST} + {LIST} != {LIST}",
        f"{LIST}.map(x, [x, x]).all(y, y.all(z, z >= 0.0))",
    ],
)
def test_no_evaluation_takes_long_whatever_the_robot_says(text: str, length: int) -> None:
    found = Condition(text)
    values: dict[Any, Any] = {found.refs[0]: [float(n) for n in range(length)]}
    began = time.thread_time()
    decided = found.evaluate(values)
    assert time.thread_time() - began < FEW
    assert (decided is None) == (found.excess(values) is not None)
    if length <= ASSUMED // 2:
        assert decided is not None


def test_values_that_are_deep_or_of_many_parts_are_measured_within_a_bound() -> None:
    deep: Any = 1
    for _ in range(900):
        deep = [deep]
    for value in (deep, [[[]] * 10_000] * 10_000, {str(n): [n] for n in range(50_000)}):
        began = time.thread_time()
        assert size_of(value) is None
        assert time.thread_time() - began < FEW
    assert size_of([[1.0] * 10] * 5) is not None


@pytest.mark.parametrize(
    "text",
    [
        "1 + 2 * 3 - (4 - 5) == 12",
        "(true || false) && !false ? 1 == 1 : 2 == 3",
        "(true ? false : true) ? 1 == 2 : (1 < 2) == true",
        "-(-1) == 1 && - -1 == 1 && !!true && 5 % 3 == 2 && 7 / 2 * 2 == 6",
        "'it''s' == 'it' || r'a\\d' == 'a\\\\d' && '''a'b''' == \"a'b\"",
        "{'a': [1, 2,], \"b\": [3],}['a'][1] == 2 && size({1: 2}) == 1",
        "[1, 2, 3].map(x, x > 1, x * 2) == [4, 6] && [1].exists_one(x, x == 1)",
        "0x1F == 31 && 1.5e3 == 1500.0 && .5 < 1.0 && 1u == 1u // a remark",
        "'abc'.contains('b') && size('abc') == 3 && 2 in [1, 2] && !(3 in [1, 2])",
        "1 - 2 - 3 == -4 && 8 / 2 / 2 == 2 && (1 == 1) == (2 == 2)",
        "type(1) == type(2) && null == null && b'a' == b'a'",
    ],
)
def test_what_is_written_for_the_engine_means_what_was_read(text: str) -> None:
    try:
        tree, _ = parse(text)
    except ExpressionError:
        with pytest.raises(ValueError, match="parse"):
            cel.compile(text)
        return
    assert parse(write(tree))[0] == tree
    assert cel.evaluate(write(tree)) == cel.evaluate(text)


_parts = st.sampled_from(
    [
        "sensor.a.b",
        "mode",
        "1",
        "2.0",
        "'a'",
        "true",
        "x",
        "y",
        "(",
        ")",
        "[",
        "]",
        "{",
        "}",
        ",",
        ":",
        "?",
        "&&",
        "||",
        "!",
        "-",
        "+",
        "*",
        "in",
        "==",
        "<",
        ".all(x,",
        ".map(y,",
        ".filter(x,",
        ".exists(y,",
        ".size()",
        ".matches('a')",
        "size(",
        "has(x.a)",
        "1u",
    ]
)


@settings(max_examples=500, deadline=None)
@given(st.lists(_parts, max_size=20).map(" ".join))
def test_whatever_is_admitted_stays_within_the_budget_and_means_the_same(text: str) -> None:
    try:
        tree, terms = parse(text)
    except ExpressionError:
        return
    assert terms <= TERMS
    assert parse(write(tree))[0] == tree
    try:
        found = condition(text)
    except ConfigError:
        return
    values = {ref: [1.0] * ASSUMED for ref in found.refs}
    began = time.thread_time()
    found.evaluate(values)
    assert time.thread_time() - began < FEW
    assert cost(tree, {}) <= BUDGET


def test_the_depth_of_what_is_admitted_is_bounded() -> None:
    assert Condition("(" * (DEPTH - 1) + "true" + ")" * (DEPTH - 1)).evaluate({}) is True
    assert Condition(" || ".join(["mode == 'a'"] * (TERMS // 5))).evaluate({}) is None
