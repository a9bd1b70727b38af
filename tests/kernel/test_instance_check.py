"""Published Structs that are recognised as valid without being encoded and decoded."""

from __future__ import annotations

import enum
import itertools
import math
from typing import Annotated, Any, Literal

import msgspec
import pytest
from msgspec import Meta, Struct, field

from rcp_kernel import types
from rcp_kernel.errors import InvalidValue
from rcp_kernel.values import ValueType
from rcp_protocol.instance_check import compile_check


class Mode(enum.Enum):
    IDLE = "idle"
    MOVING = "moving"


class Bits(enum.IntFlag):
    ONE = 1
    FOUR = 4


class Inner(Struct):
    value: Annotated[float, Meta(ge=-1, lt=1)] = 0.0


class Outer(Struct):
    inner: Inner
    ratio: Annotated[float, Meta(gt=0, le=1)]
    reading: types.Real
    count: int
    small: Annotated[int, Meta(ge=0, le=255)]
    name: Annotated[str, Meta(min_length=1, max_length=3, pattern="^[a-z]+$")]
    flag: bool
    mode: Mode
    maybe: Annotated[float, Meta(le=5)] | None
    within: Inner | None


VALID: dict[str, list[Any]] = {
    "inner": [Inner(0.5)],
    "ratio": [1.0],
    "reading": [2.5],
    "count": [-7],
    "small": [255],
    "name": ["abc"],
    "flag": [True],
    "mode": [Mode.MOVING],
    "maybe": [None, -5.0],
    "within": [None, Inner(-1.0)],
}
ODD: dict[str, list[Any]] = {
    "inner": [Inner(1.0), Inner(math.nan), Inner(1), types.Point(1.0, 2.0), None, {"value": 0.0}],
    "ratio": [0.0, 1.5, math.nan, 1, "1.0", None],
    "reading": [math.nan, math.inf, -math.inf, 3, None],
    "count": [2**53, -(2**53), 2**70, 1.5, True, None],
    "small": [-1, 256, 2.0],
    "name": ["", "abcd", "AB", b"abc", None],
    "flag": [0, 1, None],
    "mode": ["idle", None, Bits.ONE],
    "maybe": [6.0, math.nan, "x"],
    "within": [Inner(-1.5), 0.5],
}


def values(chosen: dict[str, list[Any]]) -> list[Outer]:
    return [Outer(*found) for found in itertools.product(*chosen.values())]


def test_valid_values_are_recognised() -> None:
    check = compile_check(Outer)
    assert check is not None
    assert all(check(value) for value in values(VALID))


@pytest.mark.parametrize(
    ("name", "odd"), [(name, odd) for name, found in ODD.items() for odd in found]
)
def test_what_is_not_certainly_valid_is_not_recognised(name: str, odd: object) -> None:
    check = compile_check(Outer)
    assert check is not None
    assert not any(check(value) for value in values(VALID | {name: [odd]}))


@pytest.mark.parametrize("type_", [types.PoseStamped, types.Twist, types.Transform, types.Accel])
def test_common_types_are_covered(type_: type[Struct]) -> None:
    assert compile_check(type_) is not None


class Checked(Struct):
    value: float

    def __post_init__(self) -> None:
        if self.value == 3.0:
            raise ValueError(self.value)


class Flags(Struct):
    value: Bits


class Steps(Struct):
    value: Annotated[float, Meta(multiple_of=0.5)]


class Numbers(Struct):
    value: list[float]


class Either(Struct):
    value: int | str


class Word(Struct):
    value: Literal["a", "b"]


class Endless(Struct):
    value: Endless | None = None


class Holds(Struct):
    value: Checked


Keyword = msgspec.defstruct("Keyword", [("class", float)])
Many = msgspec.defstruct("Many", [(f"value{number}", float) for number in range(64)])


@pytest.mark.parametrize(
    "type_",
    [Checked, Flags, Steps, Numbers, Either, Word, Endless, Holds, Keyword, Many, float, dict],
)
def test_other_types_are_not_covered(type_: type) -> None:
    assert compile_check(type_) is None


def test_the_odd_values_that_are_valid_are_still_accepted() -> None:
    value = Outer(Inner(), 1, math.nan, 2**60, 0, "a", False, Mode.IDLE, None, None)
    checked, json = ValueType(Outer).check(value)
    assert checked is value
    assert json is not None
    assert b'"reading":"NaN"' in json


def test_an_invalid_value_is_still_refused() -> None:
    value = Outer(Inner(2.0), 1.0, 1.0, 1, 0, "a", False, Mode.IDLE, None, None)
    with pytest.raises(InvalidValue, match=r"inner\.value"):
        ValueType(Outer).check(value)


class Digits(Struct):
    value: Annotated[str, Meta(pattern=r"^\d+$")]


class Others(Struct):
    value: Annotated[str, Meta(pattern=r"^\D+$")]


@pytest.mark.parametrize(("type_", "valid"), [(Digits, True), (Others, False)])
def test_patterns_match_as_they_do_for_msgspec(type_: type[Struct], valid: bool) -> None:  # noqa: FBT001
    value = type_("\u0663")  # a digit, but not of ASCII
    if valid:
        assert ValueType(type_).check(value)[0] is value
    else:
        with pytest.raises(InvalidValue):
            ValueType(type_).check(value)


class Unset(Struct):
    value: float = field(default=0.0)


def test_a_field_that_is_not_set_is_an_error() -> None:
    value = Unset()
    del value.value
    with pytest.raises(AttributeError):
        ValueType(Unset).check(value)
