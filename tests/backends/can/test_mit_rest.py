"""A joint without friction stands still when an MIT drive is told to, though no code means zero."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcp_can.profiles import profile
from rcp_can.profiles.cybergear import COMMAND, TORQUE
from rcp_can.profiles.impedance import ImpedanceDrive
from rcp_can.profiles.mit import MODELS, command_codec
from rcp_can.profiles.torque_rounding import TorqueRounding
from rcp_can.sim import Plant, Twin, make_twin

PERIOD = 0.02  # s between two set-points
SECONDS = 60.0
CREEP = 0.0005  # rad in that time

DRIVES: list[tuple[str, dict[str, Any]]] = [
    ("mit", {"model": "mini-cheetah"}),
    ("mit", {"model": "H3510"}),  # fast and weak
    ("tmotor", {"model": "AK80-64"}),  # slow and strong
    ("damiao", {"model": "4310"}),
    ("cybergear", {}),
]

RESTS: dict[str, Callable[[ImpedanceDrive, int], object]] = {
    "a velocity of zero": lambda drive, _tick: drive.command("velocity", 0.0, 0.0),
    "a stop": lambda drive, _tick: drive.stop(),
    "after a stop": lambda drive, tick: drive.poll(tick),
}


CODECS = {
    **{name: (command_codec(ranges),) for name, ranges in MODELS.items()},
    "cybergear": (COMMAND, TORQUE),
}


class Line:
    """A bus between a drive's profile and its twin that takes no time."""

    def __init__(self, twin: Twin) -> None:
        self._twin = twin

    def send(self, identifier: int, data: bytes, *, extended: bool = False, **_: Any) -> None:
        frame = can.Message(arbitration_id=identifier, data=data, is_extended_id=extended)
        self._twin.take(frame)


def joint(name: str, options: dict[str, Any]) -> tuple[ImpedanceDrive, Twin]:
    """Return a drive that is on, and its twin with a rotor that nothing holds."""
    twin = make_twin(name, 1, **options)
    twin.plant = Plant(friction=0.0, stiction=0.0)
    twin.enabled = True
    found = profile(name)
    line: Any = Line(twin)
    drive: Any = found.drive(1, found.options(**options), line)
    drive.status.enabled = True
    return drive, twin


@pytest.mark.parametrize("rest", RESTS)
@pytest.mark.parametrize(("name", "options"), DRIVES)
def test_a_joint_that_is_to_rest_does_not_creep(
    name: str, options: dict[str, Any], rest: str
) -> None:
    drive, twin = joint(name, options)
    for tick in range(round(SECONDS / PERIOD)):
        RESTS[rest](drive, tick)
        twin.plant.advance(PERIOD)
    assert abs(twin.plant.position) < CREEP


@pytest.mark.parametrize("friction", [0.0, 0.01])
def test_a_twin_creeps_by_what_the_codes_say_as_a_drive_does(friction: float) -> None:
    ranges = MODELS["mini-cheetah"]
    _, twin = joint("mit", {})
    twin.plant = Plant(friction=0.0, stiction=friction)
    codes = command_codec(ranges).encode(kd=5.0)
    twin.take(can.Message(arbitration_id=1, data=codes, is_extended_id=False))
    twin.plant.advance(SECONDS)
    velocity = ranges.velocity / 4095 + ranges.torque / 4095 / 5.0
    assert twin.plant.position == pytest.approx(velocity * SECONDS, rel=0.01)


@pytest.mark.parametrize("codecs", CODECS)
@given(
    velocities=st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=40),
    kd=st.floats(0.0, 5.0),
    torque=st.floats(-1.0, 1.0),
)
def test_the_mean_of_the_set_points_is_what_was_asked_for(
    codecs: str, velocities: list[float], kd: float, torque: float
) -> None:
    rounding = TorqueRounding(*CODECS[codecs])
    spans = {span.name: span for codec in CODECS[codecs] for span in codec.spans}
    speed, strongest = (spans[name].high or 0.0 for name in ("velocity", "torque"))
    step = 2 * strongest / ((1 << spans["torque"].bits) - 1)
    damping = spans["kd"].nearest(kd)
    torque *= strongest - step - kd * speed / 4095  # what remains for the rest
    applied = wanted = 0.0
    for velocity in velocities:
        sent = rounding.next(velocity * speed, kd, torque)
        assert sent == pytest.approx(spans["torque"].nearest(sent))
        applied += damping * spans["velocity"].nearest(velocity * speed) + sent
        wanted += damping * velocity * speed + torque
    assert abs(applied - wanted) <= 0.51 * step


def test_what_exceeds_the_torque_is_not_made_up_for_later() -> None:
    rounding = TorqueRounding(command_codec(MODELS["4310"]))
    for _ in range(50):
        assert rounding.next(0.0, 0.0, 20.0) == pytest.approx(10.0)
    assert abs(rounding.next(0.0, 0.0, 0.0)) < 0.01
    assert abs(rounding.next(99.0, 5.0, 0.0)) < 0.01  # faster than it can be told


def test_the_frame_that_the_guard_sends_hardly_creeps() -> None:
    drive, twin = joint("mit", {})
    (frame,) = drive.stop_frames()
    twin.take(can.Message(arbitration_id=1, data=frame.data, is_extended_id=False))
    twin.plant.advance(SECONDS)
    assert abs(twin.plant.position) < 0.06  # rad; of both middle codes: 1.0
