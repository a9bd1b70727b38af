"""Odd numbers and odd keys in places where a type allows them."""

from __future__ import annotations

from typing import NamedTuple

import pytest

from rcp_kernel.errors import InvalidValue
from rcp_kernel.values import Encoding, ValueType


class Pair(NamedTuple):
    """A tuple with names."""

    x: float
    y: float


def test_a_named_tuple_hides_no_number_that_json_cannot_carry() -> None:
    with pytest.raises(InvalidValue, match="not a finite number"):
        ValueType(Pair).check(Pair(1.0, float("nan")))


@pytest.mark.parametrize("type_", [int | str, float | str])
def test_a_text_stays_one_where_texts_are_legal(type_: object) -> None:
    kind = ValueType(type_)
    for text in ("123", "NaN"):
        assert kind.convert(text) == text
        assert kind.decode(f'"{text}"'.encode(), Encoding.JSON) == text


def test_a_pointer_escapes_what_has_a_meaning_in_it() -> None:
    with pytest.raises(InvalidValue, match=r"'a/b~c' of value .*: nan") as caught:
        ValueType(dict[str, float]).convert({"a/b~c": float("nan")})
    assert caught.value.details == {"pointer": "/a~1b~0c"}
