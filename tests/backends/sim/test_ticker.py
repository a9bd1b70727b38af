"""The clock of the rover: no drift, bounded catching up."""

from __future__ import annotations

import itertools

import pytest

from rcp_sim.ticker import run_ticks

pytestmark = pytest.mark.anyio


class Time:
    """A clock that moves only when somebody sleeps, and sometimes oversleeps."""

    def __init__(self, *oversleep: float) -> None:
        self.now = 100.0
        self._over = list(oversleep)
        self.naps: list[float] = []

    def wall(self) -> int:
        return int(self.now * 1e9)

    async def sleep(self, seconds: float) -> None:
        self.naps.append(seconds)
        self.now += seconds + (self._over.pop(0) if self._over else 0.0)
        if self.now > 110:
            raise TimeoutError


async def ticks(time: Time, rate: float) -> list[int]:
    stamps: list[int] = []
    with pytest.raises(TimeoutError):
        await run_ticks(
            stamps.append, rate, clock=lambda: time.now, sleep=time.sleep, wall=time.wall
        )
    return stamps


@pytest.mark.parametrize("rate", [1, 7, 50, 333, 1000])
async def test_ten_seconds_have_ten_times_the_rate_of_ticks(rate: int) -> None:
    stamps = await ticks(Time(), rate)
    assert abs(len(stamps) - 10 * rate) <= 2
    gaps = [(b - a) / 1e9 for a, b in itertools.pairwise(stamps)]
    assert all(gap == pytest.approx(1 / rate, abs=1e-5) for gap in gaps)


async def test_oversleeping_is_made_up_for_with_the_right_times() -> None:
    stamps = await ticks(Time(0.0, 0.1), 50)
    assert abs(len(stamps) - 500) <= 2
    assert stamps == sorted(stamps)
    gaps = [(b - a) / 1e9 for a, b in itertools.pairwise(stamps)]
    assert max(gaps) < 0.021


async def test_a_long_sleep_is_not_made_up_for() -> None:
    stamps = await ticks(Time(0.0, 5.0), 50)
    assert 250 <= len(stamps) <= 270


async def test_it_never_asks_for_a_nap_of_nothing() -> None:
    time = Time()
    await ticks(time, 1000)
    assert min(time.naps) >= 0.001
