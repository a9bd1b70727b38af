"""`rcpd mcp`: connects assistants that start their servers themselves and use stdio."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path
from urllib.parse import urlsplit

import click

__all__ = ["mcp"]


@click.command()
@click.option(
    "--url",
    envvar="RCP_URL",
    default="http://127.0.0.1:8080",
    show_default=True,
    help="URL of the gateway; `/mcp` is added if it has no path.",
)
@click.option(
    "--token-file",
    type=click.Path(path_type=Path, dir_okay=False),
    help="File with the token. Default: RCP_TOKEN, else no token.",
)
@click.option("--tenant", envvar="RCP_TENANT", help="Tenant for relative paths.")
@click.option(
    "--cacert",
    envvar="RCP_CACERT",
    help="PEM file with CA certificates to trust in addition to the system's.",
)
def mcp(url: str, token_file: Path | None, tenant: str | None, cacert: str | None) -> None:
    """Connect desktop assistants to a gateway's MCP server over stdin and stdout."""
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https") or not parts.netloc:
        raise click.BadParameter("use a URL such as http://127.0.0.1:8080", param_hint="--url")
    if parts.path in ("", "/"):
        url = url.rstrip("/") + "/mcp"
    token = os.environ.get("RCP_TOKEN")
    if token_file is not None:
        try:
            token = token_file.read_text(encoding="utf-8").strip()
        except OSError as error:
            raise click.BadParameter(
                f"cannot be read: {error.strerror}", param_hint="--token-file"
            ) from None
    try:
        from rcp_mcp.bridge import bridge
    except ModuleNotFoundError as error:
        text = f"{error.name} is not installed: pip install 'rcp-gateway[mcp]'"
        raise click.ClickException(text) from error

    headers = {"x-rcp-tenant": tenant} if tenant else {}
    if token:
        headers["authorization"] = f"Bearer {token}"
    asyncio.run(bridge(url, headers, cacert))
