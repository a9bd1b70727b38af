"""How many values a message holds is told the same in every encoding, in steps, before it is decoded."""

from __future__ import annotations

import time
from collections import deque
from typing import Any

import cbor2
import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rcp_kernel.errors import BadRequest, PayloadTooLarge
from rcp_kernel.values import ANY, Encoding
from rcp_protocol.structure import check_structure

MANY = 1024 * 1024
WRITERS: dict[Encoding, Any] = {
    Encoding.JSON: msgspec.json.encode,
    Encoding.MSGPACK: msgspec.msgpack.encode,
    Encoding.CBOR: cbor2.dumps,
}
INTEGERS = (
    st.integers(-(2**31), 2**31) | st.integers(10**16, 2**63) | st.integers(-(2**63), -(10**16))
)
SCALARS = st.none() | st.booleans() | INTEGERS | st.floats(-1e6, 1e6)
TEXTS = st.text(alphabet=st.sampled_from('ab\\"[]{},:é\n'), max_size=40)
VALUES: st.SearchStrategy[Any] = st.recursive(
    SCALARS | TEXTS,
    lambda inner: st.lists(inner, max_size=8) | st.dictionaries(TEXTS, inner, max_size=5),
    max_leaves=60,
)


def worth(value: Any) -> int:
    """Count as the contract does: a text 3, a list, map or long integer 9, all else 1."""
    if isinstance(value, int) and abs(value) >= 10**15:
        return 9
    if isinstance(value, str):
        return 3
    if isinstance(value, list):
        return 9 + sum(map(worth, value))
    if isinstance(value, dict):
        return 9 + sum(worth(key) + worth(item) for key, item in value.items())
    return 1


def passes(value: Any, encoding: Encoding, limit: int) -> bool:
    data = WRITERS[encoding](value)
    try:
        for _ in check_structure(data, encoding, limit):
            pass
    except PayloadTooLarge as refused:
        return refused.details != {"limit": limit}
    return True


@settings(deadline=None)
@given(VALUES, st.sampled_from(Encoding))
def test_a_message_is_refused_for_its_values_however_they_are_written(
    value: Any, encoding: Encoding
) -> None:
    times = 4 if encoding is Encoding.CBOR else 1
    count = worth(value) * times
    assert passes(value, encoding, 2 * count + 8)
    # In JSON an item is told by its comma alone: a map's entry, or the only item, counts for less.
    assert not passes(value, encoding, count // 2 - 2) or count < 10 * times


@pytest.mark.parametrize("encoding", Encoding)
def test_no_step_is_long_and_what_is_refused_is_refused_early(encoding: Encoding) -> None:
    data = WRITERS[encoding]([[]] * 3_000_000)
    work = check_structure(data, encoding, MANY)
    took: list[float] = []

    def step() -> None:
        began = time.thread_time()
        next(work)
        took.append(time.thread_time() - began)

    with pytest.raises(PayloadTooLarge):
        deque(iter(step, ...), maxlen=0)
    assert len(took) > 3
    assert max(took) < 0.05


@pytest.mark.parametrize("encoding", Encoding)
def test_an_image_of_any_length_is_one_value(encoding: Encoding) -> None:
    assert passes('QUJD,[{\\"' * 700_000, encoding, 65_536)


@pytest.mark.parametrize(
    "text", ['"' + "\\" * 65_535, "\\" * 200_001, '["' + "\\\\" * 65_536 + '",', "[" * 70_000, '"']
)
def test_what_is_malformed_passes_or_is_refused_and_nothing_else(text: str) -> None:
    try:
        for _ in check_structure(text.encode(), Encoding.JSON, 65_536):
            pass
    except PayloadTooLarge:
        assert text[0] == "["


@pytest.mark.parametrize("encoding", Encoding)
@pytest.mark.parametrize("kind", ["lists", "maps", "both", "behind texts"])
def test_sixty_four_levels_are_taken_and_one_more_is_not(encoding: Encoding, kind: str) -> None:
    def nested(levels: int) -> Any:
        value: Any = ['\\"]]}[{', "]", "[" * 70] if kind == "behind texts" else [1]
        for level in range(levels - 1):
            in_map = kind == "maps" or (kind == "both" and level % 2)
            value = {"}]": value} if in_map else [value]
        return value

    assert ANY.decode(WRITERS[encoding](nested(64)), encoding) == nested(64)
    with pytest.raises(BadRequest):
        ANY.decode(WRITERS[encoding](nested(65)), encoding)
