"""A name that nobody resolves holds no program up, neither Tab nor a command."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

_PROGRAM = """
import socket, threading
socket.getaddrinfo = lambda *_, **__: threading.Event().wait()  # as long as anybody would wait
from rcp_client.cli import main
main()
"""
_COMPLETING = {
    "_RCPCTL_COMPLETE": "bash_complete",
    "COMP_WORDS": "rcpctl read /sen",
    "COMP_CWORD": "2",
}


@pytest.mark.parametrize(
    ("arguments", "environment", "status"),
    [
        ([], _COMPLETING, 0),
        (["--timeout", "0.5", "status"], {}, 4),
        (["--timeout", "0.5", "estop"], {}, 4),
    ],
    ids=["completion", "command", "estop"],
)
def test_a_resolver_that_never_answers_keeps_no_program(
    arguments: list[str], environment: dict[str, str], status: int
) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM, *arguments],
        env={
            **os.environ,
            "RCP_URL": "https://robot.example:8443",
            "RCP_TOKEN": "x",
            **environment,
        },
        capture_output=True,
        text=True,
        check=False,
        timeout=90,
    )
    assert done.returncode == status, done.stderr
    assert "Traceback" not in done.stderr
