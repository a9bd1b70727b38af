"""The suite of the protocol's authors, against the endpoint with the fixtures that it asks for."""

from __future__ import annotations

import asyncio
import re

import pytest
from mcp.shared.exceptions import MCPDeprecationWarning

from node import bin_of
from plugins.mcp.fixtures import Fixtures
from plugins.mcp.rig import site
from plugins.mcp.working import Named, Worker
from rcp_kernel.model import Resource

pytestmark = pytest.mark.filterwarnings(
    f"ignore::{MCPDeprecationWarning.__module__}.{MCPDeprecationWarning.__name__}"
)
EVERYBODY = '[anonymous]\nrole = "operator"\n'
_QUESTIONS = {
    "tasks-dispatch-and-envelope",
    "tasks-mrtr-composition",
    "tasks-mrtr-input",
    "tasks-required-task-error",
}
"""Not scored: tasks that ask questions, or that a client has to take; this server has neither."""
_HURRIED = "tasks-wire-fields"  # not scored; gives a task less time than a busy machine takes
_PATIENCE = 240.0  # s for one run of the suite


async def run(*command: str) -> tuple[int, str]:
    """Run a program to its end; return its code and what it said."""
    process = await asyncio.create_subprocess_exec(
        *command, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT
    )
    async with asyncio.timeout(_PATIENCE):
        output, _ = await process.communicate()
    assert process.returncode is not None
    return process.returncode, output.decode()


@pytest.mark.parametrize("revision", ["2026-07-28", "2025-11-25"])
async def test_every_scored_scenario_passes(revision: str) -> None:
    suite = bin_of("mcp", "conformance")
    changes = 0

    def change() -> None:
        nonlocal changes
        changes += 1
        made.robot.host.declare(
            Resource(name=f"service/new_{changes}", description="Came later.", output=int)
        )

    async with site(
        more=EVERYBODY, make=Worker, offers=lambda client_api: [Fixtures(change), Named(client_api)]
    ) as made:
        code, said = await run(*suite, "server", "--url", made.url, "--requirements", revision)

    assert code == 0, said
    summary = said[said.index("=== SUMMARY ===") :]
    results = dict(re.findall(r"[✓✗] ([a-z0-9-]+): (\d+) passed", summary))
    unscored = set(re.findall(r"[✓✗] ([a-z0-9-]+) \(", summary))
    skipped = {name for name, passed in results.items() if passed == "0"} - unscored
    assert not skipped
    assert len(results.keys() - unscored) >= 25
    failed = set(re.findall(r"✗ ([a-z0-9-]+): ", summary))
    assert failed <= _QUESTIONS | {_HURRIED}
