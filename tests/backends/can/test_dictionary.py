"""The object dictionary of a node as a file, which canopen reads and writes as well."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import canopen
import pytest
from canopen.objectdictionary.eds import import_eds

from backends.can.peers import local_node
from backends.can.rig import channel, opened
from backends.can.test_nodes import durand, table
from rcp_can.sim.cia402_objects import make_dictionary
from rcp_kernel.errors import DeviceTimeout, InvalidValue


async def test_a_dump_of_durand_is_a_dcf_that_canopen_reads(tmp_path: Path) -> None:
    async with durand(tmp_path) as rig:
        await rig.write("param/io/trim", -3)
        await rig.write("param/io/gain", -0.25)
        found = await rig.ran("service/io/dump")
        read: Any = import_eds(io.StringIO(found["text"]), 9)
        assert read[0x2003].value == -3
        assert read[0x2004].value == -0.25
        assert read[0x2001].value == "a name"
        assert read[0x2010][2].value == 2
        assert read.node_id == 9
        assert found["objects"] > 8


async def test_a_node_is_compared_with_a_file_object_by_object(tmp_path: Path) -> None:
    async with durand(tmp_path) as rig:
        text = (await rig.ran("service/io/dump"))["text"]
        same = await rig.ran("service/io/compare", {"text": text})
        assert same["differences"] == []
        assert same["compared"] > 5
        await rig.write("param/io/trim", 4)
        await rig.write("param/io/input_filter/on", True)
        found = (await rig.ran("service/io/compare", {"text": text}))["differences"]
        assert [(each["object"], each["file"], each["node"]) for each in found] == [
            ("0x2003:00", "0", "4"),
            ("0x2010:01", "0", "1"),
        ]
        more = text + "\n[2999]\nParameterName=Other\nObjectType=0x7\nDataType=0x5\n"
        more += "AccessType=rw\nParameterValue=1\n"
        assert (await rig.ran("service/io/compare", {"text": more}))["unknown"] == ["0x2999:00"]


async def test_a_dcf_of_canopen_is_compared_with_a_drive_of_canopen(tmp_path: Path) -> None:
    eds, dcf = str(tmp_path / "drive.eds"), str(tmp_path / "drive.dcf")
    canopen.export_od(make_dictionary(9), eds)
    wanted = make_dictionary(9)
    wanted[0x6085].value, wanted[0x6065].value = 700, 100
    wanted[0x6041].value = 0x1234  # it only tells, and is not compared
    canopen.export_od(wanted, dcf)
    name = channel()
    with local_node(name, 9, make_dictionary(9)) as node:
        node.sdo[0x6065].raw = 100
        async with opened(table(name, Path(eds))) as rig:
            text = Path(dcf).read_text(encoding="utf-8")  # noqa: ASYNC240  # a small file of the test
            found = await rig.ran("service/io/compare", {"text": text})
            assert found["compared"] == 2
            assert [each["object"] for each in found["differences"]] == ["0x6085:00"]
            assert (found["differences"][0]["file"], found["differences"][0]["node"]) == (
                "700",
                "0",
            )


@pytest.mark.parametrize("text", ["", "nothing", "[1017]\nParameterName=x\n", "\0"])
async def test_what_is_not_a_file_with_values_is_refused(tmp_path: Path, text: str) -> None:
    async with durand(tmp_path) as rig:
        with pytest.raises(InvalidValue) as caught:
            await rig.ran("service/io/compare", {"text": text})
        assert ".dcf" in str(caught.value.remedy)


async def test_a_node_that_does_not_answer_is_told(tmp_path: Path) -> None:
    eds = str(tmp_path / "drive.eds")
    canopen.export_od(make_dictionary(9), eds)
    async with opened(table(channel(), Path(eds))) as rig:
        with pytest.raises(DeviceTimeout, match="did not respond"):
            await rig.ran("service/io/dump")
