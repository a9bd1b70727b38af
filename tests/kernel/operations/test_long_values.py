"""Long bodies and results are decoded and written in steps, and written once for all."""

from __future__ import annotations

import json
from collections.abc import Callable, Generator
from contextlib import AbstractAsyncContextManager, contextmanager
from pathlib import Path
from typing import Any, TypeVar

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kernel.world import Robot, World, kept_in, world_of
from rcp_kernel.errors import RcpError
from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress
from rcp_kernel.values import ANY, Encoding, ValueType, dump, is_long, value_type
from rcp_protocol.pieces import pieces

pytestmark = pytest.mark.anyio
ECHO, PARAM = "/tenant/alpha/service/any", "/tenant/alpha/param/any"
Result = TypeVar("Result")
WIDE = 2**60  # JSON carries it as a text
LONG = [
    pytest.param([WIDE] * 20_000, id="long integers"),
    pytest.param([1.5, WIDE] * 20_000, id="of both kinds"),
    pytest.param([[None]] * 20_000, id="lists in a list"),
    pytest.param({"a": {"b": [1.5, WIDE] * 20_000}}, id="in a map in a map"),
    pytest.param({str(n): n for n in range(20_000)}, id="a wide map"),
    pytest.param([[0.5] * 9000, "x" * 400_000, {"k": [WIDE] * 9000}], id="few that are long"),
]


class Taking(Robot):
    """A robot that takes everything, and gives it back."""

    def declare(self) -> None:
        self.add(
            Resource(name="service/any", description="Echo.", input=Any, output=Any),
            Resource(name="param/any", description="Anything.", value=Any),
        )

    async def execute(self, name: str, value: Any, progress: Progress) -> Any:
        return value


def as_json(value: Any) -> Any:
    return json.loads(dump(value, Encoding.JSON))


def through(steps: Generator[None, None, Result]) -> tuple[Result, int]:
    """Return the result, and how many steps it took."""
    count = 1
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value, count
        count += 1


@pytest.mark.parametrize("value", LONG)
def test_no_step_writes_more_than_a_few_thousand_values(value: Any) -> None:
    longest = list[bool]()

    def write(part: Any) -> bytes:
        longest.append(is_long(part))
        return dump(part, Encoding.JSON)

    data, steps = through(pieces(value, write))
    assert json.loads(data) == as_json(value)
    assert steps >= 4
    assert not any(longest)


plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
)


def count_of(value: Any) -> int:
    """Count the values in one."""
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return 1 + sum(map(count_of, inner))


@given(plain, st.integers(1, 8000))
def test_pieces_are_the_whole(part: Any, times: int) -> None:
    times = min(times, 1 + 24_000 // count_of(part))  # of some six steps
    for value in (part, [part] * times, {"a": [part] * times, 'b\\"': part}):
        data, _ = through(pieces(value, lambda v: dump(v, Encoding.JSON)))
        assert json.loads(data) == as_json(value)


@pytest.mark.parametrize("type_", [Any, list[int], float])
@pytest.mark.parametrize("encoding", [Encoding.JSON, Encoding.MSGPACK, Encoding.CBOR])
@pytest.mark.parametrize(
    "value", [[1, 2, WIDE], [2**64 - 1], "NaN", [[[]] * 9], {"a": 0.5}, [float("inf")], None, 1]
)
def test_steps_lead_where_decoding_at_once_does(type_: Any, encoding: Encoding, value: Any) -> None:
    made, raw = value_type(type_), ANY.encode(value, encoding)

    def outcome(decode: Callable[[], Any]) -> Any:
        try:
            return decode()
        except RcpError as error:
            return type(error), error.message, error.details

    at_once = outcome(lambda: made.decode(raw, encoding))
    assert outcome(lambda: through(made.decode_in_steps(raw, encoding))[0]) == at_once


@contextmanager
def written(monkeypatch: pytest.MonkeyPatch) -> Generator[list[Any]]:
    """Note what long values are written at once."""
    long, encode = list[Any](), ValueType.encode

    def noting(self: ValueType, value: Any, encoding: Encoding) -> bytes:
        if encoding is Encoding.JSON and is_long(value):
            long.append(value)
        return encode(self, value, encoding)

    with monkeypatch.context() as patched:
        patched.setattr(ValueType, "encode", noting)
        yield long


def stored(folder: Path) -> AbstractAsyncContextManager[World]:
    return world_of(kept_in(folder / "store.db"), Taking)


@pytest.mark.parametrize("value", LONG)
@pytest.mark.parametrize("type_", ["execute", "write"])
async def test_reply_record_and_history_share_what_was_written_in_steps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, type_: str, value: Any
) -> None:
    path = ECHO if type_ == "execute" else PARAM
    async with stored(tmp_path) as world:
        client = world.client("admin-admin-admin")
        with written(monkeypatch) as long:
            reply = await client.ask(type=type_, path=path, body=value)
        assert (reply["status"], reply["body"]) == ("completed", as_json(value))
        assert not long
        if type_ == "execute":
            listed = await client.ask(type="read", path="/system/commands")
            found = next(c for c in listed["body"] if c["command"] == reply["command"])
            assert found["input"] == found["body"] == as_json(value)
    if type_ == "execute":
        async with stored(tmp_path) as world:  # and after a restart
            client = world.client("admin-admin-admin")
            listed = await client.ask(type="read", path="/system/commands")
            found = next(c for c in listed["body"] if c["command"] == reply["command"])
            assert found["input"] == found["body"] == as_json(value)
