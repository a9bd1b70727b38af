"""What tries the packages ends what it began, and tells what went wrong first."""

from __future__ import annotations

import importlib
import os
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


def test_a_base_image_that_cannot_be_pulled_leaves_out_the_container_alone(
    verify: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    build, made = sys.modules["build"], list[str]()
    podman = tmp_path / "podman"
    podman.write_text("#!/bin/sh\necho 'no such host' >&2\nexit 125\n")
    podman.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("RCP_BASE", raising=False)
    monkeypatch.setattr(build, "DIST", tmp_path / "dist")
    monkeypatch.setattr(build, "STEPS", {n: lambda n=n: made.append(n) for n in build.STEPS})
    monkeypatch.setattr(sys, "argv", ["build.py"])
    build.main()
    assert made == [step for step in build.STEPS if step != "container"]
    told = capsys.readouterr().out
    assert "no container: docker.io/library/python" in told
    assert "(no such host); with RCP_BASE=NAME" in told
    monkeypatch.setenv("RCP_BASE", "localhost/base")
    build.main()
    assert "container" in made


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
