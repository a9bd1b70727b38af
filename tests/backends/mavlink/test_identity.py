"""The inventory says what a vehicle is as the vehicle says it, in real AUTOPILOT_VERSION frames."""

from __future__ import annotations

from typing import Any

import pytest

from backends.mavlink.puppet import ARDUPILOT, PX4, Puppet, Station, station
from rcp_gateway.testing import eventually

_COMMIT = bytes.fromhex("1c8ab2a0da9db9b2")


class Versioned(Puppet):
    """Answers a request for AUTOPILOT_VERSION, if it has one."""

    def __init__(self, autopilot: int = ARDUPILOT, **version: Any) -> None:
        super().__init__(autopilot=autopilot)
        self.version: dict[str, Any] | None = version

    def request(self, number: int) -> int:
        if number != 148:
            return super().request(number)
        if self.version is None:
            return 3
        v = {"hash": b"", "vendor": 0, "product": 0, "uid": 0, "uid2": b"", **self.version}
        zeros, hashed = [0] * 8, list(v["hash"].ljust(8, b"\0"))
        self.send(
            "AUTOPILOT_VERSION", 0, v["software"], 0, 0, 0, hashed, zeros, zeros,
            v["vendor"], v["product"], v["uid"], list(v["uid2"].ljust(18, b"\0")),
        )  # fmt: skip
        return 0


async def listed(found: Station) -> dict[str, Any]:
    (robot,) = (await found.client.request("read", "/system/robots"))["body"]
    return robot


async def until_firmware(found: Station, text: str) -> dict[str, Any]:
    async def so() -> bool:
        return (await listed(found)).get("firmware") == text

    await eventually(so, f"the firmware is {text}", 20.0)
    return await listed(found)


async def test_ardupilot_tells_its_release_and_the_number_of_its_board() -> None:
    puppet = Versioned(software=0x040507FF, hash=b"2a3dc4b7", uid2=bytes.fromhex("0038001d5110"))
    async with station(puppet) as found:
        robot = await until_firmware(found, "ArduPilot 4.5.7 (2a3dc4b7)")
        assert robot["serial"] == "0038001d5110"
        assert not {"vendor", "model"} & robot.keys()


async def test_px4_tells_the_board_and_its_hash_as_a_number() -> None:
    ids = {"vendor": 0x26AC, "product": 0x0011, "uid": 0x3031313233343536}
    puppet = Versioned(PX4, software=0x011000C0, hash=_COMMIT[::-1], **ids)
    async with station(puppet) as found:
        robot = await until_firmware(found, "PX4 1.16.0-rc (1c8ab2a0)")
        assert (robot["vendor"], robot["model"]) == ("0x26ac", "0x0011")
        assert robot["serial"] == "3031313233343536"


@pytest.mark.parametrize(
    ("software", "hashed", "text"),
    [
        (0x04070000, b"70746572", "ArduPilot 4.7.0-dev (70746572)"),
        (0x04060180, b"", "ArduPilot 4.6.1-beta"),
        (0x04060041, b"\xff\xfe\x00\x01", "ArduPilot 4.6.0-alpha"),
        (0, b"", "ArduPilot"),
    ],
)
async def test_a_version_is_written_with_its_type(software: int, hashed: bytes, text: str) -> None:
    async with station(Versioned(software=software, hash=hashed)) as found:
        await eventually(lambda: _knows(found), "its version has come")
        await until_firmware(found, text)


async def test_a_vehicle_without_a_version_is_known_by_its_heartbeat() -> None:
    puppet = Versioned()
    puppet.version = None
    async with station(puppet) as found:
        robot = await listed(found)
        assert (robot["kind"], robot["firmware"]) == ("copter", "ArduPilot")
        assert (await found.read("sensor/vehicle"))["kind"] == "copter"


async def test_a_vehicle_that_has_rebooted_is_asked_again() -> None:
    puppet = Versioned(software=0x040507FF)
    async with station(puppet) as found:
        await until_firmware(found, "ArduPilot 4.5.7")
        puppet.version = {"software": 0x040603FF}
        puppet.booted += 90.0  # its clock starts anew
        await until_firmware(found, "ArduPilot 4.6.3")


async def _knows(found: Station) -> bool:
    return "AUTOPILOT_VERSION" in found.robot.vehicle.latest
