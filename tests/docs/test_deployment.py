"""The way from the demo to a safe deployment is walked as the page of operation tells it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from contextlib import suppress
from pathlib import Path

import pytest

from docs.demo import BIN
from docs.pages import DOCS, ROOT
from ports import free_port

_BASH = r"^```bash\n(.*?)^```"
_PLACE = "From the demo to a safe deployment"
_SERVE = """
exec 3< <(exec rcpd serve "$RCP_HOME/rcp.toml" 2>&1)
gateway=$!
trap 'kill $gateway' EXIT
while read -r line <&3 && [[ $line != *"rcpd: serving"* ]]; do echo "$line"; done
"""


def walk() -> str:
    """Return the page's commands as one program that stops at the first that fails."""
    text = (DOCS / "deploy.md").read_text(encoding="utf-8")
    place = text.partition(f"## {_PLACE}\n")[2].partition("\n## ")[0]
    blocks = re.findall(_BASH, place, re.MULTILINE | re.DOTALL)
    served = 'rcpd serve "$RCP_HOME/rcp.toml"\n'
    assert blocks.count(served) == 1
    steps = [_SERVE if block == served else f"set -v\n{block}set +v\n" for block in blocks]
    return "set -euo pipefail\nexec 2>&1\n" + "\n".join(steps)


def test_the_way_to_a_safe_deployment_is_walked(tmp_path: Path) -> None:
    for program in ("bash", "openssl", "curl"):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed")
    port = str(free_port())
    example = (ROOT / "examples" / "secure.toml").read_text(encoding="utf-8")
    (tmp_path / "examples").mkdir()
    (tmp_path / "examples" / "secure.toml").write_text(example.replace("8443", port))
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("RCP_", "SSL_"))}
    done = subprocess.run(
        ["bash", "-c", walk().replace("8443", port)],
        capture_output=True,
        check=False,
        text=True,
        timeout=240,
        cwd=tmp_path,
        env={**environment, "HOME": str(tmp_path), "PATH": f"{BIN}:{os.environ['PATH']}"},
    )
    out = done.stdout
    assert done.returncode == 0, out
    assert '"code":"unauthenticated"' in out
    for code, told in [
        ("lease_required", "accepts commands only under a lease"),
        ("out_of_range", "2.0 > 1 m/s (people walk here)"),
        ("estop_active", "anna has latched an e-stop: a try"),
    ]:
        assert re.search(rf"^rcpctl: .*{re.escape(told)}.*\nrefused: {code}$", out, re.MULTILINE), (
            out
        )
    home = tmp_path / "rcp"
    for file in home.rglob("*"):
        with suppress(FileNotFoundError):  # a journal goes when its transaction ends
            assert file.stat().st_mode & 0o077 == 0, file
    for name in ("root", "anna"):  # shown once, to the file that it was sent to
        assert (home / f"{name}.token").read_text().strip() not in out


def test_no_certificate_of_the_example_is_named_in_vain() -> None:
    example = (ROOT / "examples" / "secure.toml").read_text(encoding="utf-8")
    told = walk()
    for name in re.findall(r'^\w+ = "\$\{RCP_HOME\}/(tls/[\w.]+)"', example, re.MULTILINE):
        assert f"-out {name}" in told or f"-keyout {name}" in told
