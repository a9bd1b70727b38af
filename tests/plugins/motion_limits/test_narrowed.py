"""The schema that discovery shows allows exactly what the envelope lets through."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, Literal

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from kernel.fenced import AGENT, BLIND, OPERATOR, fenced, reconfigured
from rcp_kernel.clock import SYSTEM_CLOCK
from rcp_kernel.errors import InvalidValue, OutOfRange
from rcp_kernel.model import Resource
from rcp_kernel.tree.registry import Registry
from rcp_kernel.types import Int64, Real, quantity
from rcp_kernel.values import value_type
from rcp_motion_limits.commanded_values import CommandedValues
from rcp_motion_limits.config import Bound, EnvelopeConfig
from rcp_motion_limits.limit import MotionLimit
from rcp_motion_limits.narrowed import narrowed


class Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A part; two fields share it."""

    x: quantity("m", ge=-3) = 0.0  # pyright: ignore[reportInvalidTypeForm]
    y: float | None = None


class Whole(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """All that a value may be made of."""

    a: Part = Part()
    b: Part | None = None
    real: Real = 0.0  # pyright: ignore[reportInvalidTypeForm]
    long: Int64 = 0
    word: Literal["one", "two", "three"] = "one"
    row: list[float] = []
    pair: tuple[float, float] = (0.0, 0.0)
    named: dict[str, float] = {}
    parts: list[Part] = []


bounds_of = st.builds(
    lambda low, width, optional: Bound(min=low, max=low + width, optional=optional),
    st.floats(-2, 2).map(lambda x: round(x, 2)),
    st.floats(0, 2).map(lambda x: round(x, 2)),
    st.booleans(),
)
FIELDS = (
    *("a.x", "a.y", "b.x", "b.y", "real", "long", "row.*", "pair.*", "pair.1", "named.*"),
    *("named.k", "parts.*.x", "parts.*.y"),
)
limits = st.dictionaries(st.sampled_from(FIELDS), bounds_of, min_size=1, max_size=3) | st.just(
    {"word": Bound(allow=("one", "three"))}
)
number = st.floats(-4, 4).map(lambda x: round(x, 1))
part = st.fixed_dictionaries({}, optional={"x": number, "y": number | st.none()})
values = st.fixed_dictionaries(
    {},
    optional={
        "a": part,
        "b": part | st.none(),
        "real": number | st.sampled_from(["NaN", "Infinity"]),
        "long": st.integers(-4, 4),
        "word": st.sampled_from(["one", "two", "three", "four"]),
        "row": st.lists(number, max_size=3),
        "pair": st.lists(number, min_size=2, max_size=2),
        "named": st.dictionaries(st.sampled_from("kl"), number),
        "parts": st.lists(part, max_size=2),
    },
)


def let_through(type_: Any, bounds: dict[str, Bound], plain: Any) -> bool:
    """Ask the type and the envelope themselves."""
    owner: Any = SimpleNamespace(name="o", unit=lambda _: None)
    resource = Resource(name="actuator/it", description="It.", value=type_)
    entry = Registry(SYSTEM_CLOCK).declare(owner, resource, tenant="t")
    table = EnvelopeConfig(name="e", paths=("/**",), bounds=bounds)
    nobody: Any = None
    robots: Any = SimpleNamespace(conditions=None)
    envelope = MotionLimit(table, entry, robots)
    assert envelope.fault is None
    try:
        envelope.check(
            nobody, value_type(type_).convert(plain), CommandedValues(SYSTEM_CLOCK.monotonic)
        )
    except (InvalidValue, OutOfRange):
        return False
    return True


@settings(max_examples=150)
@given(limits, values)
def test_the_narrowed_schema_and_the_envelope_agree(
    bounds: dict[str, Bound], plain: dict[str, Any]
) -> None:
    schema = narrowed(value_type(Whole).schema, bounds.items())
    Draft202012Validator.check_schema(schema)
    assert Draft202012Validator(schema).is_valid(plain) is let_through(Whole, bounds, plain)


def test_a_part_that_two_fields_share_is_narrowed_in_one() -> None:
    schema = narrowed(value_type(Whole).schema, [("a.x", Bound(max=1))])
    x = schema["properties"]["a"]["properties"]["x"]
    assert (x["minimum"], x["maximum"], x["unit"]) == (-3, 1, "m")
    assert "maximum" not in schema["$defs"]["Part"]["properties"]["x"]
    assert "$id" not in schema


def test_bounds_of_several_envelopes_are_taken_together() -> None:
    bounds = [("", Bound(min=-1, max=5)), ("", Bound(max=3)), ("", Bound(min=-4))]
    assert narrowed(value_type(float).schema, bounds) == {
        "type": "number",
        "minimum": -1,
        "maximum": 3,
    }


SPEED = """
[[envelopes]]
name = "slow"
paths = ["/actuator/drive"]
roles = ["agent", "blind"]
bounds = { "linear.x" = { max = 0.5 } }
rate = { "linear.x" = 1.0 }
when = "sensor.level > 1.0"
reason = "people walk here"
"""


@pytest.mark.anyio
async def test_discovery_shows_each_principal_what_it_is_held_to() -> None:
    async with fenced(SPEED) as world:

        async def found(token: str, **query: Any) -> dict[str, Any]:
            reply = await world.client(token).ask(
                type="discover", path="/actuator/drive", body=query or None
            )
            return reply["body"]["resources"][0]

        drive = await found(AGENT)
        assert drive["envelopes"] == [
            {
                "envelope": "slow",
                "reason": "people walk here",
                "bounds": {"linear.x": {"min": None, "max": 0.5, "allow": [], "optional": False}},
                "rate": {"linear.x": 1.0},
                "when": "sensor.level > 1.0",
            }
        ]
        shown = drive["command_schema"]["properties"]["linear"]["properties"]["x"]
        assert (shown["maximum"], shown["unit"]) == (0.5, "m/s")
        assert "maximum" not in str(drive["schemas"])
        assert "when" not in (await found(BLIND))["envelopes"][0]
        assert "command_schema" not in await found(AGENT, schemas=False)
        assert not {"envelopes", "command_schema"} & (await found(OPERATOR)).keys()
        await reconfigured(world, SPEED.replace("0.5", "0.25"))
        drive = await found(AGENT)
        shown = drive["command_schema"]["properties"]["linear"]["properties"]["x"]
        assert shown["maximum"] == 0.25
        await reconfigured(world, "")
        assert "envelopes" not in await found(AGENT)
