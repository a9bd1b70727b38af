"""Methods, targets and bodies that HTTP refuses, and what it answers then."""

from __future__ import annotations

import asyncio
import json

import httpx
import pytest

from transports.http_requests import CONTEXT, POSE, error
from transports.raw import answer, connected
from transports.robot import KEY, Site, site

pytestmark = pytest.mark.anyio


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
        async with asyncio.timeout(60):
            data = await raw.reader.readuntil(b"\r\n\r\n")
        assert data.startswith(b"HTTP/1.1 504")
