"""Zone sets downloaded from a real server, and what a link at the broker cannot make the gateway do."""

from __future__ import annotations

import asyncio
import hashlib
import json
import os
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from plugins.vda5050.broker import MOSQUITTO
from plugins.vda5050.test_robot import depot
from plugins.vda5050.test_zones import SIZE, send_order
from plugins.vda5050.zones import box, check_state, listed, zone_set
from rcp_vda5050 import downloads, robot

pytestmark = [
    pytest.mark.anyio,
    pytest.mark.skipif(
        MOSQUITTO is None and not os.environ.get("RCP_CI"), reason="needs Mosquitto"
    ),
]
WALL = box("wall", "BLOCKED", 9.0, 9.5)


def document(id_: str, *, alone: bool = False) -> bytes:
    given = zone_set(id_, WALL)
    return json.dumps(given["zoneSet"] if alone else given).encode()


class MapServer:
    """Answers with what it has by path; notes what it was asked."""

    def __init__(self) -> None:
        self.port = 0
        self.asked: list[str] = []

    @property
    def origin(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            head = (await reader.readuntil(b"\r\n\r\n")).decode()
        except asyncio.IncompleteReadError:  # whoever is not patient goes before asking
            writer.close()
            return
        path = head.split()[1]
        self.asked.append(path)
        body, status, more = document(path.strip("/")), "200 OK", ""
        match path:
            case "/alone":
                body = document("alone", alone=True)
            case "/other":
                body = document("another")
            case "/moved":
                status, more = "302 Found", "Location: /good\r\n"
            case "/large":
                body = b" " * (downloads.LARGEST + 1)
            case "/packed":
                more = "Content-Encoding: gzip\r\n"
            case "/page":
                body = b"<html>"
            case "/deep":
                body = b"[" * 5000
            case "/short":
                more, body = "Content-Length: 99999\r\n", body[:20]
            case "/never":
                await reader.read()
            case "/missing":
                status = "404 Not Found"
            case _:
                pass
        writer.write(f"HTTP/1.1 {status}\r\n{more}Connection: close\r\n\r\n".encode() + body)
        writer.close()


@asynccontextmanager
async def map_server() -> AsyncGenerator[MapServer]:
    made = MapServer()
    server = await asyncio.start_server(made.serve, "127.0.0.1", 0)
    made.port = server.sockets[0].getsockname()[1]
    try:
        yield made
    finally:
        server.close()


async def ended(it: Any, id_: str) -> tuple[str, str]:
    """Wait for an instant action to end; return how, and its result."""

    def found(state: dict[str, Any]) -> dict[str, Any] | None:
        states = (each for each in state["instantActionStates"] if each["actionId"] == id_)
        return next((e for e in states if e["actionStatus"] in ("FINISHED", "FAILED")), None)

    state = await it.master.until("r1", found)
    each = found(state)
    assert each is not None
    return each["actionStatus"], each.get("actionResult", "")


def refusals(origin: str) -> list[tuple[dict[str, Any], str]]:
    """Return parameters, and why they are refused."""
    link = {"zoneSetDownloadLink": f"{origin}/good"}
    elsewhere = origin.replace("127.0.0.1", "localhost")
    return [
        ({"zoneSetId": "good", "zoneSetDownloadLink": f"{elsewhere}/good"}, "are not allowed"),
        ({"zoneSetId": "x", "zoneSetDownloadLink": "http://169.254.169.254/x"}, "not allowed"),
        ({"zoneSetId": "x", "zoneSetDownloadLink": "file:///etc/passwd"}, "not allowed"),
        ({"zoneSetId": "x", "zoneSetDownloadLink": f"{origin}@evil.example/x"}, "not allowed"),
        ({"zoneSetId": "x", "zoneSetDownloadLink": f"{origin}\\@evil.example"}, "not allowed"),
        (
            {"zoneSetId": "x", "zoneSetDownloadLink": f"{origin.replace('//', '//me:you@')}/x"},
            "has a user name",
        ),
        ({"zoneSetId": "moved", "zoneSetDownloadLink": f"{origin}/moved"}, "not followed"),
        ({"zoneSetId": "missing", "zoneSetDownloadLink": f"{origin}/missing"}, "404"),
        ({"zoneSetId": "large", "zoneSetDownloadLink": f"{origin}/large"}, "more than"),
        ({"zoneSetId": "packed", "zoneSetDownloadLink": f"{origin}/packed"}, "compresses"),
        ({"zoneSetId": "short", "zoneSetDownloadLink": f"{origin}/short"}, "failed"),
        ({"zoneSetId": "page", "zoneSetDownloadLink": f"{origin}/page"}, "no zone set"),
        ({"zoneSetId": "deep", "zoneSetDownloadLink": f"{origin}/deep"}, "no zone set"),
        ({"zoneSetId": "other", "zoneSetDownloadLink": f"{origin}/other"}, "zone set another"),
        ({"zoneSetId": "never", "zoneSetDownloadLink": f"{origin}/never"}, "more than"),
        ({"zoneSetId": "good", **link, "zoneSetHash": "0" * 64}, "sha256 of what"),
        ({"zoneSetId": "good", **link, "zoneSetHash": "0" * 32}, "32 characters"),
        ({"zoneSetId": "good", **link, "zoneSetHash": 12}, "zoneSetHash is one"),
        ({"zoneSetId": "good"}, "needs the texts"),
    ]


async def test_a_zone_set_is_downloaded_from_where_that_is_allowed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with (
        map_server() as server,
        depot(tmp_path, version="3.0", more=SIZE, downloads=[server.origin]) as it,
    ):
        offered = {
            each["actionType"]: each
            for each in it.master.last("r1", "factsheet")["protocolFeatures"]["mobileRobotActions"]
        }
        keys = {p["key"]: p["isOptional"] for p in offered["downloadZoneSet"]["actionParameters"]}
        assert keys == {"zoneSetId": False, "zoneSetDownloadLink": False, "zoneSetHash": True}
        for parameters, why in refusals(server.origin):
            longest = 0.5 if parameters["zoneSetId"] == "never" else 60.0
            monkeypatch.setattr(downloads, "_LONGEST", longest)
            id_ = await it.master.instant("r1", "downloadZoneSet", **parameters)
            status, result = await ended(it, id_)
            assert (status, why in result) == ("FAILED", True), result
            assert id_ in str(it.master.last("r1")["errors"])
            assert it.master.last("r1")["zoneSets"] == []
        assert server.asked.count("/good") == 1  # for the hash that is another's
        digest = hashlib.sha256(document("good")).hexdigest().upper()
        for name, more in (("good", {"zoneSetHash": digest}), ("alone", {})):
            link = f"{server.origin}/{name}"
            id_ = await it.master.instant("r1", "downloadZoneSet", zoneSetId=name, zoneSetDownloadLink=link, **more)  # fmt: skip
            assert await ended(it, id_) == ("FINISHED", "")
        state = it.master.last("r1")
        assert listed(state) == [("good", "DISABLED"), ("alone", "DISABLED")]
        asked = len(server.asked)
        id_ = await it.master.instant("r1", "downloadZoneSet", zoneSetId="good", zoneSetDownloadLink=f"{server.origin}/good")  # fmt: skip
        assert (await ended(it, id_))[0] == "FAILED"
        [fault] = [e for e in it.master.last("r1")["errors"] if id_ in str(e["errorReferences"])]
        assert fault["errorType"] == "DUPLICATE_ZONE_SET"
        assert len(server.asked) == asked
        await it.master.instant("r1", "enableZoneSet", zoneSetId="alone")
        await it.master.until("r1", lambda s: ("alone", "ENABLED") in listed(s))
        for each in it.master.heard["r1", "state"]:
            check_state(each)


async def test_without_a_server_in_the_configuration_nothing_is_downloaded(tmp_path: Path) -> None:
    async with map_server() as server, depot(tmp_path, version="3.0") as it:
        offered = str(it.master.last("r1", "factsheet"))
        assert "downloadZoneSet" not in offered
        id_ = await it.master.instant("r1", "downloadZoneSet", zoneSetId="x", zoneSetDownloadLink=f"{server.origin}/x")  # fmt: skip
        status, result = await ended(it, id_)
        assert (status, result) == ("FAILED", "there is no action downloadZoneSet; there are: dock, tidy")  # fmt: skip
        assert server.asked == []


async def test_downloads_that_hang_hold_up_no_pause_and_no_cancel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for bound in ("_LONGEST", "_SILENCE"):
        monkeypatch.setattr(downloads, bound, 3600.0)  # none ends meanwhile
    async with (
        map_server() as server,
        depot(tmp_path, version="3.0", downloads=[server.origin]) as it,
    ):

        async def download(id_: str) -> None:
            link = f"{server.origin}/never"
            await it.master.instant("r1", "downloadZoneSet", id_, zoneSetId=id_, zoneSetDownloadLink=link)  # fmt: skip

        for n in range(25):
            await download(f"d{n}")
        assert await ended(it, "d10") == ("FAILED", "10 zone sets are being downloaded, or wait for that")  # fmt: skip
        status, _ = await ended(it, "d24")
        [fault] = [e for e in it.master.last("r1")["errors"] if "d24" in str(e["errorReferences"])]
        assert (status, fault["errorType"]) == ("FAILED", "INSUFFICIENT_MEMORY")
        assert (await ended(it, await it.master.instant("r1", "stateRequest")))[0] == "FINISHED"
        monkeypatch.setattr(robot, "_AT_ONCE", 10)  # so that they are as many as may run
        await it.master.instant("r1", "stateRequest", "full")
        await it.master.until("r1", lambda s: "full" in str(s["errors"]))
        await send_order(it, 0.0, 20.0)
        await it.master.until("r1", lambda s: s["driving"])
        await it.master.instant("r1", "startPause")
        await it.master.until("r1", lambda s: s["paused"] and not s["driving"])
        await it.master.instant("r1", "stopPause")
        await it.master.until("r1", lambda s: s["driving"])
        id_ = await it.master.instant("r1", "cancelOrder")
        assert await ended(it, id_) == ("FINISHED", "")
        assert it.master.last("r1")["nodeStates"] == []
