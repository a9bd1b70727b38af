"""The example of a fleet manager sends ten robots through a depot, and never two on one lane."""

from __future__ import annotations

import asyncio
import importlib.util
import itertools
import math
import sys
from pathlib import Path
from typing import Any

import pytest

from docs.pages import ROOT
from plugins.vda5050.broker import MOSQUITTO, broker
from rcp_gateway.testing import serve
from rcp_kernel.config.file import parse

pytestmark = [
    pytest.mark.anyio,
    pytest.mark.paired,
    pytest.mark.skipif(MOSQUITTO is None, reason="needs Mosquitto"),
]
FOLDER = ROOT / "examples" / "depot"
NEAREST = 1.5  # m between two robots: half a lane
ORDERS = 2


def master() -> Any:
    spec = importlib.util.spec_from_file_location("depot_master", FOLDER / "master.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


async def test_ten_robots_share_the_lanes_of_a_depot(tmp_path: Path) -> None:
    example = master()
    text = (FOLDER / "depot.toml").read_text(encoding="utf-8")
    async with broker(tmp_path) as port:
        text = text.replace("127.0.0.1:1883", f"127.0.0.1:{port}").replace(
            "port = 8080", "port = 0"
        )
        async with serve(parse(text, "test")) as served:
            client = served.client("a-key-of-an-example-only")
            nearest = math.inf
            managing = asyncio.create_task(example.manage("127.0.0.1", port, ORDERS))
            while not managing.done():
                await asyncio.wait({managing}, timeout=0.2)
                places = [await place(client, serial) for serial in example.ROBOTS]
                nearest = min(
                    nearest, *(math.dist(a, b) for a, b in itertools.combinations(places, 2))
                )
            await managing
    assert nearest > NEAREST


async def place(client: Any, tenant: str) -> tuple[float, float]:
    reply = await client.request("read", f"/tenant/{tenant}/sensor/pose")
    position = reply["body"]["position"]
    return position["x"], position["y"]
