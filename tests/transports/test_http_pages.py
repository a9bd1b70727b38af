"""What is long comes over HTTP page by page."""

from __future__ import annotations

import json
from typing import Any

import cbor2
import httpx
import msgspec
import pytest

from rcp_kernel.model import Resource
from transports.http_requests import CONTEXT, error
from transports.robot import Site

pytestmark = pytest.mark.anyio


async def test_a_pattern_is_read_page_by_page(http: httpx.AsyncClient, gateway: Site) -> None:
    names = [f"param/many/p{number:04}" for number in range(1348)]
    gateway.robot.host.declare(
        *(Resource(name=name, description="One of many.", value=float, live=True) for name in names)
    )
    for name in names:
        gateway.robot.host.publish(name, 0.5)
    found: list[str] = []
    query: dict[str, str] = {}
    sizes: list[int] = []
    while True:
        response = await http.get(f"{CONTEXT}/param/many/*", params=query)
        page = response.json()
        sizes.append(len(page["body"]))
        found += [item["path"].removeprefix("/tenant/alpha/") for item in page["body"]]
        assert page.get("truncated", False) is ("cursor" in page)
        if "cursor" not in page:
            break
        query = {"cursor": page["cursor"], "limit": "200"}
    assert (sizes, found) == ([1000, 200, 148], names)
    for wrong in ({"limit": "0"}, {"limit": "1001"}, {"limit": "x"}, {"cursor": "?"}):
        refused = await http.get(f"{CONTEXT}/param/many/*", params=wrong)
        assert (refused.status_code, error(refused)) == (400, "bad_request")


async def test_commands_are_listed_page_by_page(http: httpx.AsyncClient, gateway: Site) -> None:
    sent = [
        (await http.post(f"{CONTEXT}/service/add?wait=5", json=n)).json()["command"]
        for n in range(25)
    ]
    running = await http.post(f"{CONTEXT}/action/go", json=1)
    await gateway.robot.started.get()
    found: list[str] = []
    query: dict[str, str] = {"limit": "10"}
    while True:
        page = (await http.get("/rcp/v1/commands", params=query)).json()
        found += [command["command"] for command in page["body"]]
        assert page.get("truncated", False) is ("cursor" in page)
        if "cursor" not in page:
            break
        query["cursor"] = page["cursor"]
        gateway.robot.release.set()  # it ends between two pages, and is told once all the same
    assert found == [running.json()["command"], *reversed(sent)]
    unheard = await http.get("/rcp/v1/commands?status=null")
    assert (unheard.status_code, error(unheard)) == (400, "bad_request")
    one = (await http.get("/rcp/v1/commands?status=completed&limit=25&path=/x")).json()
    assert (one["body"], "truncated" in one) == ([], False)
    bad = await http.get("/rcp/v1/commands", params={"cursor": "L3RlbmFudA=="})
    assert (bad.status_code, error(bad)) == (400, "bad_request")


async def test_a_page_of_commands_has_so_many_bytes_at_most_in_every_encoding(
    http: httpx.AsyncClient, gateway: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def execute(name: str, value: Any, progress: Any) -> None:
        pass

    monkeypatch.setattr(gateway.robot, "execute", execute)
    note = Resource(name="service/note", description="Notes.", input=str)
    gateway.robot.host.declare(note)
    sent = [
        (await http.post(f"{CONTEXT}/service/note?wait=5", json="x" * 400_000)).json()["command"]
        for _ in range(6)
    ]
    for accept, decode in (
        ("application/json", json.loads),
        ("application/cbor", cbor2.loads),
        ("application/msgpack", msgspec.msgpack.decode),
    ):
        found: list[str] = []
        query: dict[str, str] = {}
        while query or not found:
            response = await http.get("/rcp/v1/commands", params=query, headers={"accept": accept})
            page = decode(response.content)
            assert (len(page["body"]), len(response.content) < 1024 * 1024) == (2, True)
            assert page["body"][0]["input"] == "x" * 400_000
            found += [command["command"] for command in page["body"]]
            query = {"cursor": page["cursor"]} if "cursor" in page else {}
        assert found == sent[::-1]
