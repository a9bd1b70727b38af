"""Values: what goes in one encoding comes out of it the same, and what does not fit is told where."""

from __future__ import annotations

import json
import math
import re
from typing import Annotated, Any

import jsonschema
import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import Meta

from rcp_kernel import types
from rcp_kernel.errors import BadRequest, InvalidValue, OutOfRange
from rcp_kernel.values import ANY, Encoding, value_type


class Everything(msgspec.Struct, frozen=True):
    """One field of each kind that a robot's message may have."""

    real: types.Real
    whole: types.Int64
    large: types.UInt64
    small: Annotated[int, Meta(ge=-128, le=127)]
    flag: bool
    text: str
    data: bytes
    reals: list[types.Real]
    table: dict[str, types.Int64]
    maybe: types.Real | None
    nested: types.Pose | None


everything = st.builds(
    Everything,
    real=st.floats(),
    whole=st.integers(-(2**63), 2**63 - 1),
    large=st.integers(0, 2**64 - 1),
    small=st.integers(-128, 127),
    flag=st.booleans(),
    text=st.text(st.characters(exclude_categories=["Cs"])),
    data=st.binary(),
    reals=st.lists(st.floats(), max_size=5),
    table=st.dictionaries(
        st.text(st.characters(exclude_categories=["Cs"])), st.integers(-(2**63), 2**63 - 1), max_size=3
    ),
    maybe=st.none() | st.floats(),
    nested=st.none() | st.just(types.Pose(types.Point(1.0, 2.0, 3.0))),
)  # fmt: skip


def same(one: Any, other: Any) -> bool:
    """Compare with one NaN equal to another, whatever their payload."""
    return repr(one) == repr(other)


@given(everything, st.sampled_from(list(Encoding)))
def test_a_value_survives_every_encoding(value: Everything, encoding: Encoding) -> None:
    type_ = value_type(Everything)
    assert same(type_.decode(type_.encode(value, encoding), encoding), value)


@given(everything)
def test_json_never_carries_a_number_that_a_browser_would_change(value: Everything) -> None:
    text = value_type(Everything).encode(value, Encoding.JSON)

    def refuse(word: str) -> float:
        raise AssertionError(f"bare {word}")

    def whole(digits: str) -> int:
        assert abs(int(digits)) <= 2**53 - 1
        return int(digits)

    json.loads(text, parse_constant=refuse, parse_int=whole)


@given(everything)
def test_what_goes_out_is_valid_against_the_published_schema(value: Everything) -> None:
    type_ = value_type(Everything)
    jsonschema.Draft202012Validator(type_.schema).validate(
        json.loads(type_.encode(value, Encoding.JSON))
    )


@pytest.mark.parametrize("encoding", list(Encoding))
def test_a_command_refuses_a_number_that_is_not_finite(encoding: Encoding) -> None:
    type_ = value_type(types.Twist)
    bad = {"linear": {"x": math.nan}}
    with pytest.raises(InvalidValue) as caught:
        type_.decode(ANY.encode(bad, encoding), encoding, "actuator 'cmd_vel'")
    assert caught.value.details == {"pointer": "/linear/x"}


def test_out_of_range_says_which_value_and_bound() -> None:
    type_ = value_type(types.quantity("m/s", ge=0, le=2.5))
    with pytest.raises(OutOfRange) as caught:
        type_.decode(b"9.0", Encoding.JSON, "parameter 'speed_limit'")
    assert (
        caught.value.message
        == "Failed to apply configuration: parameter 'speed_limit' exceeds allowed range: 9.0 > 2.5 m/s"
    )


def test_a_misfit_deep_inside_is_told_by_its_pointer() -> None:
    class Path(msgspec.Struct):
        points: list[types.Point]

    with pytest.raises(InvalidValue) as caught:
        value_type(Path).decode(b'{"points":[{"x":1,"y":2},{"x":1,"y":"two"}]}', Encoding.JSON)
    assert caught.value.details == {"pointer": "/points/1/y"}


class Inner(msgspec.Struct, frozen=True):
    x: float


class Outer(msgspec.Struct, frozen=True):
    inner: Inner


@pytest.mark.parametrize(
    ("data", "missing"), [(b"{}", "/inner"), (b'{"inner": {}}', "/inner/x"), (b"null", "")]
)
def test_what_is_not_there_at_all_is_pointed_to(data: bytes, missing: str) -> None:
    with pytest.raises(InvalidValue) as caught:
        value_type(Outer).decode(data, Encoding.JSON)
    assert caught.value.details is not None
    assert caught.value.details["missing"] == missing


@pytest.mark.parametrize("text", ["18446744073709551616", '"18446744073709551616"', "-1", '"-1"'])
def test_an_integer_past_its_type_is_refused_in_both_spellings(text: str) -> None:
    with pytest.raises(InvalidValue):
        value_type(types.UInt64).decode(text.encode(), Encoding.JSON)


def test_text_is_not_taken_for_a_number() -> None:
    with pytest.raises(InvalidValue):
        value_type(float).decode(b'"1.5"', Encoding.JSON)


@pytest.mark.parametrize(
    ("data", "encoding"),
    [
        (b"{", Encoding.JSON),
        (b"\xff\xfe", Encoding.JSON),
        (b"NaN", Encoding.JSON),
        (b"[" * 100_000, Encoding.JSON),
        (b"\xc1", Encoding.MSGPACK),
        (b"\x91" * 100_000, Encoding.MSGPACK),
        (b"\xff", Encoding.CBOR),
        (b"\x81" * 100_000, Encoding.CBOR),
        (b"\xa1\x01\x02", Encoding.CBOR),
    ],
)
def test_what_is_not_of_the_encoding_is_a_bad_request(data: bytes, encoding: Encoding) -> None:
    with pytest.raises(BadRequest):
        value_type(types.Pose).decode(data, encoding)


@pytest.mark.parametrize(
    "type_", [int, types.Int64, types.UInt64, Annotated[int, Meta(ge=0, le=99)]]
)
@pytest.mark.parametrize("text", ["54.0", "5.4e1", "540e-1"])
def test_an_integer_may_be_written_as_json_schema_allows(type_: Any, text: str) -> None:
    type_ = value_type(type_)
    jsonschema.validate(json.loads(text), type_.schema)
    for data in (msgspec.json.encode(54), text.encode()):
        value = type_.decode(data, Encoding.JSON)
        assert (value, type(value)) == (54, int)
    value = type_.decode(msgspec.msgpack.encode(54.0), Encoding.MSGPACK)
    assert (value, type(value)) == (54, int)
    with pytest.raises(InvalidValue):
        type_.decode(b"54.5", Encoding.JSON)
    with pytest.raises(OutOfRange):
        type_.decode(b"1e300", Encoding.JSON)


def test_integers_inside_a_value_may_be_written_so_too() -> None:
    small = Annotated[int, Meta(ge=0, le=255)]
    for type_ in (list[small], list[int], tuple[small, small, small] | None):
        assert list(value_type(type_).decode(b"[1, 2.0, 3]", Encoding.JSON)) == [1, 2, 3]
        with pytest.raises(InvalidValue) as refused:
            value_type(type_).decode(b"[1, 2.5, 3]", Encoding.JSON)
        assert refused.value.details == {"pointer": "/1"}
    assert value_type(Any).decode(b"2.0", Encoding.JSON) == 2.0
    assert value_type(int | str).decode(b'"2.0"', Encoding.JSON) == "2.0"


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_number_that_may_be_whole_is_finite_too(value: float) -> None:
    with pytest.raises(InvalidValue):
        value_type(int | float).decode(msgspec.msgpack.encode(value), Encoding.MSGPACK)


@given(st.text("QUJD=-_+/ \n", max_size=9))
def test_the_schema_of_bytes_tells_which_texts_they_are(text: str) -> None:
    type_ = value_type(dict[str, bytes])
    document = {"data": text}
    published = type_.schema["additionalProperties"]
    # As in ECMA-262, where `$` is the end and not the line's.
    fits = re.search(published["pattern"].replace("$", r"\Z"), text) is not None
    assert published["contentEncoding"] == "base64"
    try:
        type_.decode(msgspec.json.encode(document), Encoding.JSON)
    except InvalidValue:
        assert not fits
    else:
        assert fits


def test_a_published_value_that_does_not_fit_is_found() -> None:
    type_ = value_type(types.PoseStamped)
    with pytest.raises(InvalidValue):
        type_.check(types.PoseStamped(types.Point(math.nan, 0.0)))
    with pytest.raises(InvalidValue):
        type_.check(types.PoseStamped("here"))  # pyright: ignore[reportArgumentType]
    with pytest.raises(InvalidValue):
        type_.check({"position": {"x": 1.0}})


def test_a_schema_has_a_stable_id_that_changes_with_it() -> None:
    one = value_type(types.quantity("m/s", ge=0, le=2.5))
    again = value_type(types.quantity("m/s", ge=0, le=2.5))
    other = value_type(types.quantity("m/s", ge=0, le=3.0))
    assert one.schema_id == again.schema_id != other.schema_id
    assert one.schema["unit"] == "m/s"


class Picture(msgspec.Struct, frozen=True):
    width: int
    data: bytes
    thumb: Annotated[bytes, Meta(max_length=1_000_000)] = b""


@given(st.integers(0, 9000), st.binary(min_size=1, max_size=7))
def test_long_bytes_are_written_as_short_ones_are(size: int, pattern: bytes) -> None:
    data = (pattern * size)[:size]
    picture = Picture(3, data, data[:100])
    type_ = value_type(Picture)
    assert type_.encode(picture, Encoding.JSON) == msgspec.json.encode(picture)
    assert type_.decode(type_.encode(picture, Encoding.JSON), Encoding.JSON) == picture
    assert picture.data == data
    assert value_type(bytes).encode(data, Encoding.JSON) == msgspec.json.encode(data)


def test_many_readings_are_spelled_one_by_one() -> None:
    type_ = value_type(list[types.Real])
    readings = [1.5, math.inf, -math.inf, math.nan, 2]
    data = type_.encode(readings, Encoding.JSON)
    assert json.loads(data) == [1.5, "Infinity", "-Infinity", "NaN", 2]


@pytest.mark.parametrize(
    ("raw", "encoding"),
    [
        (b'"\x95"', Encoding.JSON),
        (b'{"\x95": 1}', Encoding.JSON),
        (b"\xa1\x95", Encoding.MSGPACK),
        (b"\x61\x95", Encoding.CBOR),
    ],
)
@pytest.mark.parametrize("type_", [str, dict[str, int], Any, str | None])
def test_text_that_is_not_utf_8_is_malformed(raw: bytes, encoding: Encoding, type_: Any) -> None:
    with pytest.raises(BadRequest):
        value_type(type_).decode(raw, encoding)
