"""Places and frames on the ellipsoid, beside those of pymap3d 3.2.0 (pymap3d.json) and by their laws."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcp_geometry import IDENTITY, NED, Rigid, about_z, ecef, geodetic, heading, local

_KNOWN = json.loads((Path(__file__).parent / "pymap3d.json").read_text())
_LATITUDE, _LONGITUDE = st.floats(-90, 90), st.floats(-180, 180)
_ALTITUDE, _METRES, _ANGLE = st.floats(-5e3, 1e5), st.floats(-2e4, 2e4), st.floats(-3.14, 3.14)


@pytest.mark.parametrize("known", _KNOWN, ids=lambda one: str(one["origin"][:2]))
def test_conversions_agree_with_pymap3d(known: dict[str, Any]) -> None:
    assert ecef(*known["origin"]) == pytest.approx(known["ecef"], abs=1e-7)
    frame = local(*known["origin"])
    there = ecef(*known["place"])
    assert frame.point(tuple(known["enu"])) == pytest.approx(there, abs=1e-6)
    assert frame.inverse.point(there) == pytest.approx(known["enu"], abs=1e-6)
    ned = frame._replace(rotation=frame.turn(NED))
    assert ned.inverse.point(there) == pytest.approx(known["ned"], abs=1e-6)
    if abs(known["origin"][0]) < 90:
        assert geodetic(there) == pytest.approx(known["place"], abs=1e-8)


def test_the_axes_of_a_local_frame_are_east_north_up() -> None:
    frame = local(0.0, 0.0)
    assert frame.vector((1.0, 0.0, 0.0)) == pytest.approx((0.0, 1.0, 0.0))  # east
    assert frame.vector((0.0, 1.0, 0.0)) == pytest.approx((0.0, 0.0, 1.0))  # to the pole
    assert frame.vector((0.0, 0.0, 1.0)) == pytest.approx((1.0, 0.0, 0.0))  # away from the centre
    down = Rigid((0.0, 0.0, 0.0), NED)
    assert down.vector((1.0, 0.0, 0.0)) == pytest.approx((0.0, 1.0, 0.0))  # north
    assert down.vector((0.0, 1.0, 0.0)) == pytest.approx((1.0, 0.0, 0.0))  # east
    assert down.vector((0.0, 0.0, 1.0)) == pytest.approx((0.0, 0.0, -1.0))  # down
    turned = local(48.0, 11.0, 500.0, math.pi / 2)
    north = local(48.0, 11.0, 500.0).vector((0.0, 1.0, 0.0))
    assert turned.vector((1.0, 0.0, 0.0)) == pytest.approx(north)


@pytest.mark.parametrize(
    ("yaw", "clockwise"),
    [(0.0, 90.0), (math.pi / 2, 0.0), (math.pi, 270.0), (-math.pi / 2, 180.0), (0.1, 84.2704)],
)
def test_a_heading_counts_clockwise_from_north(yaw: float, clockwise: float) -> None:
    assert math.degrees(heading(about_z(yaw))) == pytest.approx(clockwise, abs=1e-3)


@given(_LATITUDE, _LONGITUDE, _ALTITUDE)
def test_a_place_survives_the_round_trip(lat: float, lon: float, alt: float) -> None:
    at = ecef(lat, lon, alt)
    assert ecef(*geodetic(at)) == pytest.approx(at, abs=1e-6)


@given(st.tuples(_METRES, _METRES, _METRES), _LATITUDE, _LONGITUDE, _ALTITUDE, _ANGLE)
def test_a_transform_and_its_inverse_cancel(
    at: tuple[float, float, float], lat: float, lon: float, alt: float, yaw: float
) -> None:
    frame = local(lat, lon, alt, yaw)
    assert frame.inverse.point(frame.point(at)) == pytest.approx(at, abs=1e-6)
    same = frame.inverse.join(frame)
    assert same.position == pytest.approx(IDENTITY.position, abs=1e-6)
    assert same.vector(at) == pytest.approx(at, abs=1e-6)


@given(_ANGLE, _ANGLE, _METRES, _METRES)
def test_yaw_turns_with_the_frame(yaw: float, goal: float, x: float, y: float) -> None:
    frame = Rigid((x, y, 0.0), about_z(yaw))
    assert math.cos(frame.yaw(goal) - yaw - goal) == pytest.approx(1.0)
    down = Rigid((0.0, 0.0, 0.0), NED)
    assert math.cos(down.yaw(goal) - (math.pi / 2 - goal)) == pytest.approx(1.0)
