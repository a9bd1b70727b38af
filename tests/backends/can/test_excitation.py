"""Step response and chirp: figures, limits, refusals, and rest however they end."""

from __future__ import annotations

import asyncio
import math
from typing import Any

import anyio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from backends.can.rig import MOTORS, motor
from backends.can.test_gateway import bed
from rcp_can.chirp_signal import ChirpSignal
from rcp_can.step_figures import step_figures
from rcp_kernel.errors import InvalidValue, ModeForbids, OutOfRange, RcpError

PROFILES = ["odrive", "cia402", "damiao"]
CHIRP = {"duration": 1.5, "start_frequency": 0.8, "end_frequency": 2.0}
LONG = {"velocity": 2.0, "duration": 30.0, "start_frequency": 0.5, "end_frequency": 2.0}


def second_order(damping: float, natural: float, time: float) -> float:
    """Return the unit step response of a second-order system."""
    damped = natural * math.sqrt(1 - damping**2)
    phase = math.cos(damped * time) + damping / math.sqrt(1 - damping**2) * math.sin(damped * time)
    return 1 - math.exp(-damping * natural * time) * phase


def test_the_figures_are_those_of_a_second_order_system() -> None:
    times = [0.001 * n for n in range(3000)]
    values = [3 - 2 * second_order(0.5, 10.0, time) for time in times]
    found = step_figures(times, values, -2.0)
    assert found.overshoot == pytest.approx(math.exp(-math.pi * 0.5 / math.sqrt(0.75)), abs=0.005)
    assert found.rise_time == pytest.approx(0.1638, abs=0.003)
    assert found.settling_time == pytest.approx(0.8076, abs=0.02)


@pytest.mark.parametrize(
    "values", [[], [0.0] * 50, [0.001 * n for n in range(50)]], ids=["none", "still", "crawling"]
)
def test_a_joint_that_does_not_arrive_has_no_figures(values: list[float]) -> None:
    assert step_figures([0.01 * n for n in range(len(values))], values, 1.0).settling_time is None


@given(start=st.floats(0.05, 5), end=st.floats(0.05, 5), duration=st.floats(0.2, 30))
@settings(max_examples=10, deadline=None)
def test_a_chirp_keeps_to_its_bounds_and_begins_and_ends_at_zero(
    start: float, end: float, duration: float
) -> None:
    signal = ChirpSignal(start, end, duration)
    step, area = duration / 4000, 0.0
    before = signal.at(0.0)
    assert before == (0.0, 0.0)
    for n in range(1, 4001):
        value, slope = signal.at(n * step)
        area += value * step
        assert abs(value) <= 1 + 1e-9
        assert abs(slope) <= signal.slope * 1.0001
        assert abs(value - before[0]) <= signal.slope * step * 1.01 + 1e-9
        assert abs(slope - before[1]) <= signal.curvature * step * 1.01 + 1e-9
        assert abs(area) <= signal.integral
        before = value, slope
    assert abs(before[0]) < 0.01


@pytest.mark.parametrize("profile", PROFILES)
async def test_a_step_of_velocity_is_measured_and_ends_at_rest(profile: str) -> None:
    async with motor(profile, commissioning=True, velocity=8.0, rate=100) as rig:
        await rig.enable()
        found = await rig.ran("action/m/step", {"velocity": 4.0, "duration": 1.0})
        assert abs(rig.twin.plant.velocity) < 0.1
        assert not rig.axis.driven
        assert len(found["time"]) == len(found["velocity"]) == len(found["commanded_velocity"]) > 8
        assert found["time"] == sorted(found["time"])
        assert found["velocity"][0] == pytest.approx(0, abs=0.1)
        assert found["velocity"][-1] == pytest.approx(4.0, abs=0.4)
        assert max(found["commanded_velocity"]) == pytest.approx(4.0)
        assert 0 <= found["rise_time"] < 1.0
        assert "commanded_position" not in found or not found["commanded_position"]


async def test_a_step_of_position_keeps_to_velocity_and_acceleration() -> None:
    limits: dict[str, Any] = {"velocity": 2.0, "acceleration": 20.0, "rate": 100}
    async with motor("odrive", commissioning=True, **limits) as rig:
        await rig.enable()
        await rig.write("actuator/m/position", 0.3)
        await rig.until(lambda: abs(rig.twin.plant.position - 0.3) < 0.01 and rig.axis.resting)
        found = await rig.ran("action/m/step", {"position": 1.0, "duration": 2.0})
        assert rig.twin.plant.position == pytest.approx(1.3, abs=0.02)
        assert abs(rig.twin.plant.velocity) < 0.1
        assert found["commanded_position"][-1] == pytest.approx(1.3)
        # A twin whose thread was late shows a spike of a few samples.
        assert sorted(found["velocity"])[len(found["velocity"]) * 95 // 100] < 2.6
        assert found["rise_time"] == pytest.approx(0.8 / 2.0, rel=0.5)
        assert rig.feedback[-1][1] > rig.feedback[0][1]


@pytest.mark.parametrize("quantity", ["position", "velocity"])
async def test_a_chirp_swings_about_where_it_began_and_ends_at_rest(quantity: str) -> None:
    async with motor("odrive", commissioning=True, velocity=8.0, rate=100) as rig:
        await rig.enable()
        found = await rig.ran("action/m/chirp", {quantity: 0.4, **CHIRP})
        measured, commanded = found[quantity], found[f"commanded_{quantity}"]
        for series in (measured, commanded):
            assert max(series) > 0.2
            assert min(series) < -0.2
        assert max(map(abs, commanded)) < 0.41
        assert abs(rig.twin.plant.velocity) < 0.1
        assert abs(rig.twin.plant.position) < 0.4


REFUSED: list[tuple[str, dict[str, Any], type[RcpError], str]] = [
    ("step", {"duration": 1.0}, InvalidValue, "either"),
    ("step", {"position": 1.0, "velocity": 1.0, "duration": 1.0}, InvalidValue, "either"),
    ("step", {"velocity": 0.0, "duration": 1.0}, InvalidValue, "zero"),
    ("step", {"velocity": 4.5, "duration": 0.1}, OutOfRange, "4 rad/s are allowed"),
    ("step", {"position": -1.5, "duration": 1.0}, OutOfRange, "-1 and 1 rad"),
    ("step", {"velocity": 1.0, "duration": 2.0}, OutOfRange, "would go to"),
    ("chirp", {"position": 1.2, **CHIRP}, OutOfRange, "-1 and 1 rad|velocity"),
    ("chirp", {"position": 0.9, **CHIRP}, OutOfRange, "velocity"),
    ("chirp", {"velocity": 3.0, **CHIRP}, OutOfRange, "acceleration"),
    ("chirp", {"velocity": 0.1, **CHIRP, "end_frequency": 9.0}, OutOfRange, "set-points"),
]


async def test_what_would_leave_the_limits_is_refused_before_anything_moves() -> None:
    limits = {"position": [-1.0, 1.0], "velocity": 4.0, "acceleration": 30.0}
    async with motor("odrive", commissioning=True, **limits) as rig:
        for verb in ("step", "chirp"):
            good = rig.host.resources[f"action/m/{verb}"].examples[0]
            with pytest.raises(ModeForbids, match="disabled"):
                await rig.ran(f"action/m/{verb}", good)
        await rig.enable()
        await rig.until(lambda: rig.axis.resting)
        for verb, body, error, words in REFUSED:
            value = rig.typed(f"action/m/{verb}", body)
            with pytest.raises(error, match=words):
                rig.backend.foresee(f"action/m/{verb}", value)
            with pytest.raises(error, match=words):
                await rig.ran(f"action/m/{verb}", body)
        assert rig.axis.owner is None
        assert all(abs(value) < 1e-3 for _, value in rig.twin.commands)


@pytest.mark.parametrize(
    ("profile", "end"),
    [
        *(("odrive", end) for end in ("cancel", "halt", "hold", "zero", "boot", "silent")),
        *(("cia402", end) for end in ("cancel", "halt", "hold")),
    ],
)
async def test_it_is_at_rest_however_it_is_ended(profile: str, end: str) -> None:
    async with motor(profile, commissioning=True, velocity=8.0) as rig:
        await rig.enable()
        running = asyncio.ensure_future(
            rig.execute("action/m/step", {"velocity": 4.0, "duration": 30.0})
        )
        await rig.until(lambda: rig.twin.plant.velocity > 3.0)
        with pytest.raises(ModeForbids, match="driven by action/m/step"):
            await rig.write("actuator/m/velocity", 1.0)
        match end:
            case "cancel":
                running.cancel()
            case "halt":
                await rig.backend.halt()
            case "hold":
                await rig.backend.hold(None)
            case "zero":
                await rig.write("actuator/m/velocity", 0.0)
            case "boot":
                await rig.ordered(rig.twin.boot)
            case _:
                rig.twin.silent = True
        with anyio.fail_after(60):
            await asyncio.wait((running,))
        if end == "silent":  # it went on by what it was told last, and is stopped when it is back
            rig.twin.silent = False
            await rig.host.until(lambda: rig.axis.online)
            await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        assert running.cancelled() or isinstance(running.exception(), RcpError)
        if end in ("cancel", "halt", "hold"):
            assert abs(rig.twin.plant.velocity) < 0.1
        await rig.until(lambda: abs(rig.twin.plant.velocity) < 0.1)
        taken = len(rig.twin.commands)
        seen = rig.axis.status.counts["velocity"]
        await rig.until(lambda: rig.axis.status.counts["velocity"] > seen + 10)
        assert abs(rig.twin.plant.velocity) < 0.1
        assert all(abs(v) < 0.01 for mode, v in rig.twin.commands[taken:] if mode == "velocity")


async def test_through_a_gateway_a_dry_run_moves_nothing_and_an_e_stop_ends_a_chirp() -> None:
    async with bed("odrive", commissioning=True, velocity=8.0) as held:
        body = {"velocity": 2.0, "duration": 1.0}
        dry = await held.ask("execute", "action/m/step", body, dry_run=True)
        assert dry["error"]["code"] == "mode_forbids", dry
        await held.done("service/m/enable")
        dry = await held.ask("execute", "action/m/step", body, dry_run=True)
        assert (dry["status"], dry["dry_run"]) == ("completed", True), dry
        assert abs(held.twin.plant.velocity) < 0.01
        id_ = await held.client.send(type="execute", path="/tenant/t/action/m/chirp", body=LONG)
        await held.until(lambda: held.twin.plant.velocity > 0.5)
        stopped = await held.client.request("execute", "/system/estop", body={}, within=60.0)
        assert stopped["status"] == "completed", stopped
        assert abs(held.twin.plant.velocity) < 0.1
        reply = await held.client.final(id_, 20.0)
        assert reply["status"] in ("failed", "cancelled"), reply
        assert await held.code("execute", "action/m/step", body) == "estop_active"
        assert abs(held.twin.plant.velocity) < 0.1


async def test_a_motor_that_is_not_to_be_commissioned_offers_nothing_of_it() -> None:
    async with motor("odrive", **MOTORS["odrive"]) as rig:
        assert (
            not {"action/m/step", "action/m/chirp", "param/m/firmware"} & rig.host.resources.keys()
        )
