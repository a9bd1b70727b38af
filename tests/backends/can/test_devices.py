"""A device by its DBC file: what it sends is told with units, what it takes keeps to its bounds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st

from backends.can.rig import Node, channel, opened
from rcp_can.device_types import message_type
from rcp_kernel.errors import AdapterUnavailable, ConfigError, InvalidValue
from rcp_kernel.values import to_plain, value_type

DBC = """
VERSION ""
NS_ :
BS_:
BU_: Pack Master
BO_ 256 Cells: 8 Pack
 SG_ Voltage : 0|16@1+ (0.1,0) [0|600] "V" Master
 SG_ Current : 16|16@1- (0.5,0) [-500|500] "A" Master
 SG_ Temperature : 32|8@1- (1,0) [-40|80] "degC" Master
 SG_ Mode : 40|2@1+ (1,0) [0|3] "" Master
BO_ 512 Contactor: 2 Master
 SG_ Close : 0|1@1+ (1,0) [0|1] "" Pack
 SG_ Limit : 8|8@1+ (2,0) [0|400] "A" Pack
BO_ 2566848512 Extended: 3 Pack
 SG_ Page M : 0|8@1+ (1,0) [0|1] "" Master
 SG_ First m0 : 8|16@1+ (1,0) [0|65535] "" Master
 SG_ Second m1 : 8|16@1+ (0.01,0) [0|655] "%" Master
CM_ BO_ 256 "What the cells measure.";
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 10000;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 256 100;
VAL_ 256 Mode 0 "Off" 1 "On" ;
"""


@pytest.fixture
def dbc(tmp_path: Path) -> str:
    path = tmp_path / "pack.dbc"
    path.write_text(DBC, encoding="utf-8")
    return str(path)


def table(name: str, path: str, **more: Any) -> dict[str, Any]:
    bus = {"interface": "virtual", "channel": name, "statistics": 0.05}
    device = {"bus": "can0", "dbc": path, "write": ["Contactor"], **more}
    return {"buses": {"can0": bus}, "devices": {"pack": device}}


async def test_a_message_is_a_sensor_with_units_and_scale(dbc: str) -> None:
    name = channel()
    async with opened(table(name, dbc)) as rig:
        resource = rig.host.resources["sensor/pack/Cells"]
        schema = value_type(resource.value).schema["$defs"]["Cells"]["properties"]
        assert schema["Voltage"]["unit"] == "V"
        assert schema["Temperature"]["unit"] == "Cel"
        assert resource.meta["choices"] == {"Mode": {"0": "Off", "1": "On"}}
        assert (resource.deadline, resource.description) == (0.3, "What the cells measure.")
        with Node(name) as node:
            node.send(0x100, bytes([0x10, 0x0E, 0xFE, 0xFF, 0xF6, 1, 0, 0]))
            cells = await rig.host.published_as("sensor/pack/Cells", Mode=1)
        assert (cells.Voltage, cells.Current, cells.Temperature) == (360.0, -1.0, -10)


async def test_a_multiplexed_message_has_the_signals_of_its_page(dbc: str) -> None:
    name = channel()
    async with opened(table(name, dbc)) as rig:
        with Node(name) as node:
            node.send(0x18FF0000, b"\x00\x05\x00")
            page = await rig.host.published_as("sensor/pack/Extended", Page=0)
            assert (page.First, page.Second) == (5, None)
            node.send(0x18FF0000, b"\x01\x64\x00")
            page = await rig.host.published_as("sensor/pack/Extended", Page=1)
            assert (page.First, page.Second) == (None, 1.0)


async def test_a_message_that_is_too_short_is_counted_and_not_told(dbc: str) -> None:
    name = channel()
    async with opened(table(name, dbc)) as rig:
        with Node(name) as node:
            node.send(0x100, b"\x00")
            await rig.host.published_as("sensor/can/can0/statistics", malformed=1)
        assert "sensor/pack/Cells" not in rig.host.samples
        with pytest.raises(AdapterUnavailable):
            await rig.backend.read("sensor/pack/Cells")


async def test_an_actuator_sends_its_message_within_its_bounds(dbc: str) -> None:
    name = channel()
    async with opened(table(name, dbc, safe={"Contactor": {"Close": 0, "Limit": 0}})) as rig:
        resource = rig.host.resources["actuator/pack/Contactor"]
        assert (resource.valid_for, resource.safe) == (0.5, {"Close": 0, "Limit": 0})
        with Node(name) as node:
            await rig.write("actuator/pack/Contactor", {"Close": 1, "Limit": 100})
            heard = await node.hears(lambda m: m.arbitration_id == 0x200)
            assert bytes(heard.data) == b"\x01\x32"
            await rig.backend.halt()
            heard = await node.hears(lambda m: m.arbitration_id == 0x200)
            assert bytes(heard.data) == b"\x00\x00"
        for bad in ({"Close": 2, "Limit": 0}, {"Close": 1, "Limit": 402}):
            with pytest.raises(InvalidValue):
                await rig.write("actuator/pack/Contactor", bad)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"read": ["Nothing"]}, r"no message 'Nothing'; it has Cells"),
        ({"dbc": "/nowhere.dbc"}, r"devices\.pack\.dbc: /nowhere"),
        ({"safe": {"Contactor": {"Close": 7, "Limit": 0}}}, r"devices\.pack\.safe"),
    ],
)
async def test_a_device_that_cannot_be_is_a_configuration_error(
    dbc: str, more: dict[str, Any], words: str
) -> None:
    with pytest.raises(ConfigError, match=words):
        async with opened(table(channel(), dbc, **more)):
            pass


@given(st.binary(min_size=8, max_size=8))
def test_any_frame_of_a_database_is_a_value_of_its_type_and_goes_back(data: bytes) -> None:
    database: Any = cantools.database.load_string(DBC, "dbc")
    message = database.get_message_by_name("Cells")
    type_ = value_type(message_type(message, bounded=False))
    value = type_.type(**message.decode(data, decode_choices=False))
    type_.check(value)
    back = message.encode(to_plain(value), strict=False)
    assert message.decode(back, decode_choices=False) == message.decode(data, decode_choices=False)
