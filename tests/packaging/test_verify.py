"""What tries the packages ends what it began, and tells what went wrong first."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from docs.pages import ROOT

_STUBBORN = """
import os, signal
signal.signal(signal.SIGTERM, signal.SIG_IGN)
open("pid", "w").write(str(os.getpid()))
print("rcpd: serving", flush=True)
signal.pause()
"""


@pytest.fixture
def verify(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(str(ROOT / "packaging"))
    yield importlib.import_module("verify")
    for name in ("verify", "build"):
        del sys.modules[name]


@pytest.mark.parametrize("step", ["deb", "container"])
def test_what_is_made_of_wheels_says_when_there_are_none(
    verify: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, step: str
) -> None:
    build = sys.modules["build"]
    monkeypatch.setattr(build, "DIST", tmp_path)
    monkeypatch.setattr(build, "_builder", lambda: "buildah")
    with pytest.raises(SystemExit, match=f"build.py wheels {step}"):
        build.STEPS[step]()


@pytest.fixture
def made(verify: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """The steps that a build without names took, with the builders of `tmp_path` alone."""
    build, made = sys.modules["build"], list[str]()
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("RCP_BASE", raising=False)
    monkeypatch.setattr(build, "DIST", tmp_path / "dist")
    monkeypatch.setattr(build, "STEPS", {n: lambda n=n: made.append(n) for n in build.STEPS})
    monkeypatch.setattr(sys, "argv", ["build.py"])
    return made


def builder(folder: Path, name: str, script: str) -> None:
    (folder / name).write_text(f"#!/bin/sh\n{script}\n")
    (folder / name).chmod(0o755)


def test_a_base_image_that_cannot_be_pulled_leaves_out_the_container_alone(
    made: list[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    build = sys.modules["build"]
    builder(tmp_path, "podman", "echo 'no such host' >&2; exit 125")
    with pytest.raises(SystemExit, match="no container: --partial"):
        build.main()
    assert made == [step for step in build.STEPS if step != "container"]
    told = capsys.readouterr().out
    assert "no container: docker.io/library/python" in told
    assert "(no such host); with RCP_BASE=NAME" in told
    assert (tmp_path / "dist" / "SHA256SUMS").exists()
    monkeypatch.setattr(sys, "argv", ["build.py", "--partial"])
    build.main()
    assert "container" not in made
    monkeypatch.setenv("RCP_BASE", "localhost/base")
    build.main()
    assert "container" in made


@pytest.mark.parametrize(
    ("name", "asks"),
    [
        ("podman", "image inspect"),
        ("docker", "image inspect"),
        ("buildah", "inspect --type image"),
    ],
)
def test_a_base_image_that_is_here_is_not_pulled(
    made: list[str], tmp_path: Path, name: str, asks: str
) -> None:
    builder(tmp_path, name, f'case "$*" in "{asks} docker.io/"*) ;; *) exit 1 ;; esac')
    sys.modules["build"].main()
    assert "container" in made


def test_a_registry_that_does_not_answer_is_given_up(
    made: list[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    build = sys.modules["build"]
    monkeypatch.setattr(build, "_PULL", 0.2)
    builder(tmp_path, "podman", 'case "$1" in pull) read line < fifo ;; *) exit 1 ;; esac')
    os.mkfifo(tmp_path / "fifo")  # nobody writes to it
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match="--partial"):
        build.main()
    assert "no answer within 0.2 s" in capsys.readouterr().out


def test_a_machine_without_a_builder_builds_the_rest(made: list[str]) -> None:
    sys.modules["build"].main()
    assert made == [step for step in sys.modules["build"].STEPS if step != "container"]


def test_an_image_that_a_release_lacks_is_a_failure_at_the_end(
    verify: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    tried: list[str] = []
    monkeypatch.delenv("RCP_IMAGE", raising=False)
    monkeypatch.setattr(verify, "DIST", tmp_path)
    monkeypatch.setattr(verify, "tool", lambda name: name)
    ways = {"container": verify.container, "docs": lambda _: tried.append("docs")}
    monkeypatch.setattr(verify, "WAYS", ways)
    monkeypatch.setattr(sys, "argv", ["verify.py"])
    with pytest.raises(SystemExit, match=r"no rcp-gateway-.*\.oci\.tar: --partial"):
        verify.main()
    assert tried == ["docs"]
    monkeypatch.setattr(sys, "argv", ["verify.py", "--partial"])
    verify.main()


def test_a_program_that_does_not_end_is_ended(
    verify: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(verify, "_LONGEST", 0.2)
    with pytest.raises(SystemExit, match=r"has not ended after 0\.2 s"):
        verify.run(sys.executable, "-c", "import signal; signal.pause()")


def test_a_file_that_is_no_python_3_does_not_end_the_build_of_the_image(tmp_path: Path) -> None:
    (tmp_path / "old.py").write_text("print 'a'\n")
    (tmp_path / "new.py").write_text("print('a')\n")
    text = (ROOT / "packaging/container/Containerfile").read_text()
    (step,) = [one.strip() for one in text.split("&&") if "compileall" in one]
    command = step.split("\n\n")[0].replace("/opt/rcp-gateway/lib", str(tmp_path))
    command = command.replace("python3", sys.executable)
    assert subprocess.run(["sh", "-c", command], check=False).returncode == 0
    assert [*(tmp_path / "__pycache__").glob("new.*.pyc")]


def test_a_gateway_that_ignores_its_end_is_ended(
    verify: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(verify, "_STOP", 0.2)
    with verify.serving([sys.executable, "-c", _STUBBORN], tmp_path):
        pid = int((tmp_path / "pid").read_text())
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


def test_a_package_that_does_not_install_is_told_and_nothing_stays_mounted(
    verify: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    ran: list[str] = []

    def run(*command: object, **_: str) -> str:
        words = [str(word) for word in command]
        ran.append(next(word for word in words if word in ("mount", "-i", "--purge", "umount")))
        if "dpkg" in words:
            raise SystemExit(f"dpkg {ran[-1]} fails")
        return ""

    (tmp_path / "tmp").mkdir()
    (tmp_path / "one.deb").touch()
    monkeypatch.setenv("RCP_CHROOT", str(tmp_path))
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.setattr(verify, "DIST", tmp_path)
    monkeypatch.setattr(verify, "tool", lambda name: name)
    monkeypatch.setattr(verify, "run", run)
    with pytest.raises(SystemExit, match="dpkg -i fails"):
        verify.deb(tmp_path)
    assert ran == ["mount", "-i", "--purge", "umount"]
    assert "dpkg --purge fails" in capsys.readouterr().err
