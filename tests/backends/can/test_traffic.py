"""The analyser of a bus: who talks, how often, and whether anybody listens."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from backends.can.rig import Node, channel, motor, opened
from rcp_can.load import seconds_on_the_bus

PATH = "sensor/can/can0/traffic"


def line(**keys: Any) -> dict[str, Any]:
    bus = {"interface": "virtual", "channel": channel(), "statistics": 0.1, **keys}
    return {"buses": {"can0": bus}}


async def test_frames_are_counted_by_identifier_while_somebody_asks() -> None:
    config = line(bitrate=500_000, raw_send=True)
    async with opened(config) as rig:
        with Node(config["buses"]["can0"]["channel"]) as node:
            assert rig.backend.buses["can0"].taps == []
            async with rig.backend.watch(PATH, None):
                for _ in range(3):
                    node.send(0x123, bytes(8))
                node.send(0x18FF0001, b"\1")
                await rig.write("actuator/can/can0/frame", {"id": 0x77, "data": "AQ=="})
                seen: dict[tuple[int, bool], Any] = {}

                def all_seen() -> bool:
                    for value in rig.host.events(PATH):
                        for each in value.talkers:
                            seen[each.id, each.sent] = each
                    return {(0x123, False), (0x18FF0001, False), (0x77, True)} <= seen.keys()

                await rig.host.until(all_seen)
            assert rig.backend.buses["can0"].taps == []
            total = sum(
                each.frames
                for value in rig.host.events(PATH)
                for each in value.talkers
                if each.id == 0x123
            )
            assert total == 3
            assert seen[0x18FF0001, False].extended
            assert not seen[0x123, False].known
            assert seen[0x123, False].takers == []
            assert seen[0x77, True].known
            each = seen[0x123, False]
            one = seconds_on_the_bus(
                8, extended=False, fd=False, switched=False, bitrate=500_000, data_bitrate=500_000
            )
            assert each.load / each.rate == pytest.approx(one)
            busy = next(v for v in rig.host.events(PATH) if any(t.id == 0x123 for t in v.talkers))
            assert busy.unknown in (1, 2)
            assert busy.load == pytest.approx(sum(t.load for t in busy.talkers))


async def test_the_messages_of_a_motor_are_known_and_come_at_its_rate() -> None:
    async with motor("odrive", bus={"statistics": 0.5}) as rig:
        found = await rig.backend.read(PATH)
        by_id = {each.id: each for each in found.talkers if not each.sent}
        heartbeat, encoder = by_id[1 << 5 | 0x01], by_id[1 << 5 | 0x09]
        assert heartbeat.known
        assert heartbeat.takers == ["m"]
        assert encoder.known
        assert encoder.rate > heartbeat.rate > 0
        assert found.talkers[0].frames >= found.talkers[-1].frames
        assert found.unknown == 0
        assert found.load is None  # no bit rate is configured
        assert found.controller.state == "error_active"


async def test_errors_of_the_controller_are_told_with_the_traffic() -> None:
    config = line()
    async with opened(config) as rig:
        with Node(config["buses"]["can0"]["channel"]) as node:
            reading = asyncio.ensure_future(rig.backend.read(PATH))
            await asyncio.sleep(0)
            frame = bytes((0, 0x10, 0, 0, 0, 0, 130, 4))  # error passive, with both counters
            node.send(0x204, frame, is_error_frame=True, is_extended_id=False)
            found = await asyncio.wait_for(reading, 60)
        assert found.error_frames == 1
        assert found.controller.state == "error_passive"
        assert (found.controller.tx_errors, found.controller.rx_errors) == (130, 4)
