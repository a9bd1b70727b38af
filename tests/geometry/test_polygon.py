"""A fence holds what is in it, whatever its shape."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcp_geometry import Corner, Polygon

SQUARE = Polygon([(0, 0), (10, 0), (10, 10), (0, 10)])
HOOK = Polygon([(0, 0), (6, 0), (6, 6), (4, 6), (4, 2), (2, 2), (2, 6), (0, 6)])
whole = st.integers(-20, 20)
Exact = tuple[Fraction, Fraction]


@st.composite
def stars(draw: st.DrawFn) -> list[Corner]:
    """Draw a polygon round the origin: as crooked as it gets without crossing itself."""
    count = draw(st.integers(3, 12))
    first = draw(st.floats(0, math.tau))
    angles = [first + math.tau * i / count for i in range(count)]
    radii = [draw(st.floats(0.5, 50)) for _ in angles]
    return [(r * math.cos(a), r * math.sin(a)) for a, r in zip(angles, radii, strict=True)]


@given(whole, whole)
def test_a_square_holds_what_lies_between_its_sides(x: int, y: int) -> None:
    assert SQUARE.holds(x, y) is (0 <= x <= 10 and 0 <= y <= 10)


@given(st.floats(-2, 8), st.floats(-2, 8))
def test_a_notch_is_outside(x: float, y: float) -> None:
    inside = 0 <= x <= 6 and 0 <= y <= 6 and not (2 < x < 4 and y > 2)
    near = min(abs(c - e) for c in (x, y) for e in (0, 2, 4, 6)) < 1e-6
    assert near or HOOK.holds(x, y) is inside


@given(stars(), st.floats(0, 1), st.integers(0, 11))
def test_edges_and_corners_belong_to_it(corners: list[Corner], along: float, number: int) -> None:
    area = Polygon(corners)
    (xa, ya), (xb, yb) = corners[number % len(corners) - 1], corners[number % len(corners)]
    assert area.holds(xb, yb)
    assert area.holds(xa + along * (xb - xa), ya + along * (yb - ya))


@given(stars(), st.floats(0.01, 2), st.integers(0, 11))
def test_a_ray_from_the_middle_leaves_it_once(
    corners: list[Corner], part: float, number: int
) -> None:
    x, y = corners[number % len(corners)]
    if abs(part - 1) > 1e-3 and len(corners) > 4:  # below, the middle may be on the outside
        assert Polygon(corners).holds(part * x, part * y) is (part < 1)


@given(stars(), st.floats(-60, 60), st.floats(-60, 60))
def test_it_agrees_with_exact_arithmetic(corners: list[Corner], x: float, y: float) -> None:
    area = Polygon(corners)
    exact = [(Fraction(a), Fraction(b)) for a, b in corners]
    inside = False
    for (xa, ya), (xb, yb) in zip([exact[-1], *exact[:-1]], exact, strict=True):
        if (ya > y) != (yb > y) and (yb - ya) * (Fraction(x) - xa) * (1 if yb > ya else -1) < (
            Fraction(y) - ya
        ) * (xb - xa) * (1 if yb > ya else -1):
            inside = not inside
    assert area.holds(x, y) or not inside
    if area.holds(x, y) and not inside:  # on an edge, as near as a float can be
        edges = zip([exact[-1], *exact[:-1]], exact, strict=True)
        near = min(squared(Fraction(x), Fraction(y), *edge) for edge in edges)
        assert near <= Fraction(2e-9 * max(abs(c) for corner in corners for c in corner)) ** 2


def squared(x: Fraction, y: Fraction, a: Exact, b: Exact) -> Fraction:
    """Return the square of the distance from a point to an edge."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    along = ((x - a[0]) * dx + (y - a[1]) * dy) / (dx * dx + dy * dy)
    along = min(Fraction(1), max(Fraction(0), along))
    return (x - a[0] - along * dx) ** 2 + (y - a[1] - along * dy) ** 2


@given(st.lists(st.tuples(whole, whole), min_size=3, max_size=7))
def test_turning_the_corners_round_changes_nothing(corners: list[tuple[int, int]]) -> None:
    try:
        area = Polygon(corners)
    except ValueError:
        for turned in (corners[::-1], corners[1:] + corners[:1]):
            with pytest.raises(ValueError):  # noqa: PT011 - whichever fault is found first
                Polygon(turned)
        return
    for turned in (Polygon(corners[::-1]), Polygon(corners[1:] + corners[:1])):
        for x in range(-20, 21, 5):
            assert [area.holds(x, y) for y in range(-20, 21, 5)] == [
                turned.holds(x, y) for y in range(-20, 21, 5)
            ]


@pytest.mark.parametrize(
    ("corners", "why"),
    [
        ([], "has 0 corners"),
        ([(0, 0), (1, 1)], "has 2 corners"),
        ([(0, 0), (1, 0), (2, 0)], "touches itself"),
        ([(0, 0), (1, 1), (1, 0), (0, 1)], "crosses or touches"),
        ([(0, 0), (4, 0), (4, 4), (2, 0), (0, 4)], "crosses or touches"),
        ([(0, 0), (1, 0), (1, 1), (0, 0)], "twice in a row"),
        ([(0, 0), (1, 0), (1, 0), (1, 1)], "twice in a row"),
        ([(0, 0), (4, 0), (2, 0), (2, 2)], "touches itself"),
        ([(0, 0), (math.inf, 0), (1, 1)], "not a finite number"),
    ],
)
def test_what_is_no_area_is_refused(corners: list[Corner], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        Polygon(corners)


def circle(count: int) -> Polygon:
    turn = math.tau / count
    return Polygon([(50 * math.cos(n * turn), 50 * math.sin(n * turn)) for n in range(count)])


def test_ten_thousand_corners_are_checked_and_what_is_too_intricate_is_refused() -> None:
    assert circle(10_000).holds(0, 0)
    slanted = [
        (n / 100 + (50 if n % 2 else 1), -n / 100 + (50 if n % 2 else 1)) for n in range(5000)
    ]
    with pytest.raises(ValueError, match="too intricate"):
        Polygon([*slanted, (30, -70), (-20, -20)])


@given(stars(), st.floats(-60, 60), st.floats(-60, 60), st.floats(-60, 60), st.floats(-60, 60))
def test_a_way_is_near_where_one_of_its_points_is(
    corners: list[Corner], xa: float, ya: float, xb: float, yb: float
) -> None:
    area, reach = Polygon(corners), 1.0
    points = [(xa + n / 40 * (xb - xa), ya + n / 40 * (yb - ya)) for n in range(41)]
    nearest = min(0.0 if area.holds(*p) else area.edge_distance(*p) for p in points)
    step = math.dist(points[0], points[1])
    if nearest <= reach:
        assert area.near((xa, ya), (xb, yb), reach + 1e-9)
    elif nearest > reach + step:
        assert not area.near((xa, ya), (xb, yb), reach)
    assert all(area.box_distance(*p) <= area.edge_distance(*p) + 1e-9 for p in points)
