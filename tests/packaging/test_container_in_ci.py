"""`.ci/container` tells what this machine cannot do from what is broken; the programs that it runs stand in for real ones."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from docs.pages import ROOT

_PROGRAMS = ("id", "unshare", "buildah", "mmdebstrap", "apt-helper")
_STANDIN = """#!/bin/sh
[ "$1" != -u ] || echo 0
[ "$1" != mount ] || { mkdir -p "$SYSTEM/etc/ssl/certs"; echo "$SYSTEM"; }
case "${0##*/} $*" in *"$FAILS"*) echo "no $FAILS" >&2; exit "$STATUS" ;; esac
"""


def told(folder: Path, fails: str, status: int = 1) -> tuple[int, str]:
    """Run it where a command that has these words fails; return its exit code and its first line."""
    programs = folder / "bin"
    programs.mkdir()
    for name in _PROGRAMS:
        (programs / name).write_text(_STANDIN)
        (programs / name).chmod(0o755)
    standing_in = {
        "PATH": f"{programs}:{os.environ['PATH']}",
        "SYSTEM": str(folder / "system"),
        "TMPDIR": str(folder),
        "FAILS": fails,
        "STATUS": str(status),
    }
    done = subprocess.run(
        ["bash", ROOT / ".ci" / "container", folder],
        env=os.environ | standing_in,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    return done.returncode, done.stdout.partition("\n")[0]


@pytest.mark.parametrize(
    ("fails", "status", "why"),
    [
        ("unshare", 1, "no namespaces for mounts"),
        ("buildah mount", 1, "buildah can mount nothing"),
        ("apt-helper", 100, "Debian's packages are not reached"),
        ("mmdebstrap", 124, "the base image takes too long here"),
        ("pip download", 1, "pip reaches no packages in it"),
    ],
)
def test_what_this_machine_cannot_do_is_told_and_is_no_failure(
    tmp_path: Path, fails: str, status: int, why: str
) -> None:
    assert told(tmp_path, fails, status) == (0, f"container: not built: {why}")


@pytest.mark.parametrize(
    ("fails", "why"),
    [
        ("mmdebstrap", "the base image cannot be made"),
        ("buildah commit", "the base image cannot be made"),
        ("buildah from localhost/rcp-base", "the base image cannot be used"),
        ("-m venv", "Python does not work in the base image"),
    ],
)
def test_a_broken_base_image_is_a_failure(tmp_path: Path, fails: str, why: str) -> None:
    assert told(tmp_path, fails) == (1, f"container: {why}")
