"""The index page at `/`: what this server is, and links."""

from __future__ import annotations

from html import escape

from rcp_gateway.client_api import ClientApi

__all__ = ["index_page"]

_PLACES = (
    ("/rcp/v1/discovery", "all resources, with schemas and examples"),
    ("/rcp/v1/status", "health of the gateway and its robots"),
    ("/rcp/v1/openapi.json", "OpenAPI document, including the live resources"),
    ("/rcp/v1/ws", "WebSocket (rcp.v1.json, rcp.v1.cbor, rcp.v1.msgpack)"),
    ("/rcp/v1/events?path=/**", "server-sent events"),
    ("/healthz", "liveness"),
    ("/readyz", "readiness of every robot"),
    ("/metrics", "Prometheus"),
)


def index_page(client_api: ClientApi, *, html: bool) -> str:
    """Return the page as HTML or plain text."""
    known = {path for path, _ in _PLACES}
    others = [
        (mount.prefix, mount.name)
        for mount in client_api.mounts
        if mount.kind == "http" and not mount.prefix.startswith("/rcp/v1")
    ]
    places = [*_PLACES, *(pair for pair in others if pair[0] not in known)]
    if not html:
        lines = [f"{path:<26} {text}" for path, text in places]
        return "RCP gateway (protocol RCP/1)\n\n" + "\n".join(lines) + "\n"
    rows = "".join(
        f'<li><a href="{escape(path.lstrip("/"))}">{escape(path)}</a> {escape(text)}</li>'
        for path, text in places
    )
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>RCP gateway</title>'
        "<style>body{font:16px/1.6 system-ui;max-width:46em;margin:3em auto;padding:0 1em}"
        f"</style><h1>RCP gateway</h1><p>Protocol RCP/1.</p><ul>{rows}</ul></html>"
    )
