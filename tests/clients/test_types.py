"""The dashboard's pages and the client that they use, checked by the compiler of their language."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from plugins.client.test_codegen import node

_WEB = Path(__file__).parents[2] / "plugins" / "rcp_dashboard" / "web"
_CHECK = _WEB / "node_modules" / "svelte-check" / "bin" / "svelte-check"


def test_the_pages_and_their_client_have_no_error_of_types() -> None:
    found = node()
    if found is None or not _CHECK.exists():
        reason = "the dashboard's packages are not installed: make dashboard"
        if os.environ.get("RCP_CI"):
            pytest.fail(reason)
        pytest.skip(reason)
    done = subprocess.run(
        [found, _CHECK, "--fail-on-warnings", "--output", "human"],
        cwd=_WEB,
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
