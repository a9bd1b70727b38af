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

from rcp_kernel.errors import AdapterUnavailable, Cancelled, DeviceRejected, DeviceTimeout
from rcp_kernel.model import Resource
from transports.raw import answer, connected
from transports.robot import KEY, Site, site

pytestmark = pytest.mark.anyio
POSE = "/rcp/v1/context/tenant/alpha/sensor/pose"
CONTEXT = "/rcp/v1/context"


def error(response: httpx.Response) -> str:
    return response.json()["error"]["code"]


# -- negotiation -----------------------------------------------------------------------------------


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


# -- validators and ranges -------------------------------------------------------------------------


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


# -- fields of the envelope ------------------------------------------------------------------------


async def test_fields_come_as_parameters_and_headers(http: httpx.AsyncClient) -> None:
    path = f"{CONTEXT}/param/limit"
    dry = await http.put(f"{path}?dry_run=true&id=7&x-who=me", content=b"2")
    assert dry.json()["dry_run"] is True
    assert (dry.json()["id"], dry.json()["x-who"]) == ("7", "me")
    first = await http.put(path, content=b"2", headers={"idempotency-key": "k", "x-rcp-id": "a"})
    again = await http.put(path, content=b"2", headers={"idempotency-key": "k", "x-rcp-id": "b"})
    assert (first.json()["seq"], first.json()["id"]) == (again.json()["seq"], "a")
    assert again.json()["id"] == "b"
    other = await http.put(path, content=b"1", headers={"idempotency-key": "k"})
    assert (other.status_code, error(other)) == (409, "duplicate_request")


@pytest.mark.parametrize(
    "query",
    ["deadline=soon", "deadline=-1", "dry_run=perhaps", "id=1&id=2", "unknown=1", "version=2",
     "timestamp=yesterday", "deadline=nan", "id="],
)  # fmt: skip
async def test_a_parameter_that_is_wrong_is_named(http: httpx.AsyncClient, query: str) -> None:
    response = await http.get(f"{POSE}?{query}")
    assert response.status_code == 400, response.text
    assert error(response) in ("bad_request", "version_unsupported")


async def test_a_deadline_holds(http: httpx.AsyncClient) -> None:
    response = await http.get(f"{CONTEXT}/sensor/silent?deadline=0.05")
    assert response.status_code in (503, 504)


async def test_fields_are_projected_and_patterns_read_many(http: httpx.AsyncClient) -> None:
    one = await http.get(f"{POSE}?fields=position.x")
    assert one.json()["body"] == {"position": {"x": 1.0}}
    many = await http.get(f"{CONTEXT}/tenant/*/sensor/pose")
    assert [item["path"] for item in many.json()["body"]] == [
        "/tenant/alpha/sensor/pose",
        "/tenant/beta/sensor/pose",
    ]


async def test_a_tenant_is_named_by_header_or_parameter(http: httpx.AsyncClient) -> None:
    for one in ({"headers": {"x-rcp-tenant": "beta"}}, {"params": {"tenant": "beta"}}):
        response = await http.get(f"{CONTEXT}/sensor/pose", **one)
        assert response.json()["path"] == "/tenant/beta/sensor/pose"
    foreign = await http.get(
        f"{CONTEXT}/sensor/pose?tenant=alpha",
        headers={"authorization": "Bearer key-of-tenant-beta"},
    )
    assert foreign.status_code == 403


# -- execute ---------------------------------------------------------------------------------------


async def test_execute_answers_at_once_and_its_command_can_be_followed(
    http: httpx.AsyncClient, gateway: Site
) -> None:
    response = await http.post(f"{CONTEXT}/action/go", json=4)
    assert (response.status_code, response.json()["status"]) == (202, "accepted")
    place = response.headers["location"]
    assert place == f"/rcp/v1/commands/{response.json()['command']}"
    await gateway.robot.started.get()
    state = (await http.get(place)).json()["body"]
    assert (state["status"], state["progress"]) == ("in_progress", 0.5)
    busy = await http.post(f"{CONTEXT}/action/go", json=4)
    assert (busy.status_code, error(busy)) == (409, "already_running")
    gone = await http.delete(place)
    assert gone.json()["body"] == {"cancelled": [response.json()["command"]]}
    listed = await http.get("/rcp/v1/commands?limit=1")
    assert listed.json()["body"][0]["command"] == response.json()["command"]
    assert "history" not in listed.json()["body"][0]


@pytest.mark.parametrize("how", [{"params": {"wait": "5"}}, {"headers": {"prefer": "wait=5"}}])
async def test_execute_may_wait_for_the_end(
    http: httpx.AsyncClient, gateway: Site, how: dict[str, Any]
) -> None:
    gateway.robot.release.set()
    response = await http.post(f"{CONTEXT}/action/go", json=4, **how)
    assert (response.status_code, response.json()["body"]) == (200, 4)


async def test_waiting_in_vain_ends_with_what_there_is(
    http: httpx.AsyncClient, gateway: Site
) -> None:
    response = await http.post(f"{CONTEXT}/action/go?wait=0.05", json=4)
    assert (response.status_code, response.json()["status"]) == (202, "in_progress")
    assert response.headers["location"].endswith(response.json()["command"])
    failed = await http.post(f"{CONTEXT}/action/go?wait=5&tenant=beta", json=400)
    assert (failed.status_code, error(failed)) == (502, "device_rejected")


# -- the status says how it ended ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("trouble", "status", "code"),
    [
        (DeviceRejected, 502, "device_rejected"),
        (DeviceTimeout, 504, "device_timeout"),
        (AdapterUnavailable, 503, "adapter_unavailable"),
        (Cancelled, 499, "cancelled"),
        (ZeroDivisionError, 500, "internal"),
    ],
)
@pytest.mark.parametrize("call", ["write", "execute", "posted", "service"])
async def test_what_has_failed_is_never_a_2xx(
    http: httpx.AsyncClient,
    gateway: Site,
    trouble: type[Exception],
    status: int,
    code: str,
    call: str,
) -> None:
    async def fail(value: Any, progress: Any = None) -> Any:
        raise trouble("the way is blocked")

    async def stumble(value: Any, progress: Any) -> Any:
        progress(1.0, fraction=0.5)
        await fail(value)

    gateway.robot.takes["param/limit"] = fail
    gateway.robot.behaviours |= {"action/go": stumble, "service/add": fail}
    message = {"type": "execute", "path": "/action/go", "body": 4, "deadline": 5}
    for key in ("first", "first", "again"):  # a repeat under a key tells the same
        headers = {"idempotency-key": key}
        if call == "write":
            response = await http.put(f"{CONTEXT}/param/limit", json=1.0, headers=headers)
        elif call == "posted":
            response = await http.post("/rcp/v1/messages", json=message, headers=headers)
        else:
            path = {"execute": "action/go", "service": "service/add"}[call]
            response = await http.post(f"{CONTEXT}/{path}?wait=5", json=4, headers=headers)
        assert (response.status_code, error(response)) == (status, code)
        assert response.json()["status"] in ("failed", "rejected", "cancelled")
    if call != "write":  # the lookup of a failed command has not failed
        found = await http.get(response.headers["location"])
        assert (found.status_code, found.json()["body"]["error"]["code"]) == (200, code)


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


# -- pages -----------------------------------------------------------------------------------------


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


# -- envelopes -------------------------------------------------------------------------------------


async def test_any_envelope_may_be_posted(http: httpx.AsyncClient) -> None:
    async def post(**envelope: Any) -> httpx.Response:
        return await http.post("/rcp/v1/messages", json=envelope)

    assert (await post(type="ping", id="1")).json()["id"] == "1"
    added = await post(type="execute", path="/service/add", body=1)
    assert (added.status_code, added.json()["body"]) == (200, 2)
    started = await post(type="execute", path="/action/go", body=1)
    assert (started.status_code, started.json()["status"]) == (202, "accepted")
    late = await post(type="execute", path="/tenant/beta/action/go", body=1, deadline=0.05)
    assert (late.status_code, error(late)) == (504, "deadline_exceeded")
    batch = await post(type="batch", body=[{"type": "ping", "id": "a"}, {"type": "fly"}])
    assert [part["status"] for part in batch.json()["body"]] == ["completed", "rejected"]
    for wrong in ("subscribe", "hello"):
        refused = await post(type=wrong, id="9", path="/sensor/pose")
        assert (refused.status_code, refused.json()["id"]) == (405, "9")


async def test_an_envelope_in_cbor_is_answered_in_cbor(http: httpx.AsyncClient) -> None:
    response = await http.post(
        "/rcp/v1/messages",
        content=cbor2.dumps({"type": "read", "path": "/sensor/blob"}),
        headers={"content-type": "application/cbor"},
    )
    assert cbor2.loads(response.content)["body"] == b"0123456789"


# -- the rest --------------------------------------------------------------------------------------


async def test_schemas_are_served_bare_and_in_envelopes(http: httpx.AsyncClient) -> None:
    listed = (await http.get("/rcp/v1/schemas")).json()["body"]
    id_ = next(name for name in listed if name.startswith("Pose"))
    assert (await http.get(f"/rcp/v1/schemas/{id_}")).json()["body"] == listed[id_]
    bare = await http.get(f"/rcp/v1/schemas/{id_}", headers={"accept": "application/schema+json"})
    assert bare.json() == listed[id_]
    assert (await http.get("/rcp/v1/schemas/none")).status_code == 404


@pytest.mark.parametrize(
    ("method", "path", "status", "allow"),
    [
        ("OPTIONS", POSE, 204, "GET, HEAD, OPTIONS"),
        ("OPTIONS", f"{CONTEXT}/param/limit", 204, "GET, HEAD, PUT, OPTIONS"),
        ("OPTIONS", f"{CONTEXT}/action/go", 204, "POST, OPTIONS"),
        ("OPTIONS", "/rcp/v1/commands", 204, "GET, HEAD, OPTIONS"),
        ("DELETE", "/rcp/v1/commands", 405, "GET, HEAD, OPTIONS"),
        ("PATCH", POSE, 405, "GET, HEAD, OPTIONS"),
        ("PUT", POSE, 405, "GET, HEAD, OPTIONS"),
        ("TRACE", f"{CONTEXT}/action/go", 405, "POST, OPTIONS"),
        ("GET", f"{CONTEXT}/action/go", 405, "POST, OPTIONS"),
        ("POST", f"{CONTEXT}/param/limit", 405, "GET, HEAD, PUT, OPTIONS"),
        ("GET", "/rcp/v1/messages", 405, "POST, OPTIONS"),
        ("POST", "/rcp/v1/events?path=/**", 405, "GET, OPTIONS"),
        ("PATCH", f"{CONTEXT}/sensor/none", 405, "GET, HEAD, PUT, POST, OPTIONS"),
        ("TRACE", f"{CONTEXT}/0", 405, "GET, HEAD, PUT, POST, OPTIONS"),
        ("HEAD", POSE, 200, None),
    ],
)
async def test_methods(
    http: httpx.AsyncClient, method: str, path: str, status: int, allow: str | None
) -> None:
    response = await http.request(method, path, content=b"1" if method == "PUT" else None)
    assert (response.status_code, response.headers.get("allow")) == (status, allow)
    if method == "HEAD":
        assert response.content == b""
        assert int(response.headers["content-length"]) > 100


async def test_what_cannot_be_written_says_so_with_a_body_and_without(
    http: httpx.AsyncClient,
) -> None:
    for content in (b"1", None):
        response = await http.put(POSE, content=content)
        assert (response.status_code, error(response)) == (405, "unsupported_operation")
        assert (await http.put(f"{CONTEXT}/sensor/none", content=content)).status_code == 404
        async with httpx.AsyncClient(base_url=http.base_url) as anyone:
            refused = await anyone.put(f"{CONTEXT}/param/limit", content=content)
        assert (refused.status_code, error(refused)) == (403, "forbidden")
    for blank in (b"", b" \n"):
        empty = await http.put(f"{CONTEXT}/param/limit", content=blank)
        assert (empty.status_code, error(empty)) == (400, "bad_request")


async def test_a_body_of_whitespace_is_no_json(http: httpx.AsyncClient) -> None:
    """Nor is it no body: who sends one meant to say something."""
    blank = await http.post(f"{CONTEXT}/action/go", content=b" \n")
    assert (blank.status_code, error(blank)) == (400, "bad_request")
    assert "whitespace" in blank.json()["error"]["message"]


@pytest.mark.parametrize(
    ("name", "value", "status"),
    [
        ("content-encoding", "gzip", 400),
        ("content-range", "bytes 0-0/3", 400),
        ("if-match", '"1"', 501),
        ("if-none-match", "*", 501),
        ("if-unmodified-since", "Thu, 01 Jan 2015 00:00:00 GMT", 501),
        ("content-encoding", "identity", 200),
    ],
)
async def test_nothing_is_written_past_what_its_headers_ask_for(
    http: httpx.AsyncClient, gateway: Site, name: str, value: str, status: int
) -> None:
    taken: list[object] = []

    async def write(name: str, value: object) -> None:
        taken.append(value)

    gateway.robot.write = write  # type: ignore[method-assign, assignment]
    response = await http.put(f"{CONTEXT}/param/limit", json=2, headers={name: value})
    assert response.status_code == status, response.text
    assert taken == ([2.0] if status == 200 else [])


@pytest.mark.parametrize(
    ("target", "status", "code"),
    [
        (f"{CONTEXT}/sensor%2Fpose", 200, None),  # how generated clients write a path in a path
        (f"{CONTEXT}/sensor/p%6Fse", 200, None),
        (f"{CONTEXT}/sensor/pose%00", 400, "invalid_path"),
        (f"{CONTEXT}/sensor/pose%0a", 400, "invalid_path"),
        (f"{CONTEXT}/sensor/pose%zz", 400, "invalid_path"),
        (f"{CONTEXT}/sensor/pose%", 400, "invalid_path"),
        (f"{CONTEXT}/sensor%c0%afpose", 400, "invalid_path"),
        (f"{CONTEXT}/sensor/%ff", 400, "invalid_path"),
        (f"{CONTEXT}/sensor//pose", 400, "invalid_path"),
        (f"{CONTEXT}/sensor/pose/", 400, "invalid_path"),
        (f"{CONTEXT}/sensor/../pose", 404, "unknown_path"),
        (f"{CONTEXT}/sensor%252Fpose", 400, "invalid_path"),
        ("/rcp/v1/schemas/%zz", 404, "unknown_path"),
        ("/rcp/v1/commands/%00", 404, "unknown_path"),
        ("/healthz%00", 404, "unknown_path"),
        ("/%c0%ae%c0%ae/healthz", 404, "unknown_path"),
        (f"{POSE}?fresh=1&fresh=0", 400, "bad_request"),
        (f"{POSE}?limit=1&limit=2", 400, "bad_request"),
        (f"{POSE}?tenant=alpha&tenant=beta", 400, "bad_request"),
        ("/rcp/v1/discovery?op=read&op=write", 400, "bad_request"),
        ("/rcp/v1/commands?status=x&status=y", 400, "bad_request"),
    ],
)
async def test_a_target_is_decoded_once_and_refused_by_its_kind(
    gateway: Site, target: str, status: int, code: str | None
) -> None:
    request = f"GET {target} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    async with connected(gateway) as raw:
        found, data = await answer(raw, request.encode())
    told = json.loads(data.partition(b"\r\n\r\n")[2])
    assert (found, (told.get("error") or {}).get("code")) == (status, code)


@pytest.mark.parametrize(
    "path", ["/healthz", "/readyz", "/", "/rcp/v1/openapi.json", "/rcp/v1/status", POSE]
)
async def test_head_is_get_without_its_body(http: httpx.AsyncClient, path: str) -> None:
    async with httpx.AsyncClient(base_url=http.base_url, headers=http.headers) as other:
        head = await other.head(path)
        assert (head.status_code, head.content) == (200, b"")
        assert (await other.get(path)).headers["content-type"] == head.headers["content-type"]


async def test_the_allow_of_messages_is_its_own(http: httpx.AsyncClient) -> None:
    for envelope in ({"type": "read", "path": "/action/go"}, {"type": "subscribe", "path": "/x"}):
        refused = await http.post("/rcp/v1/messages", json=envelope)
        assert (refused.status_code, refused.headers["allow"]) == (405, "POST, OPTIONS")


@pytest.mark.parametrize(
    "path",
    ["/rcp/v1/nothing", "/rcp/v1/commands/none", "/rcp/v1/context/tenant/gamma/sensor/pose",
     "/rcp/v1/commands/a/b/c", "/rcp/v1x", "/nothing/at/all"],
)  # fmt: skip
async def test_what_is_not_there_is_404_with_an_envelope(
    http: httpx.AsyncClient, path: str
) -> None:
    response = await http.get(path)
    assert (response.status_code, error(response)) == (404, "unknown_path")


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"authorization": "Bearer nobody-has-this-key"}, 401),
        ({"authorization": "Basic dTpw"}, 400),
        ({"origin": "https://elsewhere.example"}, 403),
    ],
)
async def test_who_may_not_write_is_told_so(
    http: httpx.AsyncClient, headers: dict[str, str], status: int
) -> None:
    response = await http.put(f"{CONTEXT}/param/limit", content=b"1", headers=headers)
    assert response.status_code == status
    assert "remedy" in response.json()["error"]
    assert ("www-authenticate" in response.headers) is (status == 401)


async def test_a_body_too_long_is_413_however_it_comes() -> None:
    async with site(more="[limits]\nmessage = 2000") as gateway:
        host = f"PUT {CONTEXT}/param/text HTTP/1.1\r\nHost: localhost\r\n"
        auth = f"Authorization: Bearer {KEY}\r\n"
        declared = f"{host}{auth}Content-Length: 99999\r\n\r\n".encode()
        chunked = f"{host}{auth}Transfer-Encoding: chunked\r\n\r\n".encode()
        for request in (declared, chunked + b"fa0\r\n" + b"x" * 4000 + b"\r\n0\r\n\r\n"):
            async with connected(gateway) as raw:
                status, data = await answer(raw, request)
            assert status == 413, data
            assert b"payload_too_large" in data


async def test_a_body_that_does_not_come_is_given_up() -> None:
    async with site(http="body_timeout = 0.05") as gateway, connected(gateway) as raw:
        raw.send(
            f"PUT {CONTEXT}/param/text HTTP/1.1\r\nHost: localhost\r\n"
            f"Authorization: Bearer {KEY}\r\nContent-Length: 50\r\n\r\nhalf".encode()
        )
        async with asyncio.timeout(20):
            data = await raw.reader.readuntil(b"\r\n\r\n")
        assert data.startswith(b"HTTP/1.1 504")


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
