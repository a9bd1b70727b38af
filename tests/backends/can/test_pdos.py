"""PDOs as a drive has them from the factory, by its EDS, and nothing is mapped by the gateway."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from backends.can.peers import drive_eds
from backends.can.rig import motor
from rcp_can.codec import Field, Layout
from rcp_can.profiles.cia402_options import Cia402Options
from rcp_can.profiles.cia402_pdos import MappedPdo, PdoMap, eds_map, own_map
from rcp_kernel.errors import ConfigError, ModeForbids


def options(eds: Path) -> dict[str, object]:
    return {"eds": str(eds), "map_pdos": False}


async def test_a_drive_is_driven_by_the_pdos_that_it_has_from_the_factory(tmp_path: Path) -> None:
    eds = drive_eds(tmp_path / "drive.eds", node=5)
    async with motor("cia402", options=options(eds), velocity=20.0, acceleration=50.0) as rig:
        assert rig.axis.state == "disabled"
        assert "actuator/m/torque" not in rig.host.resources  # no PDO carries it
        with pytest.raises(ModeForbids):
            await rig.write("actuator/m/velocity", 1.0)
        await rig.enable()
        await rig.write("actuator/m/velocity", 3.0)
        await rig.until(lambda: abs(rig.twin.plant.velocity - 3.0) < 0.1)
        await rig.backend.halt()
        assert abs(rig.twin.plant.velocity) < 0.1
        await rig.enable()
        moved = await rig.ran("action/m/move_to", {"position": 1.0})
        assert moved["position"] == pytest.approx(1.0, abs=0.02)
        await rig.write("actuator/m/position", 0.5)
        await rig.until(lambda: abs(rig.twin.plant.position - 0.5) < 0.02)
        await rig.ran("action/m/home")
        assert rig.twin.plant.position == pytest.approx(0, abs=0.01)


async def test_its_faults_and_boots_are_told_as_ever(tmp_path: Path) -> None:
    eds = drive_eds(tmp_path / "drive.eds", node=5)
    async with motor("cia402", options=options(eds)) as rig:
        await rig.enable()
        await rig.write("actuator/m/velocity", 2.0)
        await rig.ordered(rig.twin.break_down)
        await rig.host.published_as("sensor/m/state", state="fault")
        await rig.ran("service/m/clear_faults")
        await rig.enable()
        await rig.write("actuator/m/velocity", 2.0)
        await rig.ordered(rig.twin.boot)
        await rig.host.until(lambda: {"reset", "switched_off"} & set(rig.faults()))
        await asyncio.sleep(0.2)
        assert not rig.twin.enabled


def test_the_identifiers_are_those_of_the_node(tmp_path: Path) -> None:
    found = eds_map(str(drive_eds(tmp_path / "drive.eds", node=7)), 7)
    assert [pdo.cob for pdo in found.commands] == [0x207, 0x307, 0x407, 0x507]
    assert sorted(found.feedback) == [0x187, 0x287, 0x387, 0x487]
    order = found.carrying("target_position", "mode", "controlword")
    assert [pdo.layout.names for pdo in order][-1] == ("controlword", "mode")
    assert ("controlword", "target_position") in [pdo.layout.names for pdo in order]


@pytest.mark.parametrize(
    ("left_out", "words"),
    [([0x1402], r"no receive PDO carries 0x607A"), ([0x1802], r"no transmit PDO carries 0x6064")],
)
def test_a_mapping_that_lacks_what_a_motor_needs_is_a_configuration_error(
    tmp_path: Path, left_out: list[int], words: str
) -> None:
    eds = drive_eds(tmp_path / "drive.eds", node=5, left_out=left_out)
    with pytest.raises(ConfigError, match=words):
        eds_map(str(eds), 5)


def test_an_eds_beside_pdos_of_our_own_is_refused() -> None:
    with pytest.raises(msgspec.ValidationError, match="map_pdos"):
        msgspec.convert({"eds": "drive.eds"}, Cia402Options)


names = st.sampled_from(["controlword", "mode", "target_position", "target_velocity"])


@given(st.lists(st.frozensets(names, min_size=1), min_size=1, max_size=5), st.frozensets(names))
def test_whatever_is_mapped_is_carried_and_no_pdo_goes_twice(
    mapped: list[frozenset[str]], wanted: frozenset[str]
) -> None:
    pdos = [
        MappedPdo(cob, Layout("<", *(Field(name, "H") for name in sorted(each))))
        for cob, each in enumerate(mapped)
    ]
    found = PdoMap(pdos, {}).carrying(*sorted(wanted))
    carried = {name for pdo in found for name in pdo.layout.names}
    assert wanted & frozenset().union(*mapped) <= carried
    assert len({pdo.cob for pdo in found}) == len(found)
    assert all(wanted & set(pdo.layout.names) for pdo in found)


def test_the_map_of_our_own_needs_two_frames() -> None:
    found = own_map(5)
    assert len(found.carrying("target_position", "mode", "controlword")) == 1
    assert len(found.carrying("target_velocity", "target_torque")) == 1


@pytest.mark.parametrize(
    ("rate", "period"),
    [(50, (20, -3)), (100, (10, -3)), (1000, (1, -3)), (60, (167, -4)), (3, (33, -2))],
)
async def test_a_drive_is_told_how_often_its_cyclic_set_points_come(
    rate: float, period: tuple[int, int]
) -> None:
    async with motor("cia402", rate=rate, watchdog=False) as rig:
        twin: Any = rig.twin
        await rig.until(lambda: rig.axis.configured)
        assert (twin.get("interpolation_period"), twin.get("interpolation_exponent")) == period
