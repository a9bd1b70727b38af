"""A vehicle that tells of itself: where its metadata are, and whether they arrived whole."""

from __future__ import annotations

import json
import lzma
import struct
from collections.abc import Callable
from typing import Any

import pytest
from pymavlink.generator.mavcrc import x25crc

from backends.mavlink.fileserver import FileServer
from backends.mavlink.puppet import PX4, Puppet, station
from backends.mavlink.test_metadata import JSON, schema_of
from rcp_mavlink.files import checksum

GENERAL, PARAMETERS = "/etc/extras/component_general.json.xz", "/etc/extras/parameters.json.xz"
KNOWN = json.loads(JSON)
KNOWN["parameters"][0] |= {"group": "Multicopter Position Control", "default": 5.0}
PACKED = lzma.compress(json.dumps(KNOWN).encode())


def general(uri: str = f"mftp://[;comp=1]{PARAMETERS}", **more: Any) -> bytes:
    entry = {"type": 1, "uri": uri, "fileCrc": checksum(PACKED)} | more
    types = [{"type": 4, "uri": "mftp:/etc/extras/events.json.xz"}, entry]
    return lzma.compress(json.dumps({"version": 1, "metadataTypes": types}).encode())


class Px4(Puppet):
    """It tells of its files by COMPONENT_METADATA, or by the older message."""

    def __init__(self, files: dict[str, bytes], number: int = 397) -> None:
        super().__init__(autopilot=PX4)
        self.number, self.asked = number, 0
        self.crc = checksum(files.get(GENERAL, b""))
        self.params = {"MPC_XY_CRUISE": (5.0, 9), "COM_RC_IN_MODE": (3, 6)}
        self.on["FILE_TRANSFER_PROTOCOL"] = FileServer(self.send, files)

    def request(self, number: int) -> int:
        if number != self.number:
            return super().request(number)
        self.asked += 1
        uri = f"mftp://{GENERAL}".encode().ljust(100, b"\0")
        if number == 397:
            self._frame(number, 182, struct.pack("<II100s", 1, self.crc, uri))
        else:
            self._frame(number, 0, struct.pack("<III100s100s", 1, self.crc, 0, uri, b""))
        return 0

    def _frame(self, number: int, extra: int, payload: bytes) -> None:
        """Send a message that pymavlink does not know."""
        payload = payload.rstrip(b"\0")
        body = bytes((len(payload), 0, 0, 0, 1, 1)) + number.to_bytes(3, "little") + payload
        crc = x25crc(body)
        crc.accumulate(bytes((extra,)))
        self.write(b"\xfd" + body + crc.crc.to_bytes(2, "little"))


@pytest.mark.parametrize("number", [397, 395])
async def test_parameters_are_described_by_the_vehicle_itself(number: int) -> None:
    puppet = Px4({GENERAL: general(), PARAMETERS: PACKED}, number)
    async with station(puppet, parameters="vehicle") as found:
        entry = await schema_of(found, "MPC_XY_CRUISE")
        assert entry["description"] == "Cruise speed."
        text = json.dumps(entry)
        assert '"unit": "m/s"' in text
        assert '"range": [3.0, 20.0]' in text
        assert '"group": "Multicopter Position Control"' in text
        assert '"default": 5.0' in text


async def test_answers_that_are_lost_are_asked_for_again() -> None:
    puppet = Px4({GENERAL: general(), PARAMETERS: PACKED})
    server = puppet.on["FILE_TRANSFER_PROTOCOL"]
    assert isinstance(server, FileServer)
    server.lose = lambda answer: answer % 3 == 1
    async with station(puppet, parameters="vehicle") as found:
        assert (await schema_of(found, "MPC_XY_CRUISE"))["description"] == "Cruise speed."


def _damaged(data: bytes) -> bytes:
    return data[:40] + bytes((data[40] ^ 1,)) + data[41:]


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda f: f.update({PARAMETERS: _damaged(PACKED)}), "is damaged"),
        (lambda f: f.pop(PARAMETERS), "parameters.json.xz"),
        (lambda f: f.update({GENERAL: lzma.compress(b"[]")}), "is no list of metadata"),
        (lambda f: f.update({GENERAL: b"\xfd7zXZ\0" + bytes(40)}), "a packed file is damaged"),
        (lambda f: f.update({GENERAL: general("https://px4.io/p.json")}), "does not read"),
        (lambda f: f.update({GENERAL: general("mftp://[;comp=9]/a")}), "does not read"),
        (lambda f: f.update({GENERAL: general(type=3)}), "no metadata of its parameters"),
    ],
)
async def test_a_file_that_is_not_whole_leaves_the_texts_that_are_built_in(
    change: Callable[[dict[str, bytes]], object], why: str, capsys: Any
) -> None:
    files = {GENERAL: general(), PARAMETERS: PACKED}
    change(files)
    async with station(Px4(files), parameters="vehicle") as found:
        entry = await schema_of(found, "MPC_XY_CRUISE")
        assert entry["description"] == "Parameter MPC_XY_CRUISE of the autopilot."
    shown = capsys.readouterr()
    assert "no_parameter_metadata" in shown.out + shown.err
    assert why in shown.out + shown.err


async def test_a_second_address_is_tried_and_a_vehicle_without_any_is_told() -> None:
    far = general("https://px4.io/p.json", uriFallback=f"mftp:{PARAMETERS}")
    puppet = Px4({GENERAL: far, PARAMETERS: PACKED})
    async with station(puppet, parameters="vehicle") as found:
        assert (await schema_of(found, "MPC_XY_CRUISE"))["description"] == "Cruise speed."
    plain = Puppet(autopilot=PX4)
    plain.params = {"MPC_XY_CRUISE": (5.0, 9)}
    async with station(plain, parameters="vehicle") as found:
        entry = await schema_of(found, "MPC_XY_CRUISE")
        assert entry["description"] == "Parameter MPC_XY_CRUISE of the autopilot."
