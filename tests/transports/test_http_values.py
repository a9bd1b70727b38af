"""Values over HTTP: encodings, compression, validators and parts."""

from __future__ import annotations

import asyncio
import gzip
import json
from typing import Any

import cbor2
import httpx
import msgspec
import pytest
import zstandard

from rcp_kernel.model import Resource
from transports.http_requests import CONTEXT, POSE, error
from transports.raw import answer, connected
from transports.robot import Site

pytestmark = pytest.mark.anyio


@pytest.mark.parametrize(
    ("accept", "media", "decode"),
    [
        (None, "application/json", json.loads),
        ("text/html, */*;q=0.1", "application/json", json.loads),
        ("application/cbor", "application/cbor", cbor2.loads),
        ("application/x-msgpack", "application/msgpack", msgspec.msgpack.decode),
        ("application/json;q=0.2, application/msgpack", "application/msgpack", msgspec.msgpack.decode),
        ("*/*, application/cbor", "application/cbor", cbor2.loads),
    ],
)  # fmt: skip
async def test_the_answer_is_in_the_encoding_that_is_wanted_most(
    http: httpx.AsyncClient, accept: str | None, media: str, decode: Any
) -> None:
    headers = {} if accept is None else {"accept": accept}
    response = await http.get(POSE, headers=headers)
    assert response.headers["content-type"] == media
    assert decode(response.content)["body"]["position"]["y"] == 2.0


@pytest.mark.parametrize("accept", ["text/html", "application/xml", "application/json;q=0"])
async def test_what_cannot_be_written_is_a_bad_request(
    http: httpx.AsyncClient, accept: str
) -> None:
    response = await http.get(POSE, headers={"accept": accept})
    assert (response.status_code, error(response)) == (400, "bad_request")


@pytest.mark.parametrize(
    ("media", "data", "status"),
    [
        ("application/json", b" 0.5 ", 200),
        ("application/x-www-form-urlencoded", b"0.5", 200),
        ("application/vnd.robot+json", b"0.5", 200),
        ("application/cbor", cbor2.dumps(0.5), 200),
        ("application/msgpack", msgspec.msgpack.encode(0.5), 200),
        ("application/xml", b"<x/>", 400),
        ("application/json", b"{", 400),
        ("application/json", b"\xff\xfe", 400),
        ("application/cbor", b"\xff", 400),
        ("application/json", b"", 400),
        ("application/json", b'"fast"', 422),
        ("application/json", b"9", 422),
    ],
)
async def test_a_body_is_read_as_its_type_says(
    http: httpx.AsyncClient, media: str, data: bytes, status: int
) -> None:
    path = f"{CONTEXT}/param/limit"
    response = await http.put(path, content=data, headers={"content-type": media})
    assert response.status_code == status, response.text
    assert response.json()["type"] == "write"


@pytest.mark.parametrize("how", ["zstd", "gzip", "zstd;q=0, gzip", "br, *", "identity", "br"])
async def test_long_answers_are_compressed_for_who_accepts_it(gateway: Site, how: str) -> None:
    gateway.robot.host.publish("sensor/text", "ha" * 50_000)
    request = (
        f"GET {CONTEXT}/sensor/text HTTP/1.1\r\nHost: localhost\r\nAccept-Encoding: {how}\r\n"
        "Connection: close\r\n\r\n"
    )
    async with connected(gateway) as raw:
        _, data = await answer(raw, request.encode())
    head, _, body = data.partition(b"\r\n\r\n")
    if b"content-encoding: zstd" in head:
        body = zstandard.ZstdDecompressor().decompress(body)
    elif b"content-encoding: gzip" in head:
        body = gzip.decompress(body)
    else:
        assert how in ("identity", "br")
    assert json.loads(body)["body"] == "ha" * 50_000


async def test_megabytes_are_compressed_off_the_loop(
    http: httpx.AsyncClient, gateway: Site
) -> None:
    gateway.robot.host.publish("sensor/text", "ha" * 1_000_000)
    response = await http.get(f"{CONTEXT}/sensor/text", headers={"accept-encoding": "gzip"})
    assert response.headers["content-encoding"] == "gzip"
    assert len(response.json()["body"]) == 2_000_000


async def test_a_value_that_is_known_is_not_sent_again(
    http: httpx.AsyncClient, gateway: Site
) -> None:
    first = await http.get(POSE)
    known = {"if-none-match": f'"other", {first.headers["etag"]}'}
    again = await http.get(POSE, headers=known)
    assert (again.status_code, again.content) == (304, b"")
    assert again.headers["etag"] == first.headers["etag"]
    gateway.robot.host.publish("sensor/pose", {"position": {"x": 3.0, "y": 2.0}})
    assert (await http.get(POSE, headers=known)).status_code == 200


async def test_a_value_is_answered_alike_at_once_and_by_its_handler(
    gateway: Site, http: httpx.AsyncClient
) -> None:
    gateway.robot.host.publish("sensor/pose", {"position": {"x": 3.0, "y": 2.0}})
    answers = [await http.get(POSE + query) for query in ("", "?fresh=false")]
    told = [a.json() | {"timestamp": ""} for a in answers]
    assert told[0] == told[1]
    assert list(told[0]) == list(told[1])
    heads = [dict(a.headers) | {"date": ""} for a in answers]
    assert heads[0] == heads[1]


async def test_the_catalogue_has_a_validator_of_tree_rights_and_query(
    http: httpx.AsyncClient, gateway: Site
) -> None:
    first = await http.get("/rcp/v1/discovery?limit=3")
    known = {"if-none-match": first.headers["etag"]}
    assert (await http.get("/rcp/v1/discovery?limit=3", headers=known)).status_code == 304
    assert (await http.get("/rcp/v1/discovery?limit=4", headers=known)).status_code == 200
    stranger = {**known, "authorization": "Bearer key-of-tenant-beta"}
    assert (await http.get("/rcp/v1/discovery?limit=3", headers=stranger)).status_code == 200
    gateway.robot.host.withdraw("sensor/silent")
    assert (await http.get("/rcp/v1/discovery?limit=3", headers=known)).status_code == 200


@pytest.mark.parametrize(
    ("wanted", "status", "body", "place"),
    [
        ("bytes=2-4", 206, b"234", "bytes 2-4/10"),
        ("bytes=7-", 206, b"789", "bytes 7-9/10"),
        ("bytes=-3", 206, b"789", "bytes 7-9/10"),
        ("bytes=-99", 206, b"0123456789", "bytes 0-9/10"),
        ("bytes=8-99", 206, b"89", "bytes 8-9/10"),
        ("bytes=0-1,3-4", 200, b"0123456789", None),
        ("lines=1-2", 200, b"0123456789", None),
    ],
)
async def test_a_part_of_a_value_of_bytes(
    http: httpx.AsyncClient, wanted: str, status: int, body: bytes, place: str | None
) -> None:
    response = await http.get(f"{CONTEXT}/sensor/blob", headers={"range": wanted})
    assert (response.status_code, response.content) == (status, body)
    assert response.headers.get("content-range") == place
    assert response.headers["content-type"] == "application/octet-stream"


async def test_a_part_that_is_not_there_is_416_with_the_size(http: httpx.AsyncClient) -> None:
    response = await http.get(f"{CONTEXT}/sensor/blob", headers={"range": "bytes=10-"})
    assert (response.status_code, response.headers["content-range"]) == (416, "bytes */10")
    assert error(response) == "bad_request"


async def test_bytes_come_bare_and_may_be_sent_bare(http: httpx.AsyncClient) -> None:
    octets = {"accept": "application/octet-stream"}
    response = await http.get(f"{CONTEXT}/sensor/blob", headers=octets)
    assert (response.content, response.headers["accept-ranges"]) == (b"0123456789", "bytes")
    known = {**octets, "if-none-match": response.headers["etag"]}
    assert (await http.get(f"{CONTEXT}/sensor/blob", headers=known)).status_code == 304
    stale = {"range": "bytes=0-1", "if-range": '"another"'}
    whole = await http.get(f"{CONTEXT}/sensor/blob", headers=stale)
    assert whole.status_code == 200
    await http.put(
        f"{CONTEXT}/param/blob",
        content=b"\x00\xff",
        headers={"content-type": "application/octet-stream"},
    )
    refused = await http.get(POSE, headers=octets)
    assert (refused.status_code, error(refused)) == (400, "bad_request")


async def test_a_value_that_does_not_fit_its_type_is_a_bad_gateway(
    http: httpx.AsyncClient, gateway: Site
) -> None:
    # Values are checked when they are written out: the status has to wait for that.
    good = await http.get(POSE)
    gateway.robot.host.publish("sensor/pose", {"position": "somewhere"})
    for media in ("application/json", "application/cbor"):
        bad = await http.get(POSE, headers={"accept": media})
        assert (bad.status_code, "etag" in bad.headers) == (502, False)
    assert (
        await http.get(POSE, headers={"if-none-match": good.headers["etag"]})
    ).status_code == 502
    posted = await http.post("/rcp/v1/messages", json={"type": "read", "path": "/sensor/pose"})
    assert (posted.status_code, error(posted)) == (502, "device_rejected")

    async def read_back(value: Any) -> Any:
        return "a text where a number was promised"

    gateway.robot.takes["param/limit"] = read_back
    written = await http.put(f"{CONTEXT}/param/limit", json=1.0)
    assert (written.status_code, written.json()["status"]) == (502, "failed")


async def test_one_bad_value_spoils_no_other_part_of_a_batch(
    http: httpx.AsyncClient, gateway: Site
) -> None:
    gateway.robot.host.publish("sensor/pose", {"position": "somewhere"})
    parts = [{"type": "read", "path": "/sensor/pose", "id": "bad", "x-n": 1}]
    parts.append({"type": "read", "path": "/sensor/text", "id": "good"})
    batch = await http.post("/rcp/v1/messages", json={"type": "batch", "body": parts})
    bad, good = batch.json()["body"]
    assert (batch.status_code, bad["id"], bad["x-n"]) == (200, "bad", 1)
    assert bad["error"]["code"] == "device_rejected"
    assert (good["status"], good["body"]) == ("completed", "x")


async def test_schemas_are_served_bare_and_in_envelopes(http: httpx.AsyncClient) -> None:
    listed = (await http.get("/rcp/v1/schemas")).json()["body"]
    id_ = next(name for name in listed if name.startswith("Pose"))
    assert (await http.get(f"/rcp/v1/schemas/{id_}")).json()["body"] == listed[id_]
    bare = await http.get(f"/rcp/v1/schemas/{id_}", headers={"accept": "application/schema+json"})
    assert bare.json() == listed[id_]
    assert (await http.get("/rcp/v1/schemas/none")).status_code == 404


async def test_openapi_is_written_anew_when_the_tree_changes_and_for_others_meanwhile(
    gateway: Site, http: httpx.AsyncClient
) -> None:
    path = "/rcp/v1/context/tenant/alpha/sensor/late"
    beta = {"authorization": "Bearer key-of-tenant-beta"}

    async def told(**headers: str) -> dict[str, Any]:
        return (await http.get("/openapi.json", headers=headers)).json()["paths"]

    first = await asyncio.gather(told(), told(**beta), told())
    assert first[0] == first[2] != first[1]
    assert path not in first[0]
    late = Resource(name="sensor/late", description="Late.", value=float)
    gateway.robot.host.declare(late)
    assert path in await told()
    assert await told(**beta) == first[1]
    gateway.robot.host.withdraw("sensor/late")
    assert await told() == first[0]


async def test_openapi_has_every_resource_that_the_caller_sees(http: httpx.AsyncClient) -> None:
    mine = (await http.get("/rcp/v1/openapi.json")).json()
    assert mine["openapi"] == "3.1.0"
    item = mine["paths"]["/rcp/v1/context/tenant/alpha/param/limit"]
    assert set(item) == {"get", "put"}
    schema = item["put"]["requestBody"]["content"]["application/json"]["schema"]
    name = schema["$ref"].removeprefix("#/components/schemas/")
    assert mine["components"]["schemas"][name]["maximum"] == 2.5
    assert "/rcp/v1/events" in mine["paths"]
    # A stranger reads, and writes nothing; every reference leads somewhere.
    assert (mine["security"], "security" in item["get"]) == ([{}, {"bearer": []}], False)
    assert item["put"]["security"] == [{"bearer": []}]
    assert mine["components"]["responses"]["405"]["headers"]["Allow"]["required"] is True
    assert item["put"]["responses"]["423"] == {"$ref": "#/components/responses/423"}
    beta = {"authorization": "Bearer key-of-tenant-beta"}
    theirs = (await http.get("/openapi.json", headers=beta)).json()
    assert "/rcp/v1/context/tenant/alpha/param/limit" not in theirs["paths"]
    assert "/rcp/v1/context/tenant/beta/param/limit" in theirs["paths"]
