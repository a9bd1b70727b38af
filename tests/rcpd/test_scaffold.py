"""What `rcpd new` writes is a distribution that installs, serves and passes the suite."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from rcp_kernel.errors import ConfigError
from rcpd.cli import main
from rcpd.scaffold import KINDS, write_plugin

BOUND = 120  # s
RCPD = "from rcpd.cli import main; main()"


def run(*command: str, cwd: Path, path: Path | None = None) -> str:
    """Run a program of this environment; return what it printed."""
    env = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    if path is not None:
        env["PYTHONPATH"] = str(path)
    done = subprocess.run(
        [sys.executable, *command],
        cwd=cwd,
        env=env,
        timeout=BOUND,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_it_installs_serves_and_passes_the_suite(tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["new", "backend", "lab-axis", "--into", str(tmp_path)])
    assert result.exit_code == 0, result.output
    made, site = tmp_path / "rcp-backend-lab-axis", tmp_path / "site"
    build = ["-m", "pip", "install", "-q", "--no-deps", "--disable-pip-version-check"]
    if importlib.util.find_spec("hatchling") is not None:
        build.append("--no-build-isolation")
    run(*build, "--target", str(site), str(made), cwd=tmp_path)
    config = tmp_path / "axis.toml"
    config.write_text('[[backends]]\nuse = "lab-axis"\ntenant = "lab"\nlength = 2.0\n')
    checked = run("-c", RCPD, "check", str(config), cwd=tmp_path, path=site)
    assert "lab-axis (lab-axis, tenant lab)" in checked
    output = run("-m", "pytest", "-q", "-p", "no:cacheprovider", cwd=made, path=site)
    assert " passed" in output
    assert " failed" not in output


def test_it_is_clean_and_short(tmp_path: Path) -> None:
    made = write_plugin("backend", "second_axis", tmp_path)
    module = made / "rcp_second_axis" / "__init__.py"
    assert len(module.read_text(encoding="utf-8").splitlines()) < 100
    assert "@" not in module.read_text(encoding="utf-8").replace("@hookimpl", "").replace(
        "@asynccontextmanager", ""
    )
    run("-m", "ruff", "check", "--no-cache", ".", cwd=made)
    run("-m", "ruff", "format", "--no-cache", "--check", ".", cwd=made)
    run("-m", "pyright", "--pythonpath", sys.executable, cwd=made)


@pytest.mark.parametrize("name", ["", "Axis", "9lives", "a b", "a--b", "-a", "a/b", "ä", "a" * 41])
def test_a_name_that_no_package_can_have_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigError, match="is not a valid backend name"):
        write_plugin("backend", name, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_what_is_there_already_is_left_alone(tmp_path: Path) -> None:
    made = write_plugin("backend", "axis", tmp_path)
    (made / "README.md").write_text("mine")
    with pytest.raises(ConfigError, match="already exists"):
        write_plugin("backend", "axis", tmp_path)
    assert (made / "README.md").read_text() == "mine"


def test_where_nothing_can_be_written_it_says_so(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="cannot be written"):
        write_plugin("backend", "axis", tmp_path / "file")


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "backend"])
def test_every_kind_passes_its_suite_without_being_installed(kind: str, tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["new", kind, "lab-thing", "--into", str(tmp_path)])
    assert result.exit_code == 0, result.output
    made = tmp_path / f"rcp-{kind}-lab-thing"
    # Of a transport's suite, a part: all of it runs in the tests of the documentation.
    few = ["-k", "ping or updates_come"] if kind == "transport" else []
    output = run("-m", "pytest", "-q", "-p", "no:cacheprovider", *few, cwd=made, path=made)
    assert " passed" in output
    assert " failed" not in output


@pytest.mark.parametrize("kind", list(KINDS))
def test_every_kind_is_clean_and_leaves_no_mark(kind: str, tmp_path: Path) -> None:
    made = write_plugin(kind, "lab-thing", tmp_path)
    for file in made.rglob("*.*"):
        assert not re.search(r"@[a-zA-Z]+@", file.read_text(encoding="utf-8")), file
    run("-m", "ruff", "check", "--no-cache", ".", cwd=made)
    run("-m", "pyright", "--pythonpath", sys.executable, cwd=made)
