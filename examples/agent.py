"""An agent that knows one sentence: take a picture of the box from the drone, bring the rover beside it.

A model would decide what these few rules decide, from the same results of the same tools. It knows no
path, no place and no schema before it starts. At the end it prints how many calls it made, and about
how many tokens a model would have read: the list of tools, every result, and every picture.

    rcpd demo
    python examples/agent.py --token rcp_op_…
"""

from __future__ import annotations

import argparse
import asyncio
import base64
import json
import math
import os
import struct
from pathlib import Path
from typing import Any

import httpx2
from mcp import Client, types
from mcp.client.streamable_http import streamable_http_client

_PER_TOKEN = 4  # bytes of text, as `rcpctl mcp tools --cost` counts
_PIXELS = 750  # of a picture, per token
_DEGREE = 111_320.0  # m
_HEIGHT = 8.0  # m above the ground, for the picture
_BESIDE = 1.5  # m
_DOWN = -1.326  # rad: from _HEIGHT, at what is _AWAY ahead
_AWAY = 2.0  # m


class Agent:
    """Calls tools, and counts what it reads."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self.pictures: list[bytes] = []
        self.calls = 0
        self.tokens = 0

    async def look_around(self) -> set[str]:
        """Read the list of tools and the server's instructions."""
        listed = await self._client.list_tools()
        for tool in listed.tools:
            self._read(tool.model_dump_json(by_alias=True, exclude_none=True))
        self._read(self._client.instructions or "")
        return {tool.name for tool in listed.tools}

    async def call(self, tool: str, **arguments: Any) -> Any:
        """Call a tool; return its structured result."""
        self.calls += 1
        result = await self._client.call_tool(tool, arguments)
        assert isinstance(result, types.CallToolResult)
        for block in result.content:
            if isinstance(block, types.TextContent):
                self._read(block.text)
            elif isinstance(block, types.ImageContent):
                self.pictures.append(base64.b64decode(block.data))
                width, height = _dimensions(self.pictures[-1])
                self.tokens += -(-width * height // _PIXELS)
            else:
                self._read(block.model_dump_json(by_alias=True, exclude_none=True))
        found: Any = result.structured_content
        print(f"{self.calls:2}. {tool} {json.dumps(arguments)}")
        if result.is_error:
            raise SystemExit(f"    {found['error']['message']}\n    {found['error']['remedy']}")
        return found

    def _read(self, text: str) -> None:
        self.tokens += -(-len(text.encode()) // _PER_TOKEN)

    async def finish(self, done: Any) -> Any:
        """Wait for the end of a command."""
        while done["status"] == "in_progress":
            command = (await self.call("status", command=done["command"], wait=60))["command"]
            if command["status"] in ("completed", "failed", "rejected", "cancelled"):
                last = command["history"][-1]
                return {"status": command["status"], "result": last.get("body")}
        return done


def _dimensions(data: bytes) -> tuple[int, int]:
    """Return the size of a PNG or JPEG in pixels."""
    if data.startswith(b"\x89PNG"):
        return struct.unpack(">II", data[16:24])
    at = 2
    while not 0xC0 <= data[at + 1] <= 0xC3:  # the frame's header has the size
        at += 2 + struct.unpack(">H", data[at + 2 : at + 4])[0]
    height, width = struct.unpack(">HH", data[at + 5 : at + 9])
    return width, height


def _distance(a: dict[str, float], b: dict[str, float]) -> float:
    north = (a["latitude"] - b["latitude"]) * _DEGREE
    east = (a["longitude"] - b["longitude"]) * _DEGREE * math.cos(math.radians(a["latitude"]))
    return math.hypot(north, east)


async def task(agent: Agent) -> None:
    """Do what the sentence says."""
    tools = await agent.look_around()
    assert {"robots", "discover", "read", "execute", "plan", "status"} <= tools

    # Which robots are there, and where is the box?
    robots = (await agent.call("robots"))["robots"]
    (drone,) = [one["path"] for one in robots if "aerial" in str(one["profiles"])]
    rovers = [one["path"] for one in robots if one["kind"] == "rover"]
    places = (await agent.call("read", path="/system/places"))["values"][0]["value"]
    (box,) = [one for one in places if "box" in f"{one['name']} {one['description']}"]

    # Which rover is nearest to it?
    poses = [f"{one}/sensor/pose" for one in rovers]
    known = await agent.call("read", path=poses, frame="earth", fields=["position"])
    near = {
        one["path"].removesuffix("/sensor/pose"): _distance(
            box["position"], one["value"]["position"]
        )
        for one in known["values"]
        if "value" in one
    }
    rover = min(near, key=lambda one: near[one])
    print(f"    the box is {near[rover]:.0f} m from {rover}")

    # What can the drone do? Then all of it as one plan, which is checked before it takes off.
    found = await agent.call("discover", path=f"{drone}/action/**")
    actions = {one["path"].rpartition("/")[2]: one["path"] for one in found["resources"]}
    goal = {"position": {"place": box["name"], "distance": _AWAY, "z": _HEIGHT}}
    lines = [
        f"execute {actions['arm']}",
        f"execute {actions['takeoff']} {json.dumps({'altitude': _HEIGHT})}",
        f"execute {actions['move_to']} {json.dumps(goal)}",
        f"execute {actions['gimbal']} {json.dumps({'pitch': _DOWN})}",
        f"execute {actions['photo']}",
    ]
    flown = await agent.finish(await agent.call("plan", plan="\n".join(lines)))
    photo = flown["result"]["steps"][-1]["result"]
    away = _distance(box["position"], photo)
    print(f"    picture {photo['number']}, taken {away:.1f} m from it: {photo['image']['data']}")

    # Bring the rover; if it would be refused, nothing moves.
    there = {"position": {"place": box["name"], "distance": _BESIDE}}
    move = {"path": f"{rover}/action/move_to", "input": there}
    await agent.call("execute", **move, dry_run=True)
    arrived = await agent.finish(await agent.call("execute", **move))
    assert arrived["status"] == "completed", arrived

    # See for itself that the box is there.
    senses = [f"{rover}/sensor/camera", f"{rover}/sensor/scan"]
    seen = await agent.call("read", path=senses, size=320)
    front = seen["values"][1]["summary"]["nearest_by_sector"]["front"]
    print(f"    the rover sees the box {front['m']} m in front of it")


async def main() -> None:
    """Connect and run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--url", default="http://127.0.0.1:8080")
    parser.add_argument("--picture", type=Path, help="file for the drone's picture")
    parser.add_argument("--token", default=os.environ.get("RCP_TOKEN"))
    given = parser.parse_args()
    headers = {"authorization": f"Bearer {given.token}"}
    async with (
        httpx2.AsyncClient(headers=headers, timeout=120.0) as http,
        Client(streamable_http_client(f"{given.url}/mcp", http_client=http)) as client,
    ):
        agent = Agent(client)
        await task(agent)
    if given.picture is not None:
        given.picture.write_bytes(agent.pictures[0])
    print(f"{agent.calls} calls, {agent.tokens} tokens")


if __name__ == "__main__":
    asyncio.run(main())
