"""Generated Go compiles whatever a catalogue says, drives a robot of the demo, and leaves none moving."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

from docs.demo import BIN, demo
from docs.pages import ROOT
from plugins.client.test_codegen import HOSTILE
from programs import program
from rcp_client.codegen import generate

EXAMPLE = ROOT / "examples" / "go"


def go(folder: Path, *arguments: str, **environment: str) -> str:
    own = {"GOFLAGS": "-mod=mod", "GOPROXY": "off", "CGO_ENABLED": "0"}
    done = subprocess.run(
        [program("go"), *arguments],
        cwd=folder,
        env={**os.environ, **own, **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_example_drives_with_what_was_generated_and_survives_cuts(tmp_path: Path) -> None:
    for name in ("go.mod", "main.go"):
        shutil.copy(EXAMPLE / name, tmp_path)
    (tmp_path / "rcp").mkdir()
    (tmp_path / "odd").mkdir()
    (tmp_path / "odd" / "odd.go").write_text(generate("go", HOSTILE, "http://robots"))
    (tmp_path / "runtime").mkdir()
    with demo(tmp_path / "runtime") as live:
        text = subprocess.run(
            [BIN / "rcpctl", "codegen", "--lang", "go"],
            env=live.environment | {"RCP_URL": live.url},
            capture_output=True,
            text=True,
            check=True,
            timeout=120,
        ).stdout
        (tmp_path / "rcp" / "rcp.go").write_text(text)
        go(tmp_path, "vet", "./odd", ".")
        out = go(tmp_path, "run", ".", RCP_URL=live.url, RCP_TOKEN=live.key)
        shutil.copy(Path(__file__).with_name("live_test.go"), tmp_path)
        admin = re.search(r"rcp_ad_[\w-]+", live.banner)
        assert admin is not None
        keys = {"RCP_TOKEN": live.key, "RCP_ADMIN": admin[0]}
        go(tmp_path, "test", "-count=1", ".", RCP_URL=live.url, **keys)
    lines = out.splitlines()
    assert [line.split()[1] for line in lines[:3]] == ["x"] * 3
    assert lines[3:] == ["refused: out_of_range", "there: x 0.5 y 0.5", "ended: cancelled"]


def test_a_command_ends_or_is_cancelled_whatever_happens_to_its_context_and_connection(
    tmp_path: Path,
) -> None:
    shutil.copy(EXAMPLE / "go.mod", tmp_path)
    shutil.copy(Path(__file__).with_name("execute_test.go"), tmp_path)
    (tmp_path / "rcp.go").write_text(generate("go", HOSTILE, "http://robots"))
    go(tmp_path, "test", "-count=1", ".")
