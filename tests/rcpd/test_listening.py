"""The command line says where `serve` listens; a port that is taken is one line."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

RCPD = [sys.executable, "-c", "from rcpd.cli import main; main()"]


@pytest.fixture
def taken() -> Iterator[int]:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        one.listen()
        yield one.getsockname()[1]


def run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*RCPD, *words], capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.parametrize("command", ["demo", "serve"])
def test_a_port_that_is_taken_is_one_line(command: str, taken: int, tmp_path: Path) -> None:
    file = tmp_path / "rcp.toml"
    file.write_text('[log]\nlevel = "error"\n[[backends]]\nuse = "sim"\ntenant = "a"\n')
    words = ["demo"] if command == "demo" else ["serve", str(file), "--host", "127.0.0.1"]
    done = run(*words, "--port", str(taken))
    assert done.returncode == 1
    lines = [line for line in done.stderr.splitlines() if line.startswith("rcpd: ")]
    assert len(lines) == 1
    assert f"cannot listen on 127.0.0.1:{taken}" in lines[0]
    assert "Traceback" not in done.stdout + done.stderr


def test_a_file_that_takes_the_listener_out_has_no_port(tmp_path: Path) -> None:
    file = tmp_path / "rcp.toml"
    file.write_text("[transports]\nasgi = false\n")
    done = run("serve", str(file), "--port", "0")
    assert done.returncode == 1
    assert done.stderr.startswith("rcpd: --host and --port are of [transports.asgi]")


def test_the_version() -> None:
    done = run("--version")
    assert done.returncode == 0
    assert done.stdout == run("version").stdout
