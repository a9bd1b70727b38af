"""The protocol's own JavaScript client drives a rover over each binding."""

from __future__ import annotations

import asyncio
import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from node import node, npm_packages
from plugins.a2a.receiver import receiver
from plugins.a2a.rover import BETA, CAREFUL, OPERATOR, rovers

pytestmark = pytest.mark.anyio
SCRIPT = Path(__file__).parents[2] / "npm" / "a2a" / "drive.mjs"
PATIENCE = 120.0  # s that a whole drive may take


async def driven(folder: Path, given: dict[str, Any]) -> dict[str, Any]:
    """Run the script; returns its report."""
    process = await asyncio.create_subprocess_exec(
        node(),
        str(folder / SCRIPT.name),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    async with asyncio.timeout(PATIENCE):
        out, wrong = await process.communicate(json.dumps(given).encode())
    assert process.returncode == 0, wrong.decode()
    return json.loads(out)


@pytest.mark.parametrize("binding", ["JSONRPC", "HTTP+JSON"])
async def test_a_rover_is_driven_from_javascript(binding: str, tmp_path: Path) -> None:
    packages = npm_packages("a2a")
    (tmp_path / "node_modules").symlink_to(packages / "node_modules")
    shutil.copy(SCRIPT, tmp_path)
    async with rovers() as url, receiver() as hook:
        keys = {"operator": OPERATOR, "careful": CAREFUL, "beta": BETA}
        given = {"url": url, "binding": binding, "hook": hook.url, "keys": keys}
        report = await driven(tmp_path, given)
        posts = await hook.until("TASK_STATE_COMPLETED")
    assert "action.move_to" in report.pop("skills")
    assert report.pop("hidden") is not None
    assert report.pop("stranger") is not None
    assert report == {
        "binding": binding,
        "signed": True,
        "forged": True,
        "artifacts": ["step-1"],
        "kept": 1,
        "resubscribed": "WORKING",
        "cancelled": "CANCELED",
        "streamEnded": "CANCELED",
        "asked": "INPUT_REQUIRED",
        "given": "COMPLETED",
        "approval": "INPUT_REQUIRED",
        "approved": "COMPLETED",
        "pushed": "COMPLETED",
        "denied": "REJECTED",
    }
    assert any("artifactUpdate" in post for post in posts)
    assert hook.heads[0]["x-a2a-notification-token"] == binding
