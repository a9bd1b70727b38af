"""Records are deleted for their age only by a clock that has gone on like that for a day."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from kernel.world import World, kept_in, settled, world_of
from rcp_gateway.testing import SteppedClock

pytestmark = pytest.mark.anyio
LIMIT = "/tenant/alpha/param/limit"
DAY = 86_400
YEAR = 365 * DAY
KEPT = "[audit]\nkeep_days = 30\n"


@pytest.fixture(autouse=True)
def sealed(stepped: SteppedClock, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the records have the times of the clock that the test sets."""
    monkeypatch.setattr("rcp_store.chain.now", stepped.now)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """The store."""
    return tmp_path / "store.db"


async def looked(world: World, query: str) -> Any:
    """Ask the store once retention has done what it has begun."""
    store, found = world.server.gateway.store, list[Any]()
    for _ in range(3):  # a look, the deletion, and another look
        await settled(store)
    store.look(lambda base: base.execute(query).fetchone()[0], found.append)
    await settled(store)
    return found[0]


async def first(world: World) -> int:
    """Return the number of the first record that is left."""
    return await looked(world, "SELECT min(seq) FROM audit")


async def write(world: World) -> None:
    """Make a record."""
    await world.client().ask(type="write", path=LIMIT, body=1.0)


async def checked(world: World, stepped: SteppedClock, seconds: float = 100) -> int:
    """Let some time pass until the next check, and return the first record that is left."""
    for _ in range(2):  # timers that are due run in the loop's next turns
        stepped.advance(seconds / 2)
        await write(world)
    return await first(world)


async def test_a_clock_that_is_ahead_deletes_nothing_after_a_restart_either(
    stepped: SteppedClock, path: Path
) -> None:
    async with world_of(kept_in(path) + KEPT, clock=stepped.clock) as world:
        await write(world)
    stepped.adjust(10 * YEAR)
    for _ in range(3):
        async with world_of(kept_in(path) + KEPT, clock=stepped.clock) as world:
            assert await checked(world, stepped) == 1
    stepped.adjust(-10 * YEAR)
    async with world_of(kept_in(path) + KEPT, clock=stepped.clock) as world:
        assert await checked(world, stepped) == 1


async def test_it_is_believed_after_a_day_over_several_runs(
    stepped: SteppedClock, path: Path
) -> None:
    async with world_of(kept_in(path) + KEPT, clock=stepped.clock) as world:
        await write(world)
    stepped.adjust(10 * YEAR)
    for hours in (10, 10):
        async with world_of(kept_in(path) + KEPT, clock=stepped.clock) as world:
            assert await checked(world, stepped) == 1
            assert await checked(world, stepped, hours * 3600) == 1
    async with world_of(kept_in(path) + KEPT, clock=stepped.clock) as world:
        assert await checked(world, stepped, 10 * 3600) > 1


@pytest.mark.parametrize("without_clock", [False, True])
async def test_a_robot_that_runs_for_some_hours_a_week_deletes_old_records(
    stepped: SteppedClock, path: Path, *, without_clock: bool
) -> None:
    first_of: list[int] = []
    for _ in range(15):
        back = -(stepped.now() // 10**9) if without_clock else 0
        stepped.adjust(back)
        async with world_of(kept_in(path) + KEPT, clock=stepped.clock) as world:
            if without_clock:  # 1970, until there is a network
                await checked(world, stepped)
                stepped.adjust(-back)
            first_of.append(await checked(world, stepped, 6 * 3600))
        stepped.adjust(7 * DAY)
    assert first_of[:5] == [1] * 5
    assert first_of[-1] > first_of[-3] > first_of[-5] > 1


async def test_a_correction_that_leaves_it_ahead_does_not_make_it_believed(
    stepped: SteppedClock, path: Path
) -> None:
    async with world_of(kept_in(path) + KEPT, clock=stepped.clock) as world:
        await write(world)
        stepped.adjust(10 * YEAR)
        assert await checked(world, stepped) == 1
        stepped.adjust(-2 * DAY)
        assert await checked(world, stepped) == 1


async def test_a_clock_that_went_ahead_while_all_records_were_kept_is_not_believed_either(
    stepped: SteppedClock, path: Path
) -> None:
    forever = "[audit]\nkeep_mb = 100\nkeep_days = inf\n"
    async with world_of(kept_in(path) + forever, clock=stepped.clock) as world:
        await write(world)
        stepped.adjust(10 * YEAR)
        assert await checked(world, stepped) == 1
    async with world_of(kept_in(path) + KEPT, clock=stepped.clock) as world:
        assert await checked(world, stepped) == 1


async def test_records_of_1970_take_no_younger_ones_along(
    stepped: SteppedClock, path: Path
) -> None:
    async with world_of(kept_in(path) + KEPT, clock=stepped.clock) as world:
        await write(world)
        young = await looked(world, "SELECT max(seq) FROM audit")
    stepped.adjust(40 * DAY)
    async with world_of(kept_in(path) + KEPT, clock=stepped.clock) as world:
        await write(world)
    back = -(stepped.now() // 10**9)
    stepped.adjust(back)
    async with world_of(kept_in(path) + KEPT, clock=stepped.clock) as world:
        for _ in range(20):
            await write(world)
        stepped.adjust(-back)
        await checked(world, stepped)
        left = await checked(world, stepped, 3 * DAY)
        assert left == young + 2  # after the record that the first run ended with


async def test_many_records_of_a_clock_that_was_never_set_go_with_the_first_old_one(
    stepped: SteppedClock, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcp_audit.retention._AT_ONCE", 5)
    back = -(stepped.now() // 10**9)
    stepped.adjust(back)
    async with world_of(kept_in(path) + KEPT, clock=stepped.clock) as world:
        for _ in range(30):
            await write(world)
        stepped.adjust(-back)
        await write(world)
        assert await checked(world, stepped, 20 * DAY) == 1
        left = [await checked(world, stepped, 2 * DAY) for _ in range(12)]
        assert left[-1] > 30
