"""What was recorded is answered by time: raw, thinned or summarised, to whoever may read it."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import httpx
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader

from configuration import backend, key, listener
from plugins.recorder.gateway import ADMIN, HALF, Gateway, recording
from rcp_client import connect
from rcp_gateway.testing import Message, serve
from rcp_kernel.config.file import parse
from rcp_kernel.types import PoseStamped
from rcp_recorder.queries import COPIES, PAGES, WAITING

pytestmark = pytest.mark.anyio
SPEED = "/tenant/alpha/sensor/speed"
SECRET = "/tenant/alpha/sensor/secret"
HISTORY = "/system/history"
SECOND = 10**9
T0 = 1_800_000_000 * SECOND


async def ask(gateway: Gateway, **body: Any) -> Message:
    return await gateway.admin.request("execute", HISTORY, body=body)


def measure(gateway: Gateway, count: int, name: str = "sensor/speed") -> None:
    """Publish samples, one each 100 ms of the source's time, all received at once."""
    for number in range(count):
        gateway.robot.measure(name, float(number), T0 + number * SECOND // 10)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "recordings"


async def test_samples_come_in_pages_that_have_each_once(folder: Path) -> None:
    async with recording(folder) as gateway:
        measure(gateway, 25)
        await gateway.written(25)
        found, cursor, pages = list[Any](), None, 0
        while not pages or cursor is not None:
            more = {} if cursor is None else {"cursor": cursor}
            reply = await ask(gateway, path="/sensor/speed", limit=10, **more)
            assert reply["status"] == "completed", reply
            found += reply["body"]["samples"]
            cursor = reply["body"].get("cursor")
            pages += 1
    assert pages == 3
    assert [one["body"] for one in found] == [float(number) for number in range(25)]
    assert [one["seq"] for one in found] == list(range(1, 26))
    assert found[3]["timestamp"] == "2027-01-15T08:00:00.300000000Z"


async def test_what_a_run_before_has_written_is_there_too(folder: Path) -> None:
    async with recording(folder) as gateway:
        measure(gateway, 5)
    async with recording(folder) as gateway:
        gateway.robot.measure("sensor/speed", 5.0)
        await gateway.written(6)
        reply = await ask(gateway, path=SPEED)
    assert [one["body"] for one in reply["body"]["samples"]] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]


async def test_what_two_recordings_have_is_returned_once(folder: Path) -> None:
    async with recording(folder) as gateway:
        start = {"name": "second", "paths": ["/tenant/alpha/**"]}
        await gateway.admin.request("execute", "/system/recorder", body={"start": start})
        measure(gateway, 5)
        await gateway.written(10)
        reply = await ask(gateway, path=SPEED)
    assert [one["body"] for one in reply["body"]["samples"]] == [0.0, 1.0, 2.0, 3.0, 4.0]


async def test_an_interval_has_minimum_maximum_and_mean(folder: Path) -> None:
    async with recording(folder) as gateway:
        for x in (1.0, 5.0, 3.0):
            gateway.robot.measure("sensor/pose", PoseStamped(position={"x": x, "y": 0.0}))
        measure(gateway, 4)
        await gateway.written(7)
        number = await ask(gateway, path=SPEED, every="1d")
        fields = await ask(gateway, path="/sensor/pose", every=86_400, fields=["position.x"])
        thin = await ask(gateway, path=SPEED, every="1d", thin=True)
    # The day may change between two samples.
    summary = number["body"]["intervals"]
    assert sum(one["count"] for one in summary) == 4
    assert min(one["min"] for one in summary) == 0.0
    assert max(one["max"] for one in summary) == 3.0
    assert sum(one["mean"] * one["count"] for one in summary) == 6.0
    poses = fields["body"]["intervals"]
    assert {key for one in poses for key in one["max"]} == {"position.x"}
    assert max(one["max"]["position.x"] for one in poses) == 5.0
    assert len(thin["body"]["samples"]) == len(summary)
    assert thin["body"]["samples"][0]["body"] == 0.0


async def test_a_span_excludes_what_is_outside(folder: Path) -> None:
    async with recording(folder) as gateway:
        measure(gateway, 3)
        await gateway.written(3)
        (first, second, third) = (await ask(gateway, path=SPEED))["body"]["samples"]
        before = await ask(gateway, path=SPEED, to=second["received"])
        after = await ask(gateway, path=SPEED, **{"from": second["received"]})
        long_ago = await ask(gateway, path=SPEED, **{"from": 0, "to": "-1h"})
    assert before["body"]["samples"] == [first]
    assert after["body"]["samples"] == [second, third]
    assert long_ago["body"]["samples"] == []


async def test_over_http_it_is_the_path_itself_with_a_time(folder: Path) -> None:
    async with recording(folder) as gateway:
        measure(gateway, 5)
        await gateway.written(5)
        url = "context/sensor/speed?tenant=alpha&from=-1h"
        page = (await gateway.get(f"{url}&limit=2")).json()
        table = await gateway.get(f"{url}&format=csv")
        arrow = await gateway.get(f"{url}&format=arrow")
        parquet = await gateway.get(f"{url}&format=parquet")
        summary = await gateway.get(f"{url}&every=1d&format=csv")
        wrong = await gateway.get(f"{url}&format=xlsx")
    assert (page["path"], page["truncated"]) == (SPEED, True)
    assert [one["body"] for one in page["body"]["samples"]] == [0.0, 1.0]
    assert table.headers["content-type"] == "text/csv"
    rows = list(csv.DictReader(io.StringIO(table.text)))
    assert [row["body"] for row in rows] == ["0.0", "1.0", "2.0", "3.0", "4.0"]
    assert rows[0]["timestamp"].startswith("2027-01-15T08:00:00")
    found = pa.ipc.open_stream(arrow.content).read_all()
    assert found.column("body").to_pylist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert pq.read_table(io.BytesIO(parquet.content)).equals(found)
    assert sum(int(row["count"]) for row in csv.DictReader(io.StringIO(summary.text))) == 5
    assert wrong.json()["error"]["code"] == "invalid_value"


async def test_over_a_websocket_it_is_a_command(folder: Path) -> None:
    async with recording(folder) as gateway:
        measure(gateway, 5)
        await gateway.written(5)
        async with connect(str(gateway.http.base_url), token=ADMIN) as client:
            raw = await client.execute(HISTORY, {"path": SPEED, "from": "-1h"})
            every = await client.execute(HISTORY, {"path": SPEED, "every": "1d"})
            thin = await client.execute(HISTORY, {"path": SPEED, "every": "1d", "thin": True})
    assert [one["body"] for one in raw["samples"]] == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert sum(one["count"] for one in every["intervals"]) == 5
    assert thin["samples"][0] == raw["samples"][0]


async def test_text_of_a_robot_is_no_formula(folder: Path) -> None:
    async with recording(folder) as gateway:
        gateway.robot.measure("sensor/text", "=HYPERLINK(1)")
        await gateway.written(1)
        table = await gateway.get("context/tenant/alpha/sensor/text?from=-1h&format=csv")
    (row,) = csv.DictReader(io.StringIO(table.text))
    assert row["body"] == "'=HYPERLINK(1)"


async def test_a_copy_has_what_matches_and_may_be_read(folder: Path, tmp_path: Path) -> None:
    async with recording(folder) as gateway:
        measure(gateway, 3)
        gateway.robot.measure("sensor/secret", "hidden")
        go = await gateway.admin.request("execute", "/tenant/alpha/action/go", body=0.5)
        assert go["status"] == "completed"
        await gateway.written(6)
        url = "context/tenant/alpha/**?from=-1h&format=mcap"
        whole, half = await gateway.get(url), await gateway.get(url, HALF)
    topics = [set(_topics(tmp_path, one.content)) for one in (whole, half)]
    assert topics[0] >= {SPEED, SECRET, "/tenant/alpha/action/go/commands"}
    assert topics[1] == {SPEED}  # who may not see a whole file gets no commands of it


def _topics(folder: Path, data: bytes) -> list[str]:
    file = folder / "copy.mcap"
    file.write_bytes(data)
    with file.open("rb") as opened:
        found = make_reader(opened, validate_crcs=True).iter_messages()
        return [channel.topic for _, channel, _ in found]


async def test_history_is_for_whoever_may_read_the_path(folder: Path) -> None:
    async with recording(folder) as gateway:
        gateway.robot.measure("sensor/secret", "hidden")
        measure(gateway, 1)
        await gateway.written(2)
        allowed = await gateway.half.request("execute", HISTORY, body={"path": SPEED})
        denied = await gateway.half.request("execute", HISTORY, body={"path": SECRET})
        unknown = await gateway.half.request("execute", HISTORY, body={"path": "/sensor/none"})
        elsewhere = {"path": "/tenant/beta/sensor/speed"}
        other = await gateway.half.request("execute", HISTORY, body=elsewhere)
        over_http = await gateway.get("context/tenant/alpha/sensor/secret?from=-1h", HALF)
    assert len(allowed["body"]["samples"]) == 1
    assert denied["error"]["code"] == "forbidden"
    assert unknown["error"]["code"] == "unknown_path"
    assert other["error"]["code"] == "unknown_path"
    assert over_http.status_code == 403


async def test_a_wrong_request_says_what_to_do(folder: Path) -> None:
    bodies: list[dict[str, Any]] = [
        {"path": "/sensor/*"},
        {"path": SPEED, "from": "yesterday"},
        {"path": SPEED, "every": "0s"},
        {"path": SPEED, "every": "soon"},
        {"path": SPEED, "from": "-1m", "to": "-2m"},
        {"path": SPEED, "cursor": "../../etc"},
    ]
    async with recording(folder) as gateway:
        replies = [await ask(gateway, **body) for body in bodies]
    for reply in replies:
        assert reply["status"] == "rejected", reply
        assert reply["error"]["remedy"]


async def test_a_gateway_without_a_recorder_says_so() -> None:

    config = listener() + backend("rover", use="sim") + key("admin", "admin-admin-admin-admin")
    async with serve(parse(config, "test")) as served:
        (url,) = [facts["url"] for facts in served.server.status.transports if "url" in facts]
        async with httpx.AsyncClient(base_url=url, trust_env=False) as http:
            headers = {"Authorization": "Bearer admin-admin-admin-admin"}
            path = "/rcp/v1/context/tenant/alpha/sensor/pose?from=-1h"
            found = await http.get(path, headers=headers)
            file = await http.get("/rcp/v1/recordings/any.mcap", headers=headers)
    assert (found.status_code, file.status_code) == (501, 501)
    assert "[features.recorder]" in found.json()["error"]["remedy"]


def test_the_page_tells_how_many_queries_run_at_a_time() -> None:
    page = (Path(__file__).parents[3] / "docs/recorder.md").read_text()
    pages, copies = ({2: "two", 3: "three"}[count] for count in (PAGES, COPIES))
    told = (
        f"{pages.capitalize()} pages and {copies} copies (everything in one answer) run at a time"
    )
    assert f"{told}, and {WAITING} wait." in page
