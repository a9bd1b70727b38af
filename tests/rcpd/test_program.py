"""`rcpd` and `rcpctl` end without a traceback: by Ctrl-C while they start, or without an output."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAMS = ("rcpd", "rcp_client")
_IMPORTING = """
import signal, sys

program, before = sys.argv[1:]
sys.argv[1:] = ["--version"]

class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == program + ".cli":
            try:
                signal.raise_signal(signal.SIGINT)
            except KeyboardInterrupt:
                print("the module has taken it")

signal.signal(signal.SIGINT, getattr(signal, before))
sys.meta_path.insert(0, Interrupting())
__import__(program + ".__main__", fromlist=["main"]).main()
"""


def run(*command: str, shell: str = '"$@"') -> subprocess.CompletedProcess[bytes]:
    """Run a program by Python, as a shell starts it."""
    return subprocess.run(
        ["sh", "-c", f"exec {shell}", "sh", sys.executable, *command],
        capture_output=True,
        timeout=60,
        check=False,
    )


@pytest.mark.parametrize("program", PROGRAMS)
def test_an_interrupt_while_the_program_is_imported_ends_it(program: str) -> None:
    done = run("-c", _IMPORTING, program, "default_int_handler")
    assert done.returncode == -signal.SIGINT
    assert done.stdout + done.stderr == b""


@pytest.mark.parametrize("program", PROGRAMS)
def test_an_interrupt_that_is_ignored_stays_so(program: str) -> None:
    done = run("-c", _IMPORTING, program, "SIG_IGN")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(b"rc")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
@pytest.mark.parametrize(
    "command", [("rcpd", "schema"), ("rcpd", "--help"), ("rcp_client", "--help")]
)
def test_a_full_device_is_told(command: tuple[str, ...]) -> None:
    done = run("-m", *command, shell='"$@" >/dev/full')
    assert done.returncode == 1
    assert done.stderr.decode() == (
        f"{'rcpctl' if command[0] == 'rcp_client' else 'rcpd'}: its output cannot be written: "
        f"{os.strerror(28)}. Free some space, or write elsewhere.\n"
    )


def test_a_file_that_cannot_be_written_is_named() -> None:
    code = (
        "import errno; from rcp_protocol.program import as_program\n"
        "with as_program('rcpd'): raise OSError(errno.ENOSPC, 'no space', '/data/a.mcap')"
    )
    done = run("-c", code, shell='"$@"')
    assert done.stderr == (
        b"rcpd: '/data/a.mcap' cannot be written: no space. Free some space, or write elsewhere.\n"
    )


def test_a_command_needs_no_standard_output() -> None:
    done = run("-m", "rcp_client", "--url", "http://127.0.0.1:1", "estop", shell='"$@" >&-')
    assert done.returncode == 4, done.stderr
    assert b"cannot reach" in done.stderr


def test_a_character_that_the_output_lacks_is_replaced(tmp_path: Path) -> None:
    config = tmp_path / "rcp.toml"
    config.write_text('name = "Łódź"\n', encoding="utf-8")
    done = run("-m", "rcpd", "config", str(config), shell='env PYTHONIOENCODING=latin-1 "$@"')
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith('name = "?ód?"'.encode("latin-1"))
