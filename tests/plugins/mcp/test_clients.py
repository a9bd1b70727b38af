"""Clients of the protocol's authors: JavaScript of both generations, and the inspector."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from configuration import key, role, rule
from node import bin_of, node, npm_packages
from plugins.mcp.rig import EVERY_TOOL, OPERATOR, ROVER, site

SCRIPT = Path(__file__).parent / "drive.mjs"
AGENT = "agent-of-these-tests"
RULES = role(
    "asking",
    rule("*", "/**"),
    rule("discover read", "/system/status"),
    approve=["/service/reset_system", "/service/clear_faults"],
    approve_own=True,
) + key("agent", "agent-of-these-tests", role="asking", tenants=["alpha"])
_PATIENCE = 120.0  # s for one client's whole story


async def run(*command: str, cwd: Path, **environment: str) -> str:
    """Run a program to its end; return what it printed."""
    process = await asyncio.create_subprocess_exec(
        *command,
        cwd=cwd,
        env={**os.environ, **environment},
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    async with asyncio.timeout(_PATIENCE):
        said, complaint = await process.communicate()
    assert process.returncode == 0, said.decode() + complaint.decode()
    return said.decode()


@pytest.mark.parametrize("era", ["modern", "legacy"])
async def test_the_official_client_drives_the_simulated_rover(era: str, tmp_path: Path) -> None:
    (tmp_path / "node_modules").symlink_to(npm_packages("mcp") / "node_modules")
    script = shutil.copy(SCRIPT, tmp_path)
    async with site(robots=ROVER, more=RULES, mcp=EVERY_TOOL + "feedback = 20.0") as made:
        output = await run(node(), str(script), era, made.url, AGENT, cwd=tmp_path)
    met: dict[str, Any] = json.loads(output)
    assert {"discover", "action-move_to", "service-reset_system"} <= set(met["tools"])
    assert "/tenant/alpha/sensor/pose" in met["discovered"]
    assert met["pose"].keys() == {"x", "y", "z"}
    assert met["pictures"] == ["image/png"]
    assert met["resource"] == "/tenant/alpha/sensor/pose"
    assert met["templates"] == 5
    assert met["prompts"] == ["inspect", "go_to", "diagnose"]
    assert met["moved"] == "completed"
    assert met["progress"] == sorted(set(met["progress"]))
    assert len(met["progress"]) > 2
    assert met["cancelled"] is True
    assert met["running"] == 0
    assert met["denied"] == [True, "out_of_range"]
    assert met["approved"] == "completed"
    assert "service/reset_system" in met["question"][0]
    assert met["declined"] == [True, "forbidden"]
    assert met["guest"] == [True, "forbidden"]


@pytest.mark.parametrize("era", ["modern", "legacy"])
async def test_the_inspector_finds_nothing_to_complain_of(era: str, tmp_path: Path) -> None:
    async with site(robots=ROVER) as made:
        output = await run(
            *bin_of("mcp", "mcp-inspector"),
            *("--cli", "-q", made.url, "--protocol-era", era, "--transport", "http"),
            *("--header", f"Authorization: Bearer {OPERATOR}"),
            *("--method", "tools/list", "--strict"),
            cwd=tmp_path,
            MCP_INSPECTOR_SECRET_STORE="memory",
            HOME=str(tmp_path),
        )
    names = [tool["name"] for tool in json.loads(output)["tools"]]
    assert "action-move_to" in names
