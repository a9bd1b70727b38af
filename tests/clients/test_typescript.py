"""The TypeScript client, by its own tests in Node, against a demo that runs."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from docs.demo import demo
from plugins.client.test_codegen import node

_ROOT = Path(__file__).parents[2]
_CLIENT = _ROOT / "clients" / "typescript"
_PACKAGES = _ROOT / "plugins" / "rcp_dashboard" / "web" / "node_modules"


def require_packages() -> None:
    """Skip where the pages have never been built, except where they have to be."""
    if not (_PACKAGES / "@msgpack").is_dir():
        reason = "the dashboard's packages are not there: make dashboard"
        if os.environ.get("RCP_CI"):
            pytest.fail(reason)
        pytest.skip(reason)


def typescript(folder: Path) -> Path:
    """Copy the client and its tests to where they can be run; return where that is."""
    require_packages()
    client = folder / "client"
    for part in ("src", "test"):
        shutil.copytree(_CLIENT / part, client / part)
    shutil.copy(_CLIENT / "package.json", client)
    (client / "node_modules").symlink_to(_PACKAGES)  # the dashboard has what it needs
    return client


@pytest.mark.skipif(node() is None, reason="needs Node")
@pytest.mark.parametrize(
    ("tests", "encoding"), [("client", "json"), ("client", "msgpack"), ("frozen", "json")]
)
def test_the_typescript_client_does_what_its_own_tests_say(
    tmp_path: Path, tests: str, encoding: str
) -> None:
    found = node()
    assert found is not None
    client = typescript(tmp_path)
    with demo(tmp_path) as running:
        admin = re.search(r"rcp_ad_[\w-]+", running.banner)
        assert admin is not None
        done = subprocess.run(
            [found, "--no-warnings", "--test", "--test-timeout=60000", f"test/{tests}.test.ts"],
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
            cwd=client,
            env=os.environ
            | {"RCP_URL": running.url, "RCP_TOKEN": running.key, "RCP_ADMIN": admin[0]}
            | {"RCP_ENCODING": encoding},
        )
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"\bfail 0\b", done.stdout), done.stdout
