"""The built pages, served from memory; files with a hash in their name are cached forever."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import structlog
from litestar import get
from litestar.types import ASGIApp

from rcp_dashboard.files import File, answer
from rcp_web.application import Application, WebRequest, scope_of
from rcp_web.asgi import Headers

__all__ = ["STATIC", "Pages"]

log = structlog.get_logger("rcp.dashboard")
STATIC = Path(__file__).with_name("static")
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "font-src 'self'; connect-src 'self'; frame-src 'self'; worker-src 'self'; manifest-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_SAFE: Headers = [
    (b"content-security-policy", _POLICY.encode()),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"permissions-policy", b"camera=(), microphone=(), geolocation=(), payment=(), usb=()"),
]
_UNBUILT = b"""<!doctype html><html lang="en"><meta charset="utf-8"><title>RCP gateway</title>
<h1>RCP gateway</h1>
<p>The gateway runs; the pages of its dashboard are not part of this installation.</p>
<p>In a clone, <code>make dashboard</code> builds them (it fetches packages with npm); a wheel made
without <code>RCP_DASHBOARD=off</code> has them. Then start the gateway again.</p>
<p>Everything else is at <a href="rcp/v1">/rcp/v1</a>.</p></html>
"""


class Pages:
    """The files by path, each a route of the application."""

    def __init__(self, static: Path) -> None:
        files = dict(_load(static))
        self.built = "/index.html" in files
        """Whether the pages were built."""
        if not self.built:
            log.warning("dashboard_not_built", remedy="make dashboard")
        files["/"] = files.pop("/index.html", None) or File(_UNBUILT, "/index.html")

        @get([*files], sync_to_thread=False)
        def page(request: WebRequest) -> ASGIApp:
            """Serve a file."""
            return answer(scope_of(request), files[request.scope["path"]], _SAFE)

        self.app = Application([page], remedy="The dashboard is at `/`.")

    def facts(self) -> dict[str, Any]:
        """Return the part of `/system/status`."""
        return {} if self.built else {"detail": "the pages were not built: run `make dashboard`"}


def _load(static: Path) -> list[tuple[str, File]]:
    found: list[tuple[str, File]] = []
    for path in static.rglob("*"):
        if path.is_file():
            packed = path.suffix == ".gz"  # by the build, which leaves no other copy
            name = "/" + path.relative_to(static).as_posix().removesuffix(".gz")
            found.append((name, File(path.read_bytes(), name, packed=packed)))
    return found
