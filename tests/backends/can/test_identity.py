"""What a CiA 402 drive says of itself: objects of the real canopen stack, read by SDO."""

from __future__ import annotations

from typing import Any

import msgspec
from canopen import objectdictionary as od

from backends.can.durand_drive import durand_drive
from backends.can.rig import Motor, RecordingHost, channel, motor, opened
from rcp_can.config import CanConfig
from rcp_can.drive import Identity
from rcp_can.facts import Facts
from rcp_kernel.spi import RobotFacts

_TEXTS = {0x1008: "Servo ST-8\0", 0x1009: "C", 0x100A: "v2.7.1 \x1b[31m(2024)"}


def facts(rig: Any) -> RobotFacts:
    return rig.host.facts[None]


async def rebooted(rig: Motor, **change: Any) -> None:
    """Give its dictionary other objects, and boot it."""

    def boot() -> None:
        twin: Any = rig.twin
        dictionary = twin.local.object_dictionary
        for index, text in change.get("texts", {}).items():
            entry = od.ODVariable("Text", index)
            entry.data_type, entry.access_type, entry.default = od.VISIBLE_STRING, "const", text
            dictionary.add_object(entry)
        for sub in change.get("without", ()):
            del dictionary[0x1018].subindices[sub]
        twin.boot()

    await rig.ordered(boot)


async def test_the_identity_object_tells_what_a_drive_is() -> None:
    async with motor("cia402") as rig:
        assert facts(rig) == RobotFacts(
            kind="motor",
            vendor="0x1CA",
            model="product 0x192",
            firmware="revision 1.2",
            serial="5",
        )


async def test_its_own_names_are_read_after_each_boot() -> None:
    async with motor("cia402") as rig:
        await rebooted(rig, texts=_TEXTS)
        await rig.until(lambda: facts(rig).model == "Servo ST-8, hardware C")
        assert facts(rig).firmware == "v2.7.1 [31m(2024)"
        await rig.enable()  # and it is driven as before


async def test_of_the_identity_only_the_vendor_is_mandatory() -> None:
    async with motor("cia402") as rig:
        await rebooted(rig, without=(2, 3, 4))
        await rig.until(lambda: facts(rig) == RobotFacts(kind="motor", vendor="0x1CA"))
        await rig.enable()


async def test_a_drive_of_durand_says_what_its_library_says() -> None:
    name = channel()
    table = {"bus": "can0", "profile": "cia402", "node": 6, "timeout": 1.0}
    bus = {"interface": "virtual", "channel": name}
    with durand_drive(name, 6) as drive:
        for sub, value in ((1, 0x2A), (3, 0x30007), (4, 4711)):
            drive.od.write(0x1018, sub, value)
        drive.od.write(0x1008, 0, b"Axis of a scheduler")
        async with opened({"buses": {"can0": bus}, "motors": {"m": table}, "grace": 8.0}) as rig:
            told = facts(rig)
            assert (told.vendor, told.model) == ("0x2A", "Axis of a scheduler")
            assert (told.firmware, told.serial) == ("revision 3.7", "4711")
            assert rig.host.reports == []


async def test_a_drive_that_ignores_what_it_does_not_have_is_driven() -> None:
    async with motor("cia402") as rig:
        take, asked = rig.twin.take, []

        def ignore(message: Any) -> None:
            index = int.from_bytes(message.data[1:3], "little")
            read = message.arbitration_id == 0x605 and message.data[0] == 0x40
            if read and index in _TEXTS:
                asked.append(index)
            else:
                take(message)

        rig.twin.take = ignore
        await rig.ordered(rig.twin.boot)
        await rig.until(lambda: asked and rig.axis.configured)
        assert asked == [0x1008]
        assert facts(rig).serial == "5"
        await rig.enable()


def test_drives_stand_for_the_robot_only_where_they_agree() -> None:
    host = RecordingHost()
    table: Any = {"bus": "can0", "profile": "cia402", "node": 1}
    config = msgspec.convert(
        {
            "buses": {"can0": {"interface": "virtual", "channel": "x"}},
            "motors": {"left": table, "right": {**table, "node": 2}},
        },
        CanConfig,
    )
    told = Facts(config, host)  # pyright: ignore[reportArgumentType] - a host that only records
    told.report("left", Identity("0x1CA", "ST-8", "2.7", "11"))
    assert host.facts[None] == RobotFacts(kind="motor")
    told.report("right", Identity("0x1CA", "ST-8", "2.8", "12"))
    assert host.facts[None] == RobotFacts(kind="motor", vendor="0x1CA", model="ST-8")
