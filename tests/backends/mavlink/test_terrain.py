"""The ground: read from tiles, served to a vehicle that asks for it, and flown above."""

from __future__ import annotations

import math
import os
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

import rcp_mavlink
from backends.mavlink.flying import agrees, airborne, twin
from backends.mavlink.puppet import PX4, Puppet, station
from backends.mavlink.relay import relay
from backends.mavlink.test_gateway import LAT, LON, Pilot
from rcp_gateway.testing import eventually
from rcp_gateway.testing._serve import serve_backend
from rcp_kernel.errors import ConfigError
from rcp_mavlink.elevation import Elevation, tile_at
from rcp_mavlink.terrain_feed import block

KIND = next(iter(rcp_mavlink.rcp_backends()))
EDGE = 121
TILE = "S36E149.hgt"
VOID = -32768


def rising(lat: float, _: float) -> float:
    """A slope of a tenth to the north, 500 m high at home."""
    return 500.0 + (lat - LAT) * 11131.949


def write(folder: Path, height: Callable[[float, float], float], name: str = TILE) -> Path:
    """Make a tile; rows begin in the north."""
    south, west = int(name[1:3]) * (-1 if name[0] == "S" else 1), int(name[4:7])
    last = EDGE - 1
    rows = (
        struct.pack(
            f">{EDGE}h",
            *(
                round(height(south + 1 - row / last, west + column / last))
                for column in range(EDGE)
            ),
        )
        for row in range(EDGE)
    )
    path = folder / name
    path.write_bytes(b"".join(rows))
    return path


# The tiles


def test_a_height_is_between_its_four_samples(tmp_path: Path) -> None:
    write(tmp_path, lambda lat, lon: 1000 * (lat + 36) + 100 * (lon - 149))
    found = Elevation(str(tmp_path))
    assert found.height(-35.75, 149.5) == pytest.approx(300, abs=1)
    assert found.height(-36.0, 149.0) == pytest.approx(0)
    assert found.height(-35.0000001, 149.9999999) == pytest.approx(1100, abs=1)
    assert found.height(-35.75, 149.5 - 360) == pytest.approx(300, abs=1)
    for lat, lon in ((-34.5, 149.5), (-35.5, 150.5), (90.0, 0.0), (-90.5, 0.0)):
        assert found.height(lat, lon) is None
    found.close()
    assert found.height(-35.75, 149.5) is None


def test_nothing_is_made_up_where_a_tile_has_holes_or_is_damaged(tmp_path: Path) -> None:
    path = write(tmp_path, lambda lat, _: VOID if lat > -35.5 else 40.0)
    found = Elevation(str(tmp_path))
    assert found.height(-35.25, 149.5) is None
    assert found.height(-35.5 + 1e-3, 149.5) is None, "one of the four is a hole"
    assert found.height(-35.75, 149.5) == 40.0
    os.mkfifo(tmp_path / "S36E150.hgt")
    assert found.height(-35.5, 150.5) is None, "nobody waits for a pipe"
    write(tmp_path, lambda *_: -9999, "S36E151.hgt")
    assert found.height(-35.5, 151.5) is None, "other tools mark holes so"
    assert tile_at(-16.5, 180.5) == tile_at(-16.5, -179.5) == "S17W180.hgt"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])  # cut off while it is open
    assert found.height(-35.99, 149.5) is None
    found.close()
    assert Elevation(str(tmp_path)).height(-35.75, 149.5) is None, "it is no square any more"
    with pytest.raises(ConfigError, match="no folder"):
        Elevation(str(path))


def test_a_block_has_its_heights_from_south_to_north_and_west_to_east() -> None:
    scale = math.cos(math.radians(-35.0))

    def metres(lat: float, lon: float) -> float:  # 100 north and 1 east of each 100 m
        return (lat + 35) * 111_319.49 + (lon - 149) * 1113.1949 * scale

    assert block(metres, -35.0, 149.0, 100, 0) == [
        north * 100 + east for north in range(4) for east in range(4)
    ]
    last = block(metres, -35.0, 149.0, 100, 55)
    assert last is not None
    assert last[0] == pytest.approx(2400 + 28, abs=1), "the last block is the most north and east"
    assert block(metres, -35.0, 149.0, 100, 8)[0] == 400, "a row has eight blocks"  # type: ignore[index]
    assert block(lambda *_: None, -35.0, 149.0, 100, 0) is None


# A vehicle


@asynccontextmanager
async def over(
    folder: Path, up: Callable[[Any], bool] | None = None, speed: float = 1.0
) -> AsyncIterator[Pilot]:
    """Fly a twin over the tiles of a folder; `up` decides which messages reach it."""
    async with twin(speed=speed) as running, relay(running.ports[0]) as between:
        if up is not None:
            between.up = up
        table = {
            "links": [f"udpout:127.0.0.1:{between.port}"],
            "terrain": str(folder),
            "feedback_timeout": 5.0,
        }
        async with serve_backend(KIND, table) as served:
            airborne(running.vehicle)
            await eventually(lambda: _is(bool(served.lives)), "it is open")
            await agrees(served.life.backend, running.vehicle)
            yield Pilot(served, running)


async def known(pilot: Pilot) -> dict[str, Any]:
    """Wait until the vehicle knows the ground below it."""
    reports: list[dict[str, Any]] = []

    async def there() -> bool:
        reports.append(await pilot.read("sensor/terrain"))
        return reports[-1]["ground"] is not None

    await eventually(there, "it knows the ground")
    return reports[-1]


async def test_a_vehicle_is_sent_the_ground_and_flies_above_it(tmp_path: Path) -> None:
    write(tmp_path, rising)
    async with over(tmp_path, speed=5.0) as pilot:
        report = await known(pilot)
        assert report["ground"] == pytest.approx(500, abs=2)
        assert report["height"] == pytest.approx(20, abs=2)
        assert (report["spacing"], report["missing"]) == (100.0, [])
        assert report["loaded"] > 0
        north = LAT + 100 / 111_319.49
        spot = {"latitude": north, "longitude": LON}
        checked = (await pilot.do("service/terrain/check", spot))["body"]
        assert checked["ground"] == pytest.approx(510, abs=2)
        arrived = await pilot.do("action/move_to", {**spot, "altitude": 25.0, "above": "terrain"})
        assert arrived["status"] == "completed", arrived
        assert -pilot.vehicle.body.d == pytest.approx(35, abs=2.5)
        after = await pilot.read("sensor/terrain")
        assert after["height"] == pytest.approx(25, abs=2)
        frame = {"command": "NAV_WAYPOINT", **spot, "altitude": 30.0, "frame": "terrain"}
        assert (await pilot.do("action/mission/upload", {"items": [frame]}))["body"] == {"count": 1}
        assert (await pilot.do("action/mission/run"))["status"] == "completed"
        assert -pilot.vehicle.body.d == pytest.approx(40, abs=2.5)


async def test_what_is_lost_on_the_way_is_asked_for_again(tmp_path: Path) -> None:
    write(tmp_path, rising)
    count = 0

    def up(message: Any) -> bool:
        nonlocal count
        count += message.get_type() == "TERRAIN_DATA"
        return message.get_type() != "TERRAIN_DATA" or count % 3 != 0

    async with over(tmp_path, up) as pilot:
        assert (await known(pilot))["ground"] == pytest.approx(500, abs=2)

        async def whole() -> bool:
            return (await pilot.read("sensor/terrain"))["loaded"] >= 56

        await eventually(whole, "all blocks of a grid have come")


async def test_nobody_flies_above_ground_that_is_not_known(tmp_path: Path) -> None:
    async with over(tmp_path) as pilot:
        goal = {"latitude": LAT + 1e-3, "longitude": LON, "altitude": 25.0, "above": "terrain"}
        before = pilot.vehicle.flight.submode
        reply = await pilot.do("action/move_to", goal)
        assert reply["error"]["code"] == "precondition_failed"
        assert reply["error"]["details"]["missing"] == [TILE]
        assert pilot.vehicle.flight.submode == before
        report = await pilot.read("sensor/terrain")
        assert (report["ground"], report["height"], report["spacing"]) == (None, None, None)
        assert report["pending"] > 0
        write(tmp_path, rising)  # it is looked for again
        assert (await known(pilot))["ground"] == pytest.approx(500, abs=2)

        async def whole() -> bool:
            return (await pilot.read("sensor/terrain"))["missing"] == []

        await eventually(whole, "the tile is there now")
        odd = await pilot.do("action/move_to", {**goal, "altitude": None})
        assert odd["error"]["details"]["pointer"] == "/above"


async def test_a_vehicle_that_moved_while_the_ground_was_asked_for_does_not_go_back(
    tmp_path: Path,
) -> None:
    told: list[float] = []

    def up(message: Any) -> bool:
        if message.get_type() == "COMMAND_INT" and message.command == 192:
            told.append((message.y / 1e7 - LON) * 111_319.49 * math.cos(math.radians(LAT)))
        return True

    async with over(tmp_path, up, speed=3.0) as pilot:
        goal = {"latitude": LAT, "longitude": LON, "altitude": 25.0, "above": "terrain"}
        path, vehicle = "/tenant/t/action/move_to", pilot.vehicle
        await pilot.client.send(type="execute", path=path, body={**goal, "speed": 3.0})
        vehicle.flight.aim((0.0, 60.0), -20.0)
        await eventually(lambda: _is(vehicle.body.e > 15), "it is elsewhere")
        write(tmp_path, rising)
        await eventually(lambda: _is(bool(told)), "it is told to stay, with its speed")
        assert told[0] > 10


async def test_a_vehicle_that_loses_the_ground_on_its_way_goes_home(tmp_path: Path) -> None:
    write(tmp_path, rising)
    async with over(tmp_path, speed=5.0) as pilot:
        await known(pilot)
        goal = {"latitude": LAT + 5e-3, "longitude": LON, "altitude": 25.0, "above": "terrain"}
        id_ = await pilot.client.send(
            type="execute", path="/tenant/t/action/move_to", body=goal
        )  # fmt: skip
        vehicle = pilot.vehicle
        await eventually(
            lambda: _is(vehicle.flight.height_over_ground is not None and vehicle.body.n > 20),
            "it is on its way",
        )
        vehicle.params.set("TERRAIN_ENABLE", 0)
        while (reply := await pilot.client.reply(id_, 60.0))["status"] in (
            "accepted",
            "in_progress",
        ):
            pass
        assert reply["status"] == "failed"
        assert "Terrain data missing" in str(reply)


async def test_px4_and_a_vehicle_without_terrain_take_no_heights_above_ground() -> None:
    goal = {"latitude": 47.001, "longitude": 8.0, "altitude": 25.0, "above": "terrain"}
    item = {"command": "NAV_WAYPOINT", "latitude": 47.0, "longitude": 8.0, "frame": "terrain"}
    puppet = Puppet(autopilot=PX4)
    puppet.armed, puppet.landed, puppet.height = True, 2, 20.0
    async with station(puppet) as found:
        await eventually(lambda: _is(found.robot.vehicle.landed is False), "it is in the air")
        for name, body in (("action/move_to", goal), ("action/mission/upload", {"items": [item]})):
            reply = await found.do(name, body)
            assert reply["error"]["code"] == "unsupported_operation", reply
        assert not puppet.commands(192)
        read = await found.client.request("read", "/tenant/t/sensor/terrain")
        assert read["error"]["code"] == "unknown_path"


async def _is(truth: bool) -> bool:  # noqa: FBT001 - for `eventually`, which awaits
    return truth
