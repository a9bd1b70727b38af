"""A dialect of one's own: its messages are sensors, and what is wrong with it is told."""

from __future__ import annotations

import asyncio
import math
from pathlib import Path

import pytest

from backends.mavlink.puppet import Puppet, station
from rcp_gateway.testing import eventually
from rcp_kernel.errors import ConfigError
from rcp_mavlink.dialect import dialect

OWN = """<?xml version="1.0"?>
<mavlink>
  <include>common.xml</include>
  <include>beside.xml</include>
  <enums>
    <enum name="WINCH_STATE">
      <description>What a winch does.</description>
      <entry value="0" name="WINCH_STATE_RESTS"/>
      <entry value="1" name="WINCH_STATE_REELS"/>
    </enum>
  </enums>
  <messages>
    <message id="52000" name="WINCH">
      <description>State of the winch.</description>
      <field type="uint8_t" name="state" enum="WINCH_STATE">What it does.</field>
      <field type="int16_t" name="angle" units="cdeg">Of the drum.</field>
      <field type="uint16_t" name="length" units="cm">Let out; UINT16_MAX: unknown.</field>
    </message>
  </messages>
</mavlink>
"""
BESIDE = """<?xml version="1.0"?>
<mavlink>
  <messages>
    <message id="52001" name="HOOK">
      <description>The hook.</description>
      <field type="uint8_t" name="open">Whether it is open.</field>
    </message>
  </messages>
</mavlink>
"""


def written(folder: Path, text: str) -> str:
    (folder / "beside.xml").write_text(BESIDE)
    path = folder / "own.xml"
    path.write_text(text)
    return str(path)


async def test_messages_of_an_own_xml_are_sensors_and_nothing_waits_for_it(tmp_path: Path) -> None:
    path = written(tmp_path, OWN)
    slept: list[float] = []

    async def beating() -> None:
        loop = asyncio.get_running_loop()
        while True:
            before = loop.time()
            await asyncio.sleep(0.01)
            slept.append(loop.time() - before)

    module = (await asyncio.to_thread(dialect, path)).module
    puppet = Puppet(mav=module)
    puppet.also.append(lambda: puppet.send("WINCH", 1, 9000, 65535))
    beat = asyncio.create_task(beating())
    async with station(puppet, dialect=path, messages=["WINCH"]) as found:
        beat.cancel()
        assert max(slept) < sum(slept) / 2, "the loop went on while the file was read"
        id_ = await found.client.subscribe("/tenant/t/sensor/message/winch")
        value = (await found.client.update(id_, 10.0))["body"]
        assert value["state"] == "reels"
        assert math.isclose(value["angle"], math.pi / 2)
        assert value["length"] is None
        assert "HOOK" in found.served.life.backend.hub.dialect.by_name

        async def armed() -> bool:
            return (await found.read("sensor/armed")) is False

        await eventually(armed, "the rest is there too")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("no XML", "not a dialect"),
        ("<mavlink><messages>", "not a dialect"),
        (OWN.replace("uint8_t", "uint9_t"), "uint9_t"),
        (OWN.replace("beside.xml", "gone.xml"), "gone.xml"),
        (OWN.replace("52000", "0"), "duplicate"),
        (OWN.replace("  <include>common.xml</include>\n", ""), "include common.xml"),
    ],
)
def test_what_is_wrong_with_it_is_told(tmp_path: Path, text: str, told: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        dialect(path)
    message = str(caught.value)
    assert message.startswith("`dialect`: ")
    assert told in message
    assert path in message
    assert "Traceback" not in message


def test_a_file_that_is_not_there_and_a_name_that_is_none_are_told(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such file"):
        dialect(str(tmp_path / "gone.xml"))
    with pytest.raises(ConfigError, match="pymavlink has no 'gone'"):
        dialect("gone")
    with pytest.raises(ConfigError, match="include common"):
        dialect("minimal")
