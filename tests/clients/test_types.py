"""The dashboard's pages and the client that they use: checked by their compiler, and their logic by tests of its own."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from plugins.client.test_codegen import node

_WEB = Path(__file__).parents[2] / "plugins" / "rcp_dashboard" / "web"
_CHECK = _WEB / "node_modules" / "svelte-check" / "bin" / "svelte-check"
_VITEST = _WEB / "node_modules" / "vitest" / "vitest.mjs"


def passes(tool: Path, *arguments: str) -> None:
    """Run a tool of Node over the pages; fail with all that it said."""
    found = node()
    if found is None or not tool.exists():
        reason = "the dashboard's packages are not installed: make dashboard"
        if os.environ.get("RCP_CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    done = subprocess.run(
        [found, tool, *arguments],
        cwd=_WEB,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_pages_and_their_client_have_no_error_of_types() -> None:
    passes(_CHECK, "--fail-on-warnings", "--output", "human")


def test_what_the_pages_reckon_is_right_by_their_own_tests() -> None:
    passes(_VITEST, "run", "--no-color")
