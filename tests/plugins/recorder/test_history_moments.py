"""History of several resources at once, and what was known at a moment."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from plugins.recorder.gateway import ADMIN, HALF, Gateway, recording
from rcp_client import connect
from rcp_gateway.testing import Message
from rcp_kernel.values import Encoding, parse
from rcp_recorder.pages import Page

pytestmark = pytest.mark.anyio
SPEED, SECRET, TEXT = (f"/tenant/alpha/sensor/{name}" for name in ("speed", "secret", "text"))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "recordings"


async def ask(gateway: Gateway, **body: Any) -> Message:
    return await gateway.admin.request("execute", "/system/history", body=body)


def told(reply: Message) -> list[tuple[str, Any]]:
    assert reply["status"] == "completed", reply
    return [(one["path"].rpartition("/")[2], one["body"]) for one in reply["body"]["samples"]]


async def test_several_resources_come_in_the_order_of_time(folder: Path) -> None:
    async with recording(folder) as gateway:
        gateway.robot.measure("sensor/speed", 1.0)
        gateway.robot.measure("sensor/text", "a")
        gateway.robot.measure("sensor/speed", 2.0)
        await gateway.written(3)
        reply = await ask(gateway, path=[SPEED, "/sensor/text", "/sensor/nothing"])
    assert told(reply) == [("speed", 1.0), ("text", "a"), ("speed", 2.0)]
    assert reply["body"]["path"] == [SPEED, TEXT]


async def test_of_several_those_that_one_may_not_read_are_left_out(folder: Path) -> None:
    async with recording(folder) as gateway:
        gateway.robot.measure("sensor/secret", "hidden")
        gateway.robot.measure("sensor/text", "open")
        await gateway.written(2)
        both = {"path": [SECRET, TEXT], "before": 5}
        some = await gateway.half.request("execute", "/system/history", body=both)
        secret = {"path": [SECRET], "before": 5}
        none = await gateway.half.request("execute", "/system/history", body=secret)
    assert told(some) == [("text", "open")]
    assert "secret" not in str(some["body"])
    assert told(none) == []


async def test_the_last_samples_before_a_moment_come_first(folder: Path) -> None:
    async with recording(folder) as gateway:
        gateway.robot.measure("sensor/text", "old")
        for number in range(5):
            gateway.robot.measure("sensor/speed", float(number))
        await gateway.written(6)
        samples = (await ask(gateway, path=SPEED))["body"]["samples"]
        moment = samples[3]["received"]
        paths = [SPEED, TEXT]
        one = await ask(gateway, path=paths, before=1, **{"from": moment})
        two = await ask(gateway, path=paths, before=2, **{"from": moment, "to": moment})
        alone = await ask(gateway, path=SPEED, before=1, **{"from": moment, "to": moment})
        page = await ask(gateway, path=paths, before=1, limit=1, **{"from": moment})
        cursor = page["body"]["cursor"]
        rest = await ask(gateway, path=paths, before=1, cursor=cursor, **{"from": moment})
    assert told(one) == [("text", "old"), ("speed", 2.0), ("speed", 3.0), ("speed", 4.0)]
    assert told(two) == [("text", "old"), ("speed", 1.0), ("speed", 2.0)]
    assert [sample["body"] for sample in alone["body"]["samples"]] == [2.0]
    assert told(page) == [("text", "old"), ("speed", 2.0), ("speed", 3.0)]
    assert told(rest) == [("speed", 4.0)]


async def test_what_an_earlier_file_has_is_found_too_and_once(folder: Path) -> None:
    async with recording(folder) as gateway:
        gateway.robot.measure("sensor/text", "of the first run")
        for number in range(3):
            gateway.robot.measure("sensor/speed", float(number))
        start = {"name": "second", "paths": ["/tenant/alpha/**"]}
        await gateway.admin.request("execute", "/system/recorder", body={"start": start})
        gateway.robot.measure("sensor/speed", 3.0)
        await gateway.written(6)
    async with recording(folder) as gateway:
        gateway.robot.measure("sensor/speed", 4.0)
        await gateway.until(lambda files: [one for one in files if one["state"] == "recording"])
        reply = await ask(gateway, path=[SPEED, TEXT], before=3, **{"from": "-1ms"})
        bounded = await ask(gateway, path=[SPEED, TEXT], before=1, **{"from": 1.0, "to": 2.0})
    values = [one for one in told(reply) if one[0] == "speed"]
    assert values[:3] == [("speed", 2.0), ("speed", 3.0), ("speed", 4.0)]
    assert ("text", "of the first run") in told(reply)
    assert told(bounded) == []


async def test_thinned_samples_are_one_of_each_resource_in_an_interval(folder: Path) -> None:
    async with recording(folder) as gateway:
        for number in range(4):
            gateway.robot.measure("sensor/speed", float(number))
            gateway.robot.measure("sensor/text", str(number))
        await gateway.written(8)
        reply = await ask(gateway, path=[SPEED, TEXT], every="1d", thin=True)
    names = [name for name, _ in told(reply)]
    assert set(names) == {"speed", "text"}
    assert len(names) <= 4  # the day may change between two samples


@pytest.mark.parametrize(
    "wanted",
    [
        {"path": [SPEED], "every": "1s"},
        {"path": SPEED, "before": 1, "every": "1s"},
        {"path": ["/tenant/alpha/**"]},
    ],
)
async def test_several_and_what_was_before_are_for_samples(
    folder: Path, wanted: dict[str, Any]
) -> None:
    async with recording(folder) as gateway:
        gateway.robot.measure("sensor/speed", 1.0)
        await gateway.written(1)
        reply = await ask(gateway, **wanted)
    assert reply["error"]["code"] == "bad_request", reply


async def test_over_http_a_read_may_begin_with_what_was_before(folder: Path) -> None:
    async with recording(folder) as gateway:
        gateway.robot.measure("sensor/speed", 1.0)
        await gateway.written(1)
        found = await gateway.get(f"context{SPEED}?from=-1ms&before=1", HALF)
        refused = await gateway.get(f"context{SPEED}?from=-1s&before=1&format=csv", HALF)
    assert [one["body"] for one in found.json()["body"]["samples"]] == [1.0], found.text
    assert refused.status_code == 400


async def test_what_was_before_has_a_bound_and_names_what_does_not_fit(folder: Path) -> None:
    async with recording(folder) as gateway:
        gateway.robot.measure("sensor/speed", 1.0)
        for number in range(30):
            gateway.robot.measure("sensor/text", str(number) * 50_000)
        await gateway.written(31)
        page = await ask(gateway, path=[SPEED, TEXT], before=200, **{"from": "-1ms"})
        past = f"context{TEXT}?from=-1ms&before=200"
        over_http = await gateway.get(past)
    samples = page["body"]["samples"]
    assert [one["body"] for one in samples if one["path"] == SPEED] == [1.0]
    assert 5 < len(samples) < 25
    assert samples[-1]["body"][:2] == "29"
    assert page["body"]["left_out"] == [TEXT]
    assert len(over_http.content) < 1.1 * 2**20
    assert over_http.json()["body"]["left_out"] == [TEXT]


async def test_nothing_of_a_page_is_decoded_by_the_gateway(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read(_page: Page) -> Any:
        raise AssertionError

    body = {"path": [SPEED], "before": 1, "from": "-1ms"}
    url = f"context{SPEED}?from=-1ms&before=1"
    async with recording(folder) as gateway:
        gateway.robot.measure("sensor/speed", 1.0)
        await gateway.written(1)
        monkeypatch.setattr(Page, "value", property(read))
        replies = [(await ask(gateway, **body))["body"]]
        for encoding in Encoding:
            accept = {"Accept": f"application/{encoding.value}"}
            found = await gateway.get(url, **accept)
            assert found.headers["content-type"] == f"application/{encoding.value}"
            replies.append(parse(found.content, encoding)["body"])
        async with connect(str(gateway.http.base_url), token=ADMIN, encoding="msgpack") as client:
            replies.append(await client.execute("/system/history", body))
    assert [[one["body"] for one in reply["samples"]] for reply in replies] == [[1.0]] * 5
