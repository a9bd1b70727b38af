"""Series and snapshots over HTTP: what they hold, for whom, and for how long."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import httpx
import pytest

from rcp_kernel.clock import now
from rcp_kernel.model import Pattern, Resource
from transports.robot import KEY, Site, site, until

pytestmark = pytest.mark.anyio
API = "/dashboard/api"
POSE = "/tenant/alpha/sensor/pose"
BETA = {"authorization": "Bearer key-of-tenant-beta"}


def publish(gateway: Site, count: int, step: float = 0.02) -> None:
    begin = now()
    for number in range(count):
        value = {"position": {"x": float(number), "y": -float(number)}}
        gateway.robot.host.publish("sensor/pose", value, begin + int(number * step * 1e9))


async def series(http: httpx.AsyncClient, *fields: str, **more: Any) -> dict[str, Any]:
    answer = await http.get(f"{API}/series", params={"path": POSE, "field": fields, **more})
    assert answer.status_code == 200, answer.text
    return answer.json()


async def drawn(http: httpx.AsyncClient, enough: Callable[[Any], bool], **more: Any) -> Any:
    """Ask until there is enough of it."""
    async with asyncio.timeout(60):
        while True:
            found = (await series(http, "position.x", **more))["series"][0]
            if enough(found):
                return found


async def test_a_series_begins_with_what_the_gateway_has_and_goes_on(
    http: httpx.AsyncClient, gateway: Site
) -> None:
    first = (await series(http, "position.x", "position.y"))["series"]
    assert [one["field"] for one in first] == ["position.x", "position.y"]
    assert [one["values"] for one in first] == [[1.0], [2.0]]
    publish(gateway, 500)
    found = await drawn(http, lambda one: one["samples"] == 501, points=5000)
    assert found["values"] == [1.0, *map(float, range(500))]
    assert found["times"][-1] - found["times"][1] == pytest.approx(499 * 0.02, abs=1e-3)


async def test_a_window_ends_with_the_newest_sample(http: httpx.AsyncClient, gateway: Site) -> None:
    await series(http, "position.x")
    publish(gateway, 500)
    await drawn(http, lambda one: one["samples"] == 501)
    found = await drawn(http, lambda _: True, window=0.99)
    assert found["values"] == [float(number) for number in range(450, 500)]
    # Between two samples, so that no rounding decides which ones are inside.
    earlier = await drawn(http, lambda _: True, window=1.0, until=found["times"][0] - 0.01)
    assert earlier["values"] == [float(number) for number in range(400, 450)]


@pytest.mark.parametrize("method", ["minmax", "lttb"])
async def test_a_long_series_comes_in_few_points(
    http: httpx.AsyncClient, gateway: Site, method: str
) -> None:
    await series(http, "position.x")
    publish(gateway, 900)
    found = await drawn(http, lambda one: one["samples"] == 901, points=50, method=method)
    assert 40 <= len(found["values"]) <= 50
    assert len(found["times"]) == len(found["values"])
    assert found["values"][-1] == 899.0


async def test_a_ring_holds_so_many_and_the_newest(static: Any) -> None:
    table = "[plugins.dashboard]\nsamples = 100\n"
    async with site(more=table) as gateway, client(gateway) as http:
        await series(http, "position.x")
        publish(gateway, 350)
        found = await drawn(http, lambda one: one["samples"] == 100 and one["values"][-1] == 349)
        assert found["values"] == [float(number) for number in range(250, 350)]


async def test_it_is_kept_only_while_somebody_asks(static: Any) -> None:
    table = "[plugins.dashboard]\nidle = 0.2\n"
    async with site(more=table) as gateway, client(gateway) as http:
        await series(http, "position.x")
        assert watching(gateway) == 1
        await until(lambda: watching(gateway) == 0)
        publish(gateway, 10)
        found = await series(http, "position.x")  # the resource's own ring is all there is
        assert 1 <= found["series"][0]["samples"] <= 11
        assert watching(gateway) == 1


def watching(gateway: Site) -> int:
    """Count the subscriptions to the pose."""
    (entry,) = gateway.server.gateway.registry.match(Pattern(POSE, None))
    return len(entry.listeners)


async def test_nobody_has_more_fields_kept_than_may_be(static: Any) -> None:
    table = "[plugins.dashboard]\nfields = 2\n"
    async with site(more=table) as gateway, client(gateway) as http:
        await series(http, "position.x", "position.y")
        third = await http.get(f"{API}/series", params={"path": POSE, "field": "position.z"})
        assert third.status_code == 503
        assert third.json()["error"]["code"] == "queue_full"
        await series(http, "position.x")


async def test_all_together_have_no_more_and_keep_what_they_have(static: Any) -> None:
    table = "[plugins.dashboard]\nall_fields = 3\n"
    async with (
        site(more=table) as gateway,
        client(gateway) as http,
        httpx.AsyncClient(base_url=gateway.url) as stranger,
    ):
        await series(http, "position.x", "position.y")
        await series(stranger, "position.x")
        refused = await stranger.get(f"{API}/series", params={"path": POSE, "field": "position.y"})
        assert refused.json()["error"]["code"] == "queue_full"
        assert refused.headers["retry-after"] == "30"
        await series(http, "position.x", "position.y")
        await series(stranger, "position.x")


async def test_rights_are_those_of_who_asks(http: httpx.AsyncClient) -> None:
    for call in ("series", "camera", "camera/stream"):
        answer = await http.get(f"{API}/{call}", params={"path": POSE}, headers=BETA)
        assert answer.status_code in (403, 404), (call, answer.text)
    await series(http, "position.x")
    answer = await http.get(f"{API}/latest", params={"path": "/tenant/**"}, headers=BETA)
    assert {one["path"].split("/")[2] for one in answer.json()["values"]} == {"beta"}


async def test_who_proves_nothing_gets_nothing_where_that_is_so(static: Any) -> None:
    async with (
        site(top="anonymous = false", more="[plugins.dashboard]\n") as gateway,
        httpx.AsyncClient(base_url=gateway.url) as stranger,
    ):
        for call in ("series", "latest", "camera", "camera/stream"):
            answer = await stranger.get(f"{API}/{call}", params={"path": POSE})
            assert answer.status_code == 401, call
            assert answer.headers["www-authenticate"] == "Bearer"
        assert (await stranger.get("/")).status_code == 200  # the page, where one logs in


@pytest.mark.parametrize(
    ("query", "word"),
    [
        ({}, "`path` is missing"),
        ({"path": "/tenant/*/sensor/pose"}, "`path` is missing"),
        ({"path": POSE, "field": "position.x", "points": "3"}, "points"),
        ({"path": POSE, "field": "position.x", "points": "4.5"}, "points"),
        ({"path": POSE, "field": "position.x", "window": "nan"}, "window"),
        ({"path": POSE, "field": "position.x", "until": "yesterday"}, "not a time"),
        ({"path": POSE, "field": "position.x", "method": "mean"}, "minmax or lttb"),
        ({"path": POSE, "field": "position.x", "colour": "red"}, "colour"),
        ({"path": POSE, "field": "position"}, "not a number"),
        ({"path": POSE, "field": "speed"}, "no field"),
        ({"path": "/tenant/alpha/sensor/text"}, "not a number"),
        ({"path": "/tenant/alpha/sensor/none"}, "none"),
    ],
)
async def test_a_wrong_question_is_told_what_is_wrong(
    http: httpx.AsyncClient, query: dict[str, str], word: str
) -> None:
    answer = await http.get(f"{API}/series", params=query)
    assert 400 <= answer.status_code < 500
    error = answer.json()["error"]
    assert word in error["message"]
    assert error["remedy"]


async def test_present_values_come_page_by_page(http: httpx.AsyncClient, gateway: Site) -> None:
    names = [f"param/many/p{number:04}" for number in range(1348)]
    host = gateway.robot.host
    host.declare(
        *(Resource(name=n, description="One of many.", value=float, live=True) for n in names)
    )
    for name in names:
        host.publish(name, 0.5)
    query = {"path": "/tenant/alpha/param/many/*"}
    first = (await http.get(f"{API}/latest", params=query)).json()
    assert (len(first["values"]), first["truncated"]) == (1000, True)
    last = (await http.get(f"{API}/latest", params=query | {"cursor": first["cursor"]})).json()
    assert "truncated" not in last
    found = [one["path"].removeprefix("/tenant/alpha/") for one in first["values"] + last["values"]]
    assert found == names


async def test_the_present_values_come_in_one_answer(
    http: httpx.AsyncClient, gateway: Site
) -> None:
    gateway.robot.host.publish("sensor/blob", bytes(9000))
    answer = await http.get(f"{API}/latest", params={"path": "/tenant/alpha/sensor/*"})
    found = {one["path"].rpartition("/")[2]: one for one in answer.json()["values"]}
    assert found["pose"]["body"]["position"] == {"x": 1.0, "y": 2.0, "z": 0.0}
    assert found["pose"]["state"] == "fresh"
    assert 0 <= found["pose"]["age"] < 60
    assert found["blob"]["omitted"] > 9000
    assert "body" not in found["blob"]
    assert found["silent"]["error"]["code"] == "adapter_unavailable"
    one = (await http.get(f"{API}/latest", params={"path": POSE})).json()["values"]
    assert one[0]["body"] == found["pose"]["body"]


async def test_a_gateway_without_a_recorder_says_that_there_is_no_past(
    http: httpx.AsyncClient,
) -> None:
    answer = await http.get(f"{API}/past", params={"path": "/tenant/alpha/sensor/x", "from": "-1m"})
    assert answer.status_code == 501
    assert answer.json()["error"]["code"] == "not_implemented"


async def test_the_api_stands_in_the_openapi_document(http: httpx.AsyncClient) -> None:
    paths = (await http.get("/openapi.json")).json()["paths"]
    ours = {path for path in paths if path.startswith(API)}
    calls = ("series", "latest", "past", "camera", "camera/stream", "panels")
    assert ours == {f"{API}/{x}" for x in calls}
    nothing = await http.get(f"{API}/nothing")
    assert nothing.status_code == 404
    assert f"{API}/series" in nothing.json()["error"]["remedy"]
    wrong = await http.post(f"{API}/series")
    assert wrong.status_code == 405
    assert wrong.headers["allow"] == "GET, HEAD, OPTIONS"


def client(gateway: Site) -> httpx.AsyncClient:
    headers = {"authorization": f"Bearer {KEY}"}
    return httpx.AsyncClient(base_url=gateway.url, headers=headers, timeout=60)
