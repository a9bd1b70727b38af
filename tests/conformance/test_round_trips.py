"""Whatever a type can hold goes through every encoding and comes out the same."""

from __future__ import annotations

import json
import math
from contextlib import suppress
from typing import Annotated, Any

import cbor2
import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import Meta

from rcp_kernel.errors import BadRequest, InvalidValue, RcpError
from rcp_kernel.types import Int64, UInt64, nonfinite, quantity
from rcp_kernel.values import Encoding, dump, parse, value_type


class Everything(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    i64: Int64
    u64: UInt64
    small: quantity("1", int, ge=-128, le=127)  # pyright: ignore[reportInvalidTypeForm]
    free: nonfinite("m")  # pyright: ignore[reportInvalidTypeForm]
    finite: quantity("m")  # pyright: ignore[reportInvalidTypeForm]
    text: str
    data: bytes
    flag: bool
    maybe: Int64 | None
    floats: list[nonfinite("1")]  # pyright: ignore[reportInvalidTypeForm]
    pair: tuple[Int64, str]
    table: dict[str, UInt64]
    children: list[Everything] = []


i64 = st.integers(-(2**63), 2**63 - 1) | st.sampled_from(
    (0, 2**53, 2**53 - 1, -(2**53), 2**63 - 1, -(2**63))
)
u64 = st.integers(0, 2**64 - 1) | st.sampled_from((0, 2**53, 2**63, 2**64 - 1))
texts = st.text(st.characters(codec="utf-8"), max_size=20)
floats = st.floats(allow_nan=True, allow_infinity=True)


def everything(children: st.SearchStrategy[list[Everything]]) -> st.SearchStrategy[Everything]:
    return st.builds(
        Everything,
        i64=i64,
        u64=u64,
        small=st.integers(-128, 127),
        free=floats,
        finite=st.floats(allow_nan=False, allow_infinity=False),
        text=texts,
        data=st.binary(max_size=40),
        flag=st.booleans(),
        maybe=st.none() | i64,
        floats=st.lists(floats, max_size=4),
        pair=st.tuples(i64, texts),
        table=st.dictionaries(texts, u64, max_size=3),
        children=children,
    )


deep = st.recursive(
    everything(st.just([])), lambda inner: everything(st.lists(inner, max_size=2)), max_leaves=4
)


@given(deep)
def test_a_value_survives_every_encoding(value: Everything) -> None:
    type_ = value_type(Everything)
    for encoding in Encoding:
        data = type_.encode(value, encoding)
        again = type_.decode(data, encoding)
        assert repr(again) == repr(value)
        assert type_.encode(again, encoding) == data


@given(deep)
def test_json_holds_nothing_that_another_reader_would_lose(value: Everything) -> None:
    found = json.loads(
        value_type(Everything).encode(value, Encoding.JSON), parse_constant=pytest.fail
    )
    for number in _numbers(found):
        assert isinstance(number, float) or abs(number) <= 2**53 - 1


def _numbers(node: Any) -> list[Any]:
    if isinstance(node, dict):
        return [n for item in node.values() for n in _numbers(item)]
    if isinstance(node, list):
        return [n for item in node for n in _numbers(item)]
    return [node] if isinstance(node, (int, float)) and not isinstance(node, bool) else []


plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | texts | st.floats(allow_nan=False),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts, inner, max_size=4),
    max_leaves=20,
)


@given(plain)
def test_plain_data_survives_every_encoding(value: Any) -> None:
    for encoding in Encoding:
        again = parse(dump(value, encoding), encoding)
        assert repr(again) == repr(_spelled(value) if encoding is Encoding.JSON else value)


def _spelled(value: Any) -> Any:
    if isinstance(value, float) and math.isinf(value):
        return "Infinity" if value > 0 else "-Infinity"
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > 2**53 - 1:
        return str(value)
    if isinstance(value, dict):
        return {key: _spelled(item) for key, item in value.items()}
    return [_spelled(item) for item in value] if isinstance(value, list) else value


@given(plain | st.binary(max_size=30), st.sampled_from(list(Encoding)))
def test_what_does_not_fit_is_refused_and_never_crashes(value: Any, encoding: Encoding) -> None:
    type_ = value_type(Everything)
    data = value if isinstance(value, bytes) else dump(value, encoding)
    for wanted in (type_, value_type(Annotated[int, Meta(ge=3)]), value_type(list[Everything])):
        with suppress(BadRequest, InvalidValue):
            wanted.decode(data, encoding)


@given(st.integers() | st.floats() | texts)
def test_a_bound_holds_however_the_number_is_written(value: Any) -> None:
    type_ = value_type(quantity("1", int, ge=-5, le=2**60))
    for data, encoding in (
        (json.dumps(value).encode(), Encoding.JSON),
        (cbor2.dumps(value), Encoding.CBOR),
    ):
        try:
            got = type_.decode(data, encoding)
        except RcpError:
            continue
        assert -5 <= got <= 2**60
