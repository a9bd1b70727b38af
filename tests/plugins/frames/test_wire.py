"""`frame` on every transport and in every client, against a real `rcpd`."""

from __future__ import annotations

import asyncio
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

import rcp_client
from rcp_kernel.errors import InvalidValue
from serving import ROVER, serving

pytestmark = pytest.mark.anyio
TOKEN = "operator-operator"
POSE = "/tenant/alpha/sensor/pose"
ANCHOR = """
[features.frames.anchors."/tenant/alpha"]
latitude = 48.137154
longitude = 11.576124
altitude = 519.0
"""


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with serving(tmp_path_factory.mktemp("frames") / "rcpd.toml", ROVER + ANCHOR) as url:
        yield url


def is_on_earth(body: Any) -> bool:
    place = body["position"]
    return abs(place["latitude"] - 48.137154) < 1e-3 and abs(place["altitude"] - 519) < 0.1


async def test_a_client_reads_subscribes_and_commands_over_a_websocket(url: str) -> None:
    async with rcp_client.connect(url, token=TOKEN) as client:
        assert is_on_earth(await client.read(POSE, frame="earth"))
        async with client.subscribe(POSE, frame="earth", fields=["position"]) as updates:
            async with asyncio.timeout(60):
                body = (await anext(aiter(updates))).body
        assert list(body) == ["position"]
        assert is_on_earth(body)
        with pytest.raises(InvalidValue) as unknown:
            await client.read(POSE, frame="mars")
        assert "earth" in (unknown.value.details or {})["frames"]
        (found,) = await client.discover(POSE)
        assert {"earth", "map", "odom", "base_link"} <= set(found.frames)
        goal = {"position": {"x": 0.3, "y": 0.0}, "frame": "base_link"}
        went = await client.execute("/tenant/alpha/action/move_to", goal)
        assert went["error"] < 0.2


async def test_http_and_events_take_the_frame_as_a_parameter(url: str) -> None:
    headers = {"Authorization": f"Bearer {TOKEN}"}
    async with httpx.AsyncClient(base_url=url + "/rcp/v1", headers=headers) as http:
        reply = await http.get(f"context{POSE}", params={"frame": "earth"})
        assert is_on_earth(reply.json()["body"])
        plain = await http.get(f"context{POSE}")
        assert plain.json()["body"]["frame_id"] == "map"
        wrong = await http.get(f"context{POSE}", params={"frame": "mars"})
        assert (wrong.status_code, wrong.json()["error"]["code"]) == (422, "invalid_value")
        wanted = {"path": POSE, "frame": "earth", "count": "1"}
        async with http.stream("GET", "events", params=wanted, timeout=20) as events:
            async for line in events.aiter_lines():
                if line.startswith("data:") and (update := json.loads(line[5:])).get("body"):
                    assert is_on_earth(update["body"])
                    return
    raise AssertionError("no update came")


async def test_openapi_shows_that_a_goal_may_be_a_place_on_the_earth(url: str) -> None:
    headers = {"Authorization": f"Bearer {TOKEN}"}
    async with httpx.AsyncClient(base_url=url + "/rcp/v1", headers=headers) as http:
        found = (await http.get("openapi.json")).json()
    post = found["paths"]["/rcp/v1/context/tenant/alpha/action/move_to"]["post"]
    name = post["requestBody"]["content"]["application/json"]["schema"]["$ref"]
    name = name.removeprefix("#/components/schemas/")
    assert re.fullmatch(r"[A-Za-z0-9._-]+", name)
    position = found["components"]["schemas"][name]["properties"]["position"]
    on_earth = {"latitude", "longitude", "altitude"}
    assert position["properties"].keys() == {"x", "y", "z", "place", "distance"} | on_earth
    forms = [one["required"] for one in position["oneOf"]]
    assert forms == [["x", "y"], ["latitude", "longitude"], ["place"]]


@pytest.mark.parametrize("words", [("read", POSE), ("watch", POSE, "--count", "1")])
def test_rcpctl_names_a_frame(url: str, words: tuple[str, ...]) -> None:
    program = Path(sys.executable).with_name("rcpctl")
    command = [program, *words, "--frame", "earth", "--url", url, "--token", TOKEN, "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert '"latitude"' in done.stdout
