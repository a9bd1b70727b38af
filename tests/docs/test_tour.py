"""What the README and the page of clients show does what they say, against a live demo."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from docs.demo import BIN, Demo
from docs.pages import DOCS, ROOT, section
from rcp_client.cli import rcpctl

_SHELL = r"^```sh\n(.*?)^```"
_PYTHON = r"^```python\n(.*?)^```"


def lines(page: Path, program: str) -> list[str]:
    text = page.read_text(encoding="utf-8")
    blocks = re.findall(_SHELL, text, re.MULTILINE | re.DOTALL)
    return [line for block in blocks for line in block.splitlines() if line.startswith(program)]


def shell(line: str, live: Demo) -> subprocess.CompletedProcess[str]:
    command = line.replace("http://127.0.0.1:8080", live.url).replace(".venv/bin/", f"{BIN}/")
    environment = live.environment | {"KEY": live.key, "RCP_URL": live.url}
    return subprocess.run(
        command,
        shell=True,
        check=False,
        capture_output=True,
        text=True,
        timeout=120,
        env=environment,
    )


def test_the_curl_calls_of_the_readme_are_answered(live: Demo) -> None:
    if shutil.which("curl") is None:
        pytest.skip("curl is not installed")
    pose, write, refused, stream = (
        shell(line, live) for line in lines(ROOT / "README.md", "curl ")
    )
    assert "position" in json.loads(pose.stdout)["body"]
    assert json.loads(write.stdout)["body"] == 0.8
    message = json.loads(refused.stdout)["error"]["message"]
    assert message in section(ROOT / "README.md", "Quick tour")
    assert stream.stdout.count("event: update") > 2


def test_the_rcpctl_calls_of_the_readme_succeed(drone: Demo) -> None:
    found = lines(ROOT / "README.md", ".venv/bin/rcpctl")
    assert len(found) > 4
    for line in found:
        if "estop" not in line:  # the robots of this demo are still wanted
            done = shell(line, drone)
            assert done.returncode == 0, line + done.stderr


@pytest.mark.parametrize("page", [ROOT / "README.md", DOCS / "client.md"], ids=lambda p: p.name)
def test_the_python_of_a_page_runs(page: Path, live: Demo, tmp_path: Path) -> None:
    printed: list[str] = []
    for code in re.findall(_PYTHON, page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL):
        program = tmp_path / "program.py"
        program.write_text(code, encoding="utf-8")
        done = subprocess.run(
            [sys.executable, str(program)],
            check=False,
            capture_output=True,
            text=True,
            timeout=120,
            env=live.environment | {"RCP_URL": live.url},
        )
        assert done.returncode == 0, done.stderr
        printed += done.stdout.splitlines()
    assert len(printed) == 4


def test_every_command_of_rcpctl_is_told() -> None:
    text = (DOCS / "client.md").read_text(encoding="utf-8")
    documented = set(re.findall(r"^\| `rcpctl (\w+)", text, re.MULTILINE))
    assert documented == set(rcpctl.commands)
