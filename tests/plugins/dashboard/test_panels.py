"""Panels of plugins are documents, served so that a browser gives them no rights."""

from __future__ import annotations

import json
from pathlib import Path

import httpx
import pytest

from rcp_dashboard.panels import Panels
from rcp_kernel.errors import ConfigError
from transports.robot import KEY, site

pytestmark = pytest.mark.anyio
PANEL = {"title": "Probe", "reads": [{"name": "pose", "description": "where"}]}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Make a panel, with a file beside it that is nobody's business."""
    made = tmp_path / "probe"
    made.mkdir()
    (made / "panel.json").write_text(json.dumps(PANEL))
    (made / "index.html").write_text("<!doctype html><title>Probe</title>")
    (made / "__init__.py").write_text("SECRET = 1\n")
    return made


async def test_a_panel_is_served_without_rights_and_listed(static: object, folder: Path) -> None:
    more = f'[plugins.dashboard.panels]\nprobe = "{folder}"\n'
    async with site(more=more) as gateway, httpx.AsyncClient(base_url=gateway.url) as stranger:
        page = await stranger.get("/dashboard/panels/probe")
        assert page.status_code == 200
        ours = page.headers.get_list("content-security-policy")[-1]
        policy = dict((part.strip() + " ").split(" ", 1) for part in ours.split(";"))
        assert policy["default-src"].strip() == policy["base-uri"].strip() == "'none'"
        assert policy["sandbox"].strip() == "allow-scripts"
        assert policy["script-src"].strip() == "'unsafe-inline'"
        assert "connect-src" not in policy
        for name in ("__init__.py", "index.html", "panel.json", "../probe/panel.json"):
            missing = await stranger.get(f"/dashboard/panels/probe/{name}")
            assert missing.status_code == 404, name
        headers = {"authorization": f"Bearer {KEY}"}
        listed = await stranger.get("/dashboard/api/panels", headers=headers)
        assert listed.json()["panels"] == [
            {"name": "probe", "description": "", "writes": [], **PANEL}
        ]
        frames = (await stranger.get("/")).headers.get_list("content-security-policy")[-1]
        assert "frame-src 'self'" in frames


def test_a_panel_that_cannot_be_served_says_why(folder: Path) -> None:
    with pytest.raises(ConfigError, match="no package 'no_such_panel' is installed"):
        Panels({"probe": "no_such_panel"})
    with pytest.raises(ConfigError, match=r"no package '\.\.' is installed"):
        Panels({"probe": ".."})
    (folder / "panel.json").write_text('{"title": "x", "reeds": []}')
    with pytest.raises(ConfigError, match=r"panel\.json.*reeds"):
        Panels({"probe": str(folder)})
    (folder / "panel.json").write_text(json.dumps(PANEL))
    (folder / "index.html").unlink()
    with pytest.raises(ConfigError, match=r"no index\.html"):
        Panels({"probe": str(folder)})
    (folder / "panel.json").unlink()
    with pytest.raises(ConfigError, match=r"no panel\.json"):
        Panels({"probe": str(folder)})


def test_a_package_is_served_without_being_imported(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "__init__.py").write_text("raise SystemExit\n")
    monkeypatch.syspath_prepend(str(folder.parent))
    assert list(Panels({"one": "probe"}).listed) == ["one"]
