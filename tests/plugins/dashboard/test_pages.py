"""The pages at `/`: who keeps them for how long, what they may do, and what they leave alone."""

from __future__ import annotations

import gzip
import shutil
import threading
from asyncio import gather
from pathlib import Path

import httpx
import pytest

from plugins.dashboard.conftest import INDEX, PICTURE, SCRIPT
from rcp_dashboard.files import File
from transports.robot import Site, site

pytestmark = pytest.mark.anyio
ASSET = "/assets/index-abc.js"
PLAIN = "/assets/dot-abc.png"
DASHBOARD = "[plugins.dashboard]\n"


async def test_files_that_carry_their_hash_are_kept_for_good(http: httpx.AsyncClient) -> None:
    answer = await http.get(ASSET)
    assert answer.content == SCRIPT
    assert answer.headers["cache-control"] == "public, max-age=31536000, immutable"
    assert answer.headers["content-type"] == "text/javascript; charset=utf-8"


async def test_the_index_is_asked_for_again_and_not_sent_again(http: httpx.AsyncClient) -> None:
    answer = await http.get("/")
    assert answer.content == INDEX
    assert answer.headers["cache-control"] == "no-cache"
    known = {"if-none-match": f'"other", {answer.headers["etag"]}'}
    again = await http.get("/", headers=known)
    assert again.status_code == 304
    assert again.content == b""
    assert again.headers["etag"] == answer.headers["etag"]


async def test_what_was_compressed_when_it_was_built_is_sent_so(http: httpx.AsyncClient) -> None:
    for path, body in (("/", INDEX), (ASSET, SCRIPT)):
        packed = await http.get(path, headers={"accept-encoding": "br, gzip"})
        assert packed.headers["content-encoding"] == "gzip"
        assert packed.headers["vary"] == "accept-encoding"
        assert packed.content == body


@pytest.mark.parametrize("accepted", ["identity", "gzip;q=0, br", "", "br"])
async def test_who_takes_no_gzip_gets_the_same_file_unpacked(
    http: httpx.AsyncClient, accepted: str
) -> None:
    headers = {"accept-encoding": accepted}
    packed = await http.get(ASSET, headers={"accept-encoding": "gzip"})
    for path, body in (("/", INDEX), (ASSET, SCRIPT), (PLAIN, PICTURE)):
        several = await gather(*(http.get(path, headers=headers) for _ in range(4)))
        assert {answer.content for answer in several} == {body}
        plain = several[0]
        assert "content-encoding" not in plain.headers
        assert plain.headers["content-length"] == str(len(body))
        assert plain.headers["vary"] == "accept-encoding"
    plain = await http.get(ASSET, headers=headers)
    assert plain.headers["etag"] == packed.headers["etag"]
    again = await http.get(ASSET, headers=headers | {"if-none-match": packed.headers["etag"]})
    assert again.status_code == 304


async def test_a_file_that_was_not_compressed_is_sent_as_it_is(http: httpx.AsyncClient) -> None:
    answer = await http.get(PLAIN, headers={"accept-encoding": "gzip"})
    assert answer.content == PICTURE
    assert answer.headers["content-type"] == "image/png"
    assert "content-encoding" not in answer.headers


async def test_unpacking_keeps_nobody_waiting_and_is_done_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    unpacked: list[int] = []

    def decompress(data: bytes) -> bytes:
        unpacked.append(threading.get_ident())
        return real(data)

    real = gzip.decompress
    monkeypatch.setattr(gzip, "decompress", decompress)
    file = File(gzip.compress(SCRIPT), ASSET, packed=True)
    assert await gather(*(file.plain() for _ in range(50))) == [SCRIPT] * 50
    assert len(unpacked) == 1
    assert unpacked[0] != threading.get_ident()


async def test_a_page_runs_no_script_that_is_not_a_file_of_ours(http: httpx.AsyncClient) -> None:
    for path in ("/", ASSET):
        answer = await http.get(path)
        ours = answer.headers.get_list("content-security-policy")[-1]
        policy = dict(part.strip().split(" ", 1) for part in ours.split(";"))
        assert policy["default-src"] == "'none'"
        assert policy["script-src"] == policy["style-src"] == policy["connect-src"] == "'self'"
        assert policy["frame-ancestors"] == policy["base-uri"] == "'none'"
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["referrer-policy"] == "no-referrer"


async def test_head_tells_the_same_without_a_body(http: httpx.AsyncClient) -> None:
    get, head = await http.get(ASSET), await http.head(ASSET)
    assert head.status_code == 200
    assert head.content == b""
    for name in ("content-length", "etag", "cache-control", "content-type"):
        assert head.headers[name] == get.headers[name]


@pytest.mark.parametrize(
    "path",
    [
        "/nothing",
        "/assets/",
        "/assets/gone.js",
        "/index.html",
        "/index.html.gz",
        ASSET + ".gz",
        "/%2e%2e/pyproject.toml",
        ASSET + "/x",
    ],
)
async def test_a_file_that_is_not_there_is_an_error_with_a_remedy(
    http: httpx.AsyncClient, path: str
) -> None:
    answer = await http.get(path)
    assert answer.status_code == 404
    assert answer.json()["error"]["code"] == "unknown_path"
    assert answer.json()["error"]["remedy"]


async def test_pages_are_only_looked_at(http: httpx.AsyncClient) -> None:
    answer = await http.post("/", content=b"x")
    assert answer.status_code == 405
    assert answer.headers["allow"] == "GET, HEAD, OPTIONS"
    assert (await http.options("/")).headers["allow"] == "GET, HEAD, OPTIONS"


async def test_everything_else_stays_where_it_was(http: httpx.AsyncClient) -> None:
    assert (await http.get("/healthz")).json() == {"status": "ok"}
    assert (await http.get("/metrics")).text.startswith("# HELP")
    assert (await http.get("/rcp/v1")).text.startswith("RCP gateway")
    pose = "/rcp/v1/context/tenant/alpha/sensor/pose"
    assert (await http.get(pose)).json()["status"] == "completed"
    assert (await http.get("/rcp/v1/nothing")).json()["error"]["code"] == "unknown_path"
    assert (await http.get("/openapi.json")).json()["openapi"] == "3.1.0"


async def test_below_a_prefix_the_page_is_a_folder(static: Path) -> None:
    async with (
        site(asgi='root_path = "/robots"', more=DASHBOARD) as gateway,
        httpx.AsyncClient(base_url=f"http://127.0.0.1:{gateway.port}") as http,
    ):
        bare = await http.get("/robots")
        assert bare.status_code == 308
        assert bare.headers["location"] == "/robots/"
        assert (await http.get("/robots/")).content == INDEX
        assert (await http.get("/robots" + ASSET)).content == SCRIPT
        assert (await http.get("/")).content == INDEX  # a proxy that has taken the prefix off


async def test_an_installation_without_pages_says_how_to_get_them(static: Path) -> None:
    shutil.rmtree(static)
    async with (
        site(more=DASHBOARD) as gateway,
        httpx.AsyncClient(base_url=gateway.url) as http,
    ):
        page = await http.get("/")
        assert page.status_code == 200
        assert "make dashboard" in page.text
        assert told(gateway)["detail"] == "the pages were not built: run `make dashboard`"
        assert (await http.get("/healthz")).status_code == 200


async def test_the_status_tells_that_it_is_served(gateway: Site) -> None:
    assert told(gateway) == {"name": "dashboard", "state": "ready", "path": "/"}


def told(gateway: Site) -> dict[str, object]:
    adapters = gateway.server.status.adapters
    return next(facts for facts in adapters if facts["name"] == "dashboard")
