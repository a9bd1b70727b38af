"""Peers that are not ours set up the twins that we set up: both must mean the same settings."""

from __future__ import annotations

import asyncio
import struct
import warnings
from typing import Any

import anyio
import can
import pytest

from backends.can.rig import motor
from backends.can.test_peers import until


async def test_the_official_moteus_library_reads_what_we_wrote_and_we_what_it_wrote() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import moteus

    async with motor("moteus", commissioning=True, options={"source": 3}) as rig:
        device = moteus.PythonCan(interface="virtual", channel=rig.channel)
        drive = moteus.Controller(id=1, transport=device)
        stream = moteus.Stream(drive, use_flow_control=False)
        try:
            with anyio.fail_after(60):
                await rig.ran("action/m/load_settings", {"text": "servo.max_current_A 12.5"})
                theirs = await stream.command(b"conf enumerate")
                ours = await rig.ran("service/m/dump_settings")
                assert ours["text"].encode() == theirs
                assert b"servo.max_current_A 12.500000\n" in theirs
                await stream.command(b"conf set servopos.position_min -0.25")
                with pytest.raises(moteus.CommandError):
                    await stream.command(b"conf set no.such 1")
                ours = await rig.ran("service/m/dump_settings")
                assert "servopos.position_min -0.250000\n" in ours["text"]
                await rig.ran("service/m/set_node", {"node": 9})
                moved = moteus.Controller(id=9, transport=device)
                found: Any = await moved.custom_query(
                    {moteus.Register.FIRMWARE_VERSION: moteus.INT32}
                )
                assert found.values[moteus.Register.FIRMWARE_VERSION] == 0x010A
                answer = await moteus.Stream(moved, use_flow_control=False).command(
                    b"conf get id.id", allow_any_response=True
                )
                assert answer == b"9"
        finally:
            device.close()


async def test_damiao_motor_reads_what_we_wrote_and_we_what_it_stored() -> None:
    from damiao_motor import DaMiaoController
    from damiao_motor.core.motor import REGISTER_TABLE

    from rcp_can.profiles.damiao_registers import REGISTERS

    for number, ours in REGISTERS.items():
        theirs = REGISTER_TABLE[number]
        assert theirs.variable == ours.name
        assert {"float": "f", "uint32": "I"}[theirs.data_type] == ours.code
        assert ours.low is None or theirs.access == "RW"
    async with motor("damiao", commissioning=True, options={"reply_id": 0x13}) as rig:
        await rig.ran("action/m/load_settings", {"text": "MAX_SPD 20.5\nOC_Value 0.8"})
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            control = DaMiaoController(channel=rig.channel, bustype="virtual")
        try:
            drive = control.add_motor(3, 0x13, "4310")
            assert await asyncio.to_thread(drive.get_register, 6) == pytest.approx(20.5)
            assert await asyncio.to_thread(drive.get_register, 3) == pytest.approx(0.8)
            drive.write_register(2, 90.0)
            drive.store_parameters()
            await asyncio.to_thread(until, lambda: rig.twin.stores == 1)
            await rig.ordered(rig.twin.boot)
            dumped = await rig.ran("service/m/dump_settings")
            assert "OT_Value 90\n" in dumped["text"]
            await rig.until(lambda: rig.axis.resting)
            await rig.ran("service/m/set_node", {"node": 5, "reply_id": 0x15})
            moved = control.add_motor(5, 0x15, "4310")
            assert await asyncio.to_thread(moved.get_register, 8) == 5
        finally:
            await asyncio.to_thread(control.shutdown)


async def test_cybergeardriver_reads_its_driver_parameters_and_gives_the_id_that_we_give() -> None:
    from CyberGearDriver import CyberGearMotor, CyberMotorMessage

    async with motor("cybergear", commissioning=True, watchdog=False) as rig:
        line = can.Bus(rig.channel, "virtual", ignore_config=True)
        sent: list[CyberMotorMessage] = []

        def send(message: CyberMotorMessage) -> None:
            sent.append(message)
            line.send(
                can.Message(
                    arbitration_id=message.arbitration_id, data=message.data, is_extended_id=True
                )
            )

        try:
            drive = CyberGearMotor(4, send)
            drive.set_parameter("run_mode", 2)  # the only ones that it names by these numbers
            await rig.until(lambda: rig.twin.parameters[0x7005][:1] == b"\2")
            dumped = await rig.ran("service/m/dump_settings")
            assert "run_mode 2\n" in dumped["text"]
            await rig.ran("action/m/load_settings", {"text": "limit_torque 7.5"})
            assert rig.twin.parameters[0x700B] == struct.pack("<f", 7.5)
            drive.change_motor_id(9)
            await rig.until(lambda: rig.twin.node == 9)
            drive.set_parameter("run_mode", 1)
            await rig.until(lambda: rig.twin.parameters[0x7005][:1] == b"\1")
        finally:
            line.shutdown()


async def test_the_frame_of_a_new_id_is_that_of_cybergeardriver() -> None:
    from CyberGearDriver import CyberGearMotor

    theirs: list[tuple[int, bytes]] = []
    peer = CyberGearMotor(
        4, lambda each: theirs.append((each.arbitration_id, bytes(each.data))), host_id=0xFD
    )
    peer.change_motor_id(9)
    async with motor("cybergear", commissioning=True) as rig:
        with can.Bus(rig.channel, "virtual", ignore_config=True) as line:
            await rig.ran("service/m/set_node", {"node": 9})
            ours: list[tuple[int, bytes]] = []
            while (message := line.recv(0.0)) is not None:
                if message.arbitration_id >> 24 == 7:
                    ours.append((message.arbitration_id, bytes(message.data)))
        assert ours == theirs
