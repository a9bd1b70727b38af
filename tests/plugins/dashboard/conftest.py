"""A gateway with the dashboard, its pages being few and known."""

from __future__ import annotations

import gzip
from collections.abc import AsyncGenerator
from pathlib import Path

import httpx
import pytest

import rcp_dashboard.pages
from transports.robot import KEY, Site, site

INDEX = b"<!doctype html><title>x</title>"
SCRIPT = b"console.log(1)" * 50
PICTURE = b"\x89PNG"


@pytest.fixture
def static(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Stand in for what Vite builds."""
    folder = tmp_path / "static"
    (folder / "assets").mkdir(parents=True)
    for name, body in (("index.html", INDEX), ("assets/index-abc.js", SCRIPT)):
        (folder / f"{name}.gz").write_bytes(gzip.compress(body))
    monkeypatch.setattr(rcp_dashboard.pages, "STATIC", folder)
    (folder / "assets" / "dot-abc.png").write_bytes(PICTURE)
    return folder


@pytest.fixture
async def gateway(static: Path) -> AsyncGenerator[Site]:
    """Serve with the dashboard."""
    async with site(more="[plugins.dashboard]\n") as made:
        yield made


@pytest.fixture
async def http(gateway: Site) -> AsyncGenerator[httpx.AsyncClient]:
    """Call the gateway as an operator."""
    headers = {"authorization": f"Bearer {KEY}", "accept-encoding": "identity"}
    async with httpx.AsyncClient(base_url=gateway.url, headers=headers, timeout=60) as client:
        yield client
