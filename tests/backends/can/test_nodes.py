"""A CANopen node by its EDS: what its dictionary holds are parameters with types and bounds."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import rcp_can
from backends.can.peers import durand_network, local_node
from backends.can.rig import Rig, channel, motor, opened
from rcp_can.eds_types import entry_of
from rcp_can.sim.cia402_objects import make_dictionary
from rcp_gateway.testing._serve import OPERATOR, VIEWER, serve_backend
from rcp_kernel.errors import ConfigError, DeviceRejected, DeviceTimeout
from rcp_kernel.model import Operation
from rcp_kernel.values import value_type


def table(name: str, eds: Path, node: int = 9, **keys: Any) -> dict[str, Any]:
    bus = {"interface": "virtual", "channel": name}
    return {
        "buses": {"can0": bus},
        "nodes": {"io": {"bus": "can0", "node": node, "eds": str(eds), **keys}},
    }


def durand_objects() -> Any:
    import durand

    kind = durand.DatatypeEnum
    od = durand.object_dictionary.ObjectDictionary()
    od[0x2000] = durand.Variable(kind.UNSIGNED32, "rw", 7, name="Serial speed")
    od[0x2001] = durand.Variable(kind.VISIBLE_STRING, "rw", b"a name", name="Device label")
    od[0x2002] = durand.Variable(kind.UNSIGNED8, "ro", 3, name="Hardware")
    od[0x2003] = durand.Variable(kind.INTEGER16, "rw", 0, minimum=-5, maximum=5, name="Trim")
    od[0x2004] = durand.Variable(kind.REAL32, "rw", 1.5, name="Gain")
    record = durand.Record(name="Input filter")
    record[1] = durand.Variable(kind.BOOLEAN, "rw", value=False, name="On")
    record[2] = durand.Variable(kind.UNSIGNED64, "rw", 2, name="Count (total)")
    od[0x2010] = record
    return od


@asynccontextmanager
async def durand(tmp_path: Path, **keys: Any) -> AsyncGenerator[Rig]:
    """Run a node of durand's, by the EDS that it writes itself."""
    import durand as library

    name = channel()
    with durand_network(name) as network:
        node = library.MinimalNode(network, 9, durand_objects())
        eds = tmp_path / "io.eds"
        eds.write_text(node.eds.content)
        async with opened(table(name, eds, **keys)) as rig:
            yield rig


async def test_durands_dictionary_becomes_parameters_by_the_eds_it_writes(tmp_path: Path) -> None:
    async with durand(tmp_path) as rig:
        shown = sorted(name for name in rig.host.resources if name.startswith("param/"))
        assert shown == [
            "param/io/device_label",
            "param/io/gain",
            "param/io/hardware",
            "param/io/input_filter/count_total",
            "param/io/input_filter/on",
            "param/io/serial_speed",
            "param/io/trim",
        ]
        assert rig.host.resources["param/io/hardware"].operations == (
            Operation.READ | Operation.SUBSCRIBE
        )
        schema = value_type(rig.host.resources["param/io/trim"].value).schema
        assert (schema["minimum"], schema["maximum"]) == (-5, 5)
        assert rig.host.resources["param/io/trim"].meta["index"] == "0x2003"


@pytest.mark.parametrize(
    ("name", "was", "value"),
    [
        ("serial_speed", 7, 0xDEADBEEF),
        ("device_label", "a name", "a name that needs several segments"),
        ("trim", 0, -5),
        ("gain", 1.5, -0.25),
        ("input_filter/on", False, True),
        ("input_filter/count_total", 2, 2**64 - 1),
    ],
)
async def test_a_parameter_of_durand_is_read_written_and_read_back(
    tmp_path: Path, name: str, was: Any, value: Any
) -> None:
    async with durand(tmp_path) as rig:
        assert await rig.backend.read(f"param/io/{name}") == was
        assert await rig.write(f"param/io/{name}", value) == value
        assert await rig.backend.read(f"param/io/{name}") == value


async def test_only_the_objects_that_are_named_are_shown(tmp_path: Path) -> None:
    async with durand(tmp_path, objects=["0x1018", "0x2002-0x2003"]) as rig:
        shown = sorted(name for name in rig.host.resources if name.startswith("param/"))
        assert [name for name in shown if "identity" not in name] == [
            "param/io/hardware",
            "param/io/trim",
        ]
        assert await rig.backend.read("param/io/identity_object/vendor_id") == 0


async def test_over_the_gateway_bounds_and_rights_are_kept(tmp_path: Path) -> None:
    import durand as library

    name = channel()
    with durand_network(name) as network:
        node = library.MinimalNode(network, 9, durand_objects())
        eds = tmp_path / "io.eds"
        eds.write_text(node.eds.content)
        kind = next(iter(rcp_can.rcp_backends()))
        async with serve_backend(kind, table(name, eds)) as served:
            client = served.client(OPERATOR)

            async def ask(operation: str, path: str, body: Any = None) -> Any:
                found = f"/tenant/t/param/io/{path}"
                return await client.request(operation, found, body=body, within=60.0)

            assert (await ask("write", "trim", 4))["body"] == 4
            assert (await ask("read", "trim"))["body"] == 4
            refused = await ask("write", "trim", 6)
            assert refused["error"]["code"] == "out_of_range", refused
            refused = await ask("write", "hardware", 4)
            assert refused["error"]["code"] == "unsupported_operation", refused
            viewer = served.client(VIEWER)
            refused = await viewer.request("write", "/tenant/t/param/io/trim", body=1)
            assert refused["error"]["code"] == "forbidden", refused


@pytest.mark.filterwarnings("ignore:datetime.datetime.utcnow:DeprecationWarning")  # of canopen
async def test_a_local_node_of_canopen_is_known_by_the_eds_that_canopen_writes(
    tmp_path: Path,
) -> None:
    import canopen

    name, eds = channel(), tmp_path / "drive.eds"
    dictionary = make_dictionary(9)
    with eds.open("w") as file:
        canopen.export_od(dictionary, file, "eds")
    with local_node(name, 9, dictionary) as node:
        async with opened(table(name, eds, objects=["0x1018", "0x6000-0x6FFF"])) as rig:
            assert await rig.write("param/io/profile_velocity", 1234) == 1234
            assert node.sdo[0x6081].raw == 1234
            node.sdo[0x6081].raw = 4321
            assert await rig.backend.read("param/io/profile_velocity") == 4321
            assert await rig.backend.read("param/io/identity/vendor") == 0x1CA
            async with rig.backend.watch("param/io/homing_method", None):
                await rig.host.until(lambda: rig.host.events("param/io/homing_method") == [0])


@pytest.mark.filterwarnings("ignore:datetime.datetime.utcnow:DeprecationWarning")  # of canopen
async def test_what_moves_a_drive_is_shown_and_cannot_be_written(tmp_path: Path) -> None:
    import canopen

    eds = tmp_path / "drive.eds"
    with eds.open("w") as file:
        canopen.export_od(make_dictionary(5), file, "eds")
    nodes = {"nodes": {"raw": {"bus": "can0", "node": 5, "eds": str(eds)}}}
    async with motor("cia402", config=nodes) as rig:
        for name in ("controlword", "mode", "target_velocity", "target_position", "target_torque"):
            offered = rig.host.resources[f"param/raw/{name}"].operations
            assert offered is not None
            assert not offered & Operation.WRITE
        # One SDO server, two who ask it at once: neither is told of a second master.
        await asyncio.gather(
            rig.enable(), *(rig.backend.read("param/raw/profile_velocity") for _ in range(20))
        )
        assert rig.faults() == []
        assert rig.axis.state == "enabled"


async def test_a_node_that_refuses_or_is_silent_is_told(tmp_path: Path) -> None:
    async with durand(tmp_path) as rig:
        eds = tmp_path / "io.eds"
        text = eds.read_text().replace("[2003]", "[2fff]")
        eds.write_text(text)
        async with opened(table("nobody-" + channel(), eds)) as silent:
            with pytest.raises(DeviceTimeout, match="node 9 did not respond"):
                await silent.backend.read("param/io/trim")
        config = table(rig.backend.buses["can0"].config.channel, eds)
        async with opened(config) as other:
            with pytest.raises(DeviceRejected, match="the object does not exist"):
                await other.backend.read("param/io/trim")


async def test_its_heartbeats_and_emergencies_are_told_and_missed(tmp_path: Path) -> None:
    import durand as library

    name = channel()
    with durand_network(name) as network:
        node = library.MinimalNode(network, 9, durand_objects())
        eds = tmp_path / "io.eds"
        eds.write_text(node.eds.content)
        keys = {"heartbeat": 0.4, "objects": ["0x1017", "0x2000"]}
        async with opened(table(name, eds, **keys)) as rig:
            await rig.host.published_as("sensor/io/state", state="offline")
            assert "no heartbeat for 0.4 s" in (rig.host.reports[-1] or "")
            await rig.write("param/io/producer_heartbeat_time", 50)
            await rig.host.published_as("sensor/io/state", state="pre_operational")
            assert rig.host.reports[-1] is None
            node.emcy.set(0x4210, 1)
            event = await rig.host.published_as("event/io/emergency", code=0x4210, active=True)
            assert event.text == "device temperature (0x4210)"
            assert (await rig.backend.read("sensor/io/state")).emergencies == [event.text]
            node.emcy.set(0, 0)
            await rig.host.published_as("sensor/io/state", emergencies=[])
            await rig.write("param/io/producer_heartbeat_time", 0)
            await rig.host.published_as("sensor/io/state", state="offline")


@pytest.mark.parametrize(
    ("text", "keys", "words"),
    [
        (None, {}, "No such file"),
        ("rubbish", {}, "io.eds"),
        ("[DeviceInfo]\n", {}, "describes no objects"),
        (
            "[DeviceInfo]\n[2000]\nParameterName=A\nDataType=0x7\nAccessType=rw\n",
            {"objects": ["0x3000"]},
            "none of these objects",
        ),
    ],
)
async def test_a_node_that_cannot_be_is_a_configuration_error(
    tmp_path: Path, text: str | None, keys: dict[str, Any], words: str
) -> None:
    eds = tmp_path / "io.eds"
    if text is not None:
        eds.write_text(text)
    with pytest.raises(ConfigError, match=words):
        async with opened(table(channel(), eds, **keys)):
            pass


@given(st.data())
def test_every_type_of_the_dictionary_comes_back_as_it_went(data: st.DataObject) -> None:
    from canopen.objectdictionary import ODVariable

    variable = ODVariable("x", 0x2000, 0)
    kinds = [0x01, *range(0x02, 0x0B), *range(0x10, 0x17), *range(0x18, 0x1C)]
    variable.data_type = data.draw(st.sampled_from(kinds))
    variable.access_type = "rw"
    entry = entry_of(variable)
    assert entry is not None
    raw = data.draw(st.binary(min_size=8, max_size=8))
    try:
        value = entry.unpack(raw)
    except DeviceRejected:
        return
    value_type(entry.type).check(value)
    if value == value:  # noqa: PLR0124  # NaN has many faces
        assert entry.unpack(entry.pack(value)) == value
