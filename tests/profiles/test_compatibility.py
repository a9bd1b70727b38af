"""A type that is said to stand in for another accepts all its values."""

from __future__ import annotations

import itertools
from typing import Annotated, Any, Literal

import msgspec
import pytest
from msgspec import Meta

from rcp_gateway.testing._schemas import legal
from rcp_kernel.errors import RcpError
from rcp_kernel.types import Int64, Real, quantity
from rcp_kernel.values import value_type
from rcp_profiles import STANDARD
from rcp_profiles.compatibility import unaccepted, unexpected

PARTS = ("value", "input", "output", "feedback")
KNOWN = {
    repr(type_): type_
    for profile in STANDARD.values()
    for one in profile.resources
    for part in PARTS
    if (type_ := getattr(one.resource, part)) is not None
}


class Open(msgspec.Struct, frozen=True):
    """A field."""

    x: float
    title: str = ""


class More(msgspec.Struct, frozen=True):
    """A field more."""

    x: float
    y: float = 0.0
    title: str = ""


class Wanting(msgspec.Struct, frozen=True):
    """A field that must be given."""

    x: float
    y: float


class Closed(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A field, and nothing else."""

    x: float
    title: str = ""


class Silent(msgspec.Struct, frozen=True):
    """A field that is left out at times."""

    x: float
    y: float | msgspec.UnsetType = msgspec.UNSET


class Other(msgspec.Struct, frozen=True):
    """A field that means something else if it is left out."""

    x: float
    title: str = "untitled"


class Tree(msgspec.Struct, frozen=True):
    """A type that contains itself."""

    x: float
    branches: list[Tree] = []


class Twig(msgspec.Struct, frozen=True):
    """Another one, with a field more."""

    x: float
    y: float = 0.0
    branches: list[Twig] = []


class Leafy(msgspec.Struct, frozen=True):
    """Another one, of texts."""

    x: str
    branches: list[Leafy] = []


SMALL: Any = Annotated[int, Meta(ge=0, le=5)]  # a longer one may be a text in JSON
OWN: list[Any] = [
    float,
    int,
    Int64,
    Real,
    str,
    bytes,
    bool,
    None,
    float | None,
    Literal["a"],
    Literal["a", "b"],
    Annotated[str, Meta(max_length=3)],
    Annotated[float, Meta(ge=0)],
    Annotated[float, Meta(gt=0)],
    Annotated[float, Meta(ge=0, le=1)],
    Annotated[int, Meta(ge=0, le=5)],
    quantity("m"),
    list[float],
    list[int],
    Annotated[list[int], Meta(min_length=1)],
    dict[str, float],
    dict[str, int],
    Open,
    More,
    Wanting,
    Any,
]
TYPES = [*KNOWN.values(), *OWN]


def test_what_is_said_to_be_accepted_is() -> None:
    accepted = 0
    for old, new in itertools.product(TYPES, TYPES):
        before, after = value_type(old), value_type(new)
        if unaccepted(before.schema, after.schema):
            continue
        accepted += 1
        for value in legal(before.schema):
            try:
                after.convert(value)
            except RcpError as error:
                pytest.fail(f"{new} does not accept {value!r} of {old}: {error}")
    assert accepted > len(TYPES)  # each one itself, and more


@pytest.mark.parametrize("type_", TYPES, ids=str)
def test_a_type_stands_in_for_itself(type_: Any) -> None:
    schema = value_type(type_).schema
    assert unaccepted(schema, schema) == []
    assert unexpected(schema, schema) == []


@pytest.mark.parametrize(
    ("old", "new", "sent", "received"),
    [
        (float, SMALL, False, True),
        (float, float | None, True, False),
        (float, quantity("m"), False, False),
        (quantity("m"), quantity("mm"), False, False),
        (str, bytes, False, False),
        (Literal["a"], Literal["a", "b"], True, False),
        (Literal["a"], str, True, False),
        (Annotated[float, Meta(ge=0)], float, True, False),
        (Annotated[float, Meta(ge=0)], Annotated[float, Meta(gt=0)], False, True),
        (Annotated[float, Meta(gt=0)], Annotated[float, Meta(ge=0)], True, False),
        (list[float], list[SMALL], False, True),
        (dict[str, float], dict[str, SMALL], False, True),
        (Open, More, True, True),
        (More, Open, True, False),
        (Open, Wanting, False, False),
        (Any, float, False, True),
        (float, Any, True, False),
        (Open, Closed, False, True),
        (Closed, Open, True, True),
        (Wanting, Silent, True, False),
        (Open, Other, False, True),
        (Tree, Twig, True, True),
        (Tree, Leafy, False, False),
        (tuple[float, float], list[str], False, False),
        (list[str], tuple[float, float], False, False),
        (tuple[float, float], tuple[float, float, float], False, False),
        (tuple[float, float], list[float], True, False),
        (list[float], tuple[float, float], False, True),
    ],
    ids=str,
)
def test_both_directions(old: Any, new: Any, sent: bool, received: bool) -> None:  # noqa: FBT001
    before, after = value_type(old).schema, value_type(new).schema
    assert (unaccepted(before, after) == []) is sent, unaccepted(before, after)
    assert (unexpected(before, after) == []) is received, unexpected(before, after)


class Joints(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The joints that there are."""

    elbow: Annotated[float, Meta(ge=-1, le=1)] | None = None


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (Literal["a"], Literal["b"]),
        (Annotated[float, Meta(ge=0, le=1)], Annotated[float, Meta(ge=2)]),
        (Annotated[float, Meta(ge=0)], Annotated[float, Meta(le=-1)]),
        (tuple[float, float], tuple[float, float, float]),
    ],
    ids=str,
)
def test_limits_leave_something(old: Any, new: Any) -> None:
    assert unaccepted(value_type(old).schema, value_type(new).schema, limits=True)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (float, Annotated[float, Meta(ge=-1, le=1)]),
        (str, Literal["a", "b"]),
        (dict[str, float], Joints),
        (list[float], Annotated[list[float], Meta(max_length=3)]),
    ],
    ids=str,
)
def test_a_robot_may_have_limits_of_its_own(old: Any, new: Any) -> None:
    before, after = value_type(old).schema, value_type(new).schema
    assert unaccepted(before, after)
    assert unaccepted(before, after, limits=True) == []
