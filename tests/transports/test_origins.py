from __future__ import annotations

import httpx
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from rcp_asgi.origins import Origins
from rcp_gateway.server import prepare
from rcp_kernel.config.file import parse
from rcp_kernel.errors import ConfigError, Forbidden
from transports.raw import answer, connected, handshake
from transports.robot import Site, site

pytestmark = pytest.mark.anyio
POSE = "/rcp/v1/context/tenant/alpha/sensor/pose"
LIMIT = "/rcp/v1/context/tenant/alpha/param/limit"
ANYBODY = '[anonymous]\nrole = "operator"\n'
FOREIGN = [
    "https://elsewhere.example",
    "http://127.0.0.1:1",
    "http://localhost.evil.example",
    "null",
    "file://",
    "",
    "http://",
    "127.0.0.1",
    "chrome-extension://127.0.0.1",
]


def same(origin: str, host: str, *, scheme: str = "http", listed: tuple[str, ...] = ()) -> bool:
    """Tell whether a page of `origin` may use what it calls `host`, unlisted."""
    rules = Origins("0.0.0.0", listed, ())
    headers = [(b"host", host.encode()), (b"origin", origin.encode())]
    scope = {"type": "http", "method": "POST", "scheme": scheme, "headers": headers}
    try:
        return rules.check(scope) is None
    except Forbidden:
        return False


@pytest.mark.parametrize(
    ("origin", "host", "scheme", "expected"),
    [
        ("http://robot:8080", "robot:8080", "http", True),
        ("http://ROBOT", "robot", "http", True),
        ("http://robot", "robot:80", "http", True),
        ("https://robot", "robot", "http", True),  # a proxy adds TLS
        ("https://robot:8443", "robot:8443", "https", True),
        ("https://robot", "robot:443", "https", True),
        ("http://robot", "robot", "https", False),  # nobody takes it away
        ("http://robot:443", "robot", "http", False),
        ("https://robot:80", "robot:80", "http", True),
        ("https://robot:80", "robot", "http", False),
        ("http://robot:8081", "robot:8080", "http", False),
        ("http://other:8080", "robot:8080", "http", False),
        ("http://robot.evil:8080", "robot:8080", "http", False),
        ("ftp://robot:8080", "robot:8080", "http", False),
        ("null", "null", "http", False),
        ("", "", "http", False),
    ],
)
def test_a_page_is_the_gateways_own_by_scheme_name_and_port(
    origin: str,
    host: str,
    scheme: str,
    expected: bool,  # noqa: FBT001 - a case
) -> None:
    assert same(origin, host, scheme=scheme) is expected


@pytest.mark.parametrize("origin", FOREIGN)
async def test_a_foreign_origin_gets_nothing_by_any_method(origin: str) -> None:
    async with (
        site(more=ANYBODY) as gateway,
        httpx.AsyncClient(base_url=gateway.url, headers={"origin": origin}) as http,
    ):
        for method, path, body in [
            ("GET", POSE, None),
            ("HEAD", POSE, None),
            ("OPTIONS", POSE, None),
            ("PUT", LIMIT, b"2"),
            ("POST", "/rcp/v1/context/tenant/alpha/service/add", b"2"),
            ("POST", "/rcp/v1/messages", b'{"type":"ping"}'),
            ("DELETE", "/rcp/v1/commands/x", None),
            ("GET", "/rcp/v1/events?path=/**", None),
            ("GET", "/metrics", None),
            ("GET", "/nothing/here", None),
        ]:
            told = await http.request(method, path, content=body)
            assert told.status_code == 403, (method, path)
            assert not [name for name in told.headers if name.startswith("access-control")]
        preflight = {"access-control-request-method": "PUT"}
        assert (await http.options(LIMIT, headers=preflight)).status_code == 403
        with pytest.raises(InvalidStatus, match="403"):
            await connect(gateway.ws, origin=origin).__aenter__()  # type: ignore[arg-type]
        assert not gateway.server.gateway.sessions.known


@pytest.mark.parametrize("site_", ["cross-site", "same-site"])
@pytest.mark.parametrize(
    ("method", "mode", "dest", "status"),
    [
        ("GET", "no-cors", "image", 403),
        ("GET", "no-cors", "script", 403),
        ("GET", "navigate", "iframe", 403),
        ("POST", "navigate", "document", 403),
        ("GET", "navigate", "document", 200),
    ],
)
async def test_other_pages_may_link_but_not_embed(
    gateway: Site, site_: str, method: str, mode: str, dest: str, status: int
) -> None:
    headers = {"sec-fetch-site": site_, "sec-fetch-mode": mode, "sec-fetch-dest": dest}
    async with httpx.AsyncClient(base_url=gateway.url, headers=headers) as http:
        assert (await http.request(method, POSE)).status_code == status
        own = await http.get(POSE, headers={"sec-fetch-site": "same-origin"})
        assert own.status_code == 200
        assert own.headers["x-content-type-options"] == "nosniff"
        assert own.headers["cross-origin-resource-policy"] == "same-origin"


@pytest.mark.parametrize("name", ["Host", "Origin"])
async def test_a_header_that_decides_is_there_once(gateway: Site, name: str) -> None:
    own = f"127.0.0.1:{gateway.port}"
    value = own if name == "Host" else f"http://{own}"
    twice = f"GET {POSE} HTTP/1.1\r\nHost: {own}\r\n{name}: {value}\r\n{name}: {value}\r\n\r\n"
    async with connected(gateway) as raw:
        raw.send(twice.encode())
        head = await raw.reader.readuntil(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 400" if name == "Host" else b"HTTP/1.1 403")


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", "localhost.", "[::2]"])
async def test_a_name_that_is_not_the_gateways_is_refused(gateway: Site, host: str) -> None:
    async with httpx.AsyncClient(base_url=gateway.url, headers={"host": host}) as http:
        assert (await http.get(POSE)).status_code == 403
    async with connected(gateway) as raw:
        assert (await answer(raw, handshake(Host=host)))[0] == 403


@pytest.mark.parametrize("origin", ["null", "ui.example", "https://ui.example/page", "https://"])
def test_an_origin_that_no_page_has_is_a_fault_of_the_configuration(origin: str) -> None:
    text = f'[transports.asgi]\norigins = ["{origin}"]\n'
    with pytest.raises(ConfigError, match=r"origins\[0\]"):
        prepare(parse(text, "f"), "f")
