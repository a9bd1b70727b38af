"""The power of several motors: one that cannot be reached leaves no other on."""

from __future__ import annotations

import asyncio

import can
import pytest

from backends.can.rig import Node, channel, opened
from rcp_can.sim import Bench, make_twin
from rcp_kernel.errors import AdapterUnavailable


async def test_a_group_is_switched_off_as_far_as_it_can_be_reached() -> None:
    names = {"a": channel(), "b": channel()}
    twins = {name: make_twin("odrive", 1) for name in names}
    slow = {"timeout": 5.0, "feedback_timeout": 5.0}
    config = {
        "buses": {
            name: {"interface": "virtual", "channel": line, "restart": 30.0}
            for name, line in names.items()
        },
        "motors": {name: {"bus": name, "profile": "odrive", "node": 1, **slow} for name in names},
        "joint_groups": {"arm": {"joints": list(names)}},
    }
    lines = [can.Bus(line, "virtual", ignore_config=True) for line in names.values()]
    with Bench(lines[0], [twins["a"]]), Bench(lines[1], [twins["b"]]):
        async with opened(config) as rig:
            await rig.ran("service/arm/enable")
            assert twins["b"].enabled
            with Node(names["a"]) as node:
                node.bus_off()
            await rig.host.until(lambda: not rig.backend.buses["a"].up)
            twins["b"].deaf = True
            switching = asyncio.ensure_future(rig.ran("service/arm/disable"))
            await asyncio.sleep(0.1)
            twins["b"].deaf = False  # the first request was lost
            with pytest.raises(AdapterUnavailable):
                await switching
            assert not twins["b"].enabled
