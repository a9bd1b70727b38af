"""What autopilots publish of their parameters stands in the schemas, and holds nobody back."""

from __future__ import annotations

import json
import lzma
from pathlib import Path
from typing import Any

import pytest

from backends.mavlink.fileserver import FileServer
from backends.mavlink.puppet import PX4, Puppet, Station, station
from rcp_gateway.testing import eventually
from rcp_kernel.errors import ConfigError
from rcp_mavlink.described import checked
from rcp_mavlink.parameter_metadata import described

XML = b"""<?xml version="1.0" encoding="utf-8"?>
<paramfile>
 <vehicles><parameters name="ArduCopter">
  <param humanName="RTL Altitude" name="ArduCopter:RTL_ALT" documentation="The minimum altitude" user="Standard">
   <field name="Units">cm</field><field name="UnitText">centimeters</field>
   <field name="Range">200 300000</field><field name="RebootRequired">True</field>
  </param>
 </parameters></vehicles>
 <libraries><parameters name="FENCE">
  <param humanName="Action" name="FENCE_ACTION" documentation="What to do">
   <values><value code="0">Report Only</value><value code="1">RTL or Land</value></values>
  </param>
  <param humanName="Type" name="FENCE_TYPE" documentation="Which">
   <field name="Bitmask">0:Max altitude,1:Circle</field>
  </param>
 </parameters></libraries>
</paramfile>
"""
JSON = json.dumps(
    {
        "version": 1,
        "parameters": [
            {"name": "MPC_XY_CRUISE", "type": "Float", "shortDesc": "Cruise speed", "units": "m/s",
             "default": 5.0, "min": 3.0, "max": 20.0},
            {"name": "COM_RC_IN_MODE", "type": "Int32", "longDesc": "RC input\nmode.",
             "values": [{"value": 0, "description": "RC only"}]},
        ],
    }
).encode()  # fmt: skip


async def schema_of(found: Station, name: str) -> Any:
    async def there() -> bool:
        reply = await found.client.request("read", f"/tenant/t/param/{name}")
        return reply["status"] == "completed"

    await eventually(there, "the parameters are there")
    reply = await found.client.request(
        "discover", f"/tenant/t/param/{name}", body={"schemas": True}
    )
    (entry,) = reply["body"]["resources"]
    return entry


async def test_a_file_of_ardupilot_is_in_the_schemas(tmp_path: Path) -> None:
    path = tmp_path / "apm.pdef.xml"
    path.write_bytes(XML)
    puppet = Puppet()
    puppet.params = {"RTL_ALT": (100.0, 4), "FENCE_ACTION": (1.0, 2), "FENCE_TYPE": (3.0, 2)}
    async with station(puppet, parameters=str(path)) as found:
        entry = await schema_of(found, "RTL_ALT")
        text = json.dumps(entry)
        assert entry["description"] == "The minimum altitude."
        assert '"range": [200.0, 300000.0]' in text
        assert '"unit": "cm"' in text
        assert '"restart": true' in text
        assert await found.read("param/RTL_ALT") == 100, "out of the range it is read all the same"
        assert '"0": "Report Only"' in json.dumps(await schema_of(found, "FENCE_ACTION"))
        assert '"1": "Circle"' in json.dumps(await schema_of(found, "FENCE_TYPE"))


async def test_a_file_of_px4_is_read_from_on_board() -> None:
    puppet = Puppet(autopilot=PX4)
    puppet.params = {"MPC_XY_CRUISE": (5.0, 9), "COM_RC_IN_MODE": (0, 6)}
    files = {"/etc/extras/parameters.json.xz": lzma.compress(JSON)}
    puppet.on["FILE_TRANSFER_PROTOCOL"] = FileServer(puppet.send, files)
    async with station(puppet, parameters="ftp:/etc/extras/parameters.json.xz") as found:
        entry = await schema_of(found, "MPC_XY_CRUISE")
        assert entry["description"] == "Cruise speed."
        assert '"range": [3.0, 20.0]' in json.dumps(entry)
        assert '"default": 5.0' in json.dumps(entry)
        assert '"0": "RC only"' in json.dumps(await schema_of(found, "COM_RC_IN_MODE"))


@pytest.mark.parametrize(
    "data", [b"", b"<a/>", b"<paramfile>", b"{}", b"[1]", b"\xfd7zXZ\0nonsense", b"\x1f\x8bno"]
)
def test_what_is_neither_is_told(tmp_path: Path, data: bytes) -> None:
    with pytest.raises(ValueError, match="neither"):
        described(data)
    path = tmp_path / "file"
    path.write_bytes(data)
    with pytest.raises(ConfigError, match="`parameters`"):
        checked(str(path))
    with pytest.raises(ConfigError, match="`parameters`"):
        checked(str(tmp_path / "gone"))
