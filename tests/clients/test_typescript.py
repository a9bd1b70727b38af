"""The TypeScript client, by its own tests in Node, against a demo that runs."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

from docs.demo import demo
from plugins.client.test_codegen import node

_CLIENT = Path(__file__).parents[2] / "clients" / "typescript"


@pytest.mark.skipif(node() is None, reason="needs Node")
def test_the_typescript_client_does_what_its_own_tests_say(tmp_path: Path) -> None:
    found = node()
    assert found is not None
    with demo(tmp_path) as running:
        admin = re.search(r"rcp_ad_[\w-]+", running.banner)
        assert admin is not None
        done = subprocess.run(
            [found, "--no-warnings", "--test", "--test-timeout=60000", "test/client.test.ts"],
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
            cwd=_CLIENT,
            env=os.environ
            | {"RCP_URL": running.url, "RCP_TOKEN": running.key, "RCP_ADMIN": admin[0]},
        )
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"\bfail 0\b", done.stdout), done.stdout
