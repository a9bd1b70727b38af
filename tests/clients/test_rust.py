"""Generated Rust compiles whatever a catalogue says, and drives a robot of the demo, also when connections are cut."""

from __future__ import annotations

import os
import re
import shutil
import socket
import subprocess
from collections.abc import Generator
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import httpx
import msgspec
import pytest

from clients.cutting import CuttingProxy
from docs.demo import BIN, Demo, demo
from docs.pages import ROOT
from plugins.client.test_codegen import HOSTILE
from programs import program
from rcp_client import ResourceInfo
from rcp_client.codegen import generate
from rcp_protocol.published_schema import published

EXAMPLE = ROOT / "examples" / "rust" / "main.rs"
_PATIENCE = 240  # s for the compiler, and for the example, on a busy machine


def rustc(source: Path, *options: str) -> None:
    done = subprocess.run(
        [program("rustc"), "--edition", "2021", "-D", "warnings", *options, str(source)],
        cwd=source.parent,
        capture_output=True,
        text=True,
        check=False,
        timeout=_PATIENCE,
    )
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Generator[Demo]:
    with demo(tmp_path_factory.mktemp("runtime")) as live:
        yield live


@pytest.fixture(scope="module")
def example(running: Demo, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The example, compiled with what was generated for the demo."""
    folder = tmp_path_factory.mktemp("rust")
    shutil.copy(EXAMPLE, folder)
    text = subprocess.run(
        [BIN / "rcpctl", "codegen", "--lang", "rust"],
        env=running.environment | {"RCP_URL": running.url},
        capture_output=True,
        text=True,
        check=True,
        timeout=_PATIENCE,
    ).stdout
    (folder / "rcp.rs").write_text(text, encoding="utf-8")
    rustc(folder / "main.rs")
    return folder / "main"


def drives(example: Path, url: str, key: str) -> None:
    done = subprocess.run(
        [example],
        env=os.environ | {"RCP_URL": url, "RCP_TOKEN": key},
        capture_output=True,
        text=True,
        check=False,
        timeout=_PATIENCE,
    )
    assert done.returncode == 0, done.stderr
    *poses, refused, there, ended = done.stdout.splitlines()
    assert len(poses) == 3
    assert all(re.fullmatch(r"\d+ x -?\d+\.\d\d m", line) for line in poses)
    assert [refused, there, ended] == [
        "refused: out_of_range",
        "there: x 0.5 y 0.5",
        "ended: cancelled",
    ]


def test_leases_and_connections_at_a_gateway(example: Path, running: Demo) -> None:
    shutil.copy(Path(__file__).with_name("live_test.rs"), example.parent)
    rustc(example.parent / "live_test.rs", "--test")
    passes(
        example.parent / "live_test",
        RCP_URL=running.url,
        RCP_TOKEN=running.key,
        RCP_ADMIN=running.admin,
    )


def passes(tests: Path, **environment: str) -> None:
    """Run a program of tests."""
    done = subprocess.run(
        [tests],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=_PATIENCE,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_odd_names_and_texts_are_good_rust(tmp_path: Path) -> None:
    (tmp_path / "odd.rs").write_text(generate("rust", HOSTILE, "http://h\n*/"), encoding="utf-8")
    rustc(tmp_path / "odd.rs", "--crate-type", "lib", "--emit", "metadata")


CATALOGUE = [
    ResourceInfo(
        path="/tenant/alpha/action/drive",
        kind="action",
        operations=["execute"],
        schemas={"input": {"type": "number"}, "output": {"type": "string"}},
    ),
    ResourceInfo(
        path="/tenant/alpha/param/ticks",
        kind="param",
        operations=["read", "write", "subscribe"],
        schemas={"value": published(msgspec.json.schema(Annotated[int, msgspec.Meta(ge=0)]))},
    ),
]


def test_what_is_lost_or_refused_while_a_robot_drives(tmp_path: Path) -> None:
    shutil.copy(Path(__file__).with_name("execute_test.rs"), tmp_path)
    (tmp_path / "rcp.rs").write_text(generate("rust", CATALOGUE, "http://h"), encoding="utf-8")
    rustc(tmp_path / "execute_test.rs", "--test")
    with ExitStack() as stack:
        silent = stack.enter_context(socket.create_server(("127.0.0.1", 0), backlog=0))
        for _ in range(8):  # the queue is full then: the kernel leaves the next one unanswered
            waiting = stack.enter_context(socket.socket())
            waiting.setblocking(False)
            waiting.connect_ex(silent.getsockname())
        url = f"http://127.0.0.1:{silent.getsockname()[1]}"
        passes(tmp_path / "execute_test", RCP_SILENT=url)


def test_the_example_drives(example: Path, running: Demo) -> None:
    drives(example, running.url, running.key)


def test_the_example_drives_once_though_answers_are_lost(example: Path, running: Demo) -> None:
    before = commands(running)
    with CuttingProxy(running.url) as proxy:
        drives(example, proxy.url, running.key)
        assert proxy.cuts > 4
    assert commands(running) == before + 2


def commands(running: Demo) -> int:
    """Count the commands that drove the robot."""
    path = "/rcp/v1/commands?path=/tenant/alpha/action/move_to&limit=1000"
    headers = {"authorization": f"Bearer {running.key}"}
    return len(httpx.get(running.url + path, headers=headers, timeout=_PATIENCE).json()["body"])
