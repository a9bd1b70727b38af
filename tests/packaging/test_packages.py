"""What packages consist of fits together; `packaging/build.py` builds and the release verifies them."""

from __future__ import annotations

import os
import re
import runpy
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from unittest.mock import MagicMock
from xml.etree import ElementTree as ET

import pytest
import yaml
from catkin_pkg.package import parse_package

from docs.pages import ROOT
from rcpd.diagnosis import Diagnosis

FOLDER = ROOT / "packaging"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
SCRIPTS = [
    FOLDER / "container" / "base",
    FOLDER / "container" / "start",
    *sorted((FOLDER / "debian").glob("p*")),
]
ROS = FOLDER / "ros2" / "rcp_gateway_ros"


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_a_script_is_one_that_a_shell_takes(script: Path) -> None:
    assert os.access(script, os.X_OK)
    subprocess.run(["sh", "-n", script], check=True, timeout=30)


def test_the_container_takes_extras_that_there_are_and_starts_as_nobody_special() -> None:
    text = (FOLDER / "container" / "Containerfile").read_text()
    extras = re.findall(r"^ARG EXTRAS=(\S+)", text, re.MULTILINE)[0].split(",")
    assert set(extras) <= set(PROJECT["optional-dependencies"])
    build = (FOLDER / "build.py").read_text()
    assert f'EXTRAS = "{",".join(extras)}"' in build  # those of the Debian package
    assert f"\nARG VERSION={PROJECT['version']}\n" in text  # for those who build without build.py
    asked = re.findall(r'[ ]"(rcp-(?:gateway|client)[^"]*)"', text)
    assert len(asked) == 3
    assert all(one.endswith("==${VERSION}") for one in asked), asked
    assert "\nUSER rcp\n" in text
    for source in re.findall(r"^COPY ([^-\s]\S*)", text, re.MULTILINE):
        assert source.startswith("dist/") or (ROOT / source).exists()


def test_compose_serves_what_the_container_says() -> None:
    service = yaml.safe_load((FOLDER / "container" / "compose.yaml").read_text())["services"][
        "gateway"
    ]
    context = FOLDER / "container" / service["build"]["context"]
    assert (context / service["build"]["dockerfile"]).exists()
    port = service["ports"][0].partition(":")[2]
    assert f"EXPOSE {port}\n" in (FOLDER / "container" / "Containerfile").read_text()
    assert service["cap_drop"] == ["ALL"]
    assert port in service["healthcheck"]["test"][-1]


def test_the_first_start_of_a_container_writes_a_configuration_that_is_good(tmp_path: Path) -> None:
    program = tmp_path / "bin" / "rcpd"
    program.parent.mkdir()
    real = shutil.which("rcpd", path=str(Path(sys.executable).parent))
    program.write_text(f'#!/bin/sh\n[ "$1" = serve ] && exit 7\nexec {real} "$@"\n')
    program.chmod(0o755)
    environment = {"PATH": f"{program.parent}:/usr/bin:/bin", "HOME": str(tmp_path)}
    work = tmp_path / "state"
    work.mkdir()
    for _ in range(2):  # the second start keeps what is there
        done = subprocess.run(
            [FOLDER / "container" / "start"],
            cwd=work,
            env=environment,
            check=False,
            timeout=60,
            capture_output=True,
        )
        assert done.returncode == 7, done.stderr
    assert Diagnosis((work / "rcp.toml").read_text(), "rcp.toml").prepared() is not None


def test_the_ros_package_names_what_is_there() -> None:
    tree = ET.parse(ROS / "package.xml").getroot()
    assert tree.findtext("name") == ROS.name
    assert tree.findtext("version") == PROJECT["version"]
    assert tree.findtext("license") == PROJECT["license"]
    assert (ROS / "resource" / ROS.name).exists()
    assert (ROS / ROS.name / "__init__.py").exists()


def test_the_ros_package_is_one_that_a_workspace_takes() -> None:
    warnings: list[str] = []
    package = parse_package(ROS, warnings=warnings)  # one that it cannot read is a bare Python one
    assert package.get_build_type() == "ament_python"
    assert not warnings


@pytest.mark.parametrize("given", ["a-key-of-this-test-0123456789", None])
def test_the_launch_file_starts_a_gateway_with_a_key(
    given: str | None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`launch` itself is on no index: what is passed are names of its parameters."""
    for name in ("launch", "launch.actions", "launch.substitutions"):
        monkeypatch.setitem(sys.modules, name, MagicMock())
    if given is None:
        monkeypatch.delenv("OPERATOR_KEY", raising=False)
    else:
        monkeypatch.setenv("OPERATOR_KEY", given)
    launch = runpy.run_path(str(ROS / "launch" / "gateway.launch.py"))
    launch["generate_launch_description"]()
    (process,) = launch["ExecuteProcess"].call_args_list
    assert set(process.kwargs) <= {
        "additional_env",
        "cmd",
        "cwd",
        "env",
        "name",
        "output",
        "sigkill_timeout",
        "sigterm_timeout",
    }
    key = process.kwargs["additional_env"]["OPERATOR_KEY"]
    assert key == given if given else len(key) > 24
    assert capsys.readouterr().err == ("" if given else f"operator key: {key}\n")
    *program, serve, _config, _port, _number = process.kwargs["cmd"]
    assert serve == "serve"
    done = subprocess.run([*program, "--version"], capture_output=True, timeout=60, check=True)
    assert b"rcp-gateway" in done.stdout


def test_its_configuration_is_good(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPERATOR_KEY", "a-key-of-this-test-0123456789")
    text = (ROS / "config" / "gateway.toml").read_text()
    found = [one for one in Diagnosis(text, "gateway.toml").findings if "import" not in one.message]
    assert found == []


@pytest.mark.parametrize("name", ["fault", "idea", "protocol"])
def test_a_form_of_an_issue_has_its_parts(name: str) -> None:
    form = yaml.safe_load((ROOT / ".github" / "ISSUE_TEMPLATE" / f"{name}.yml").read_text())
    assert {"name", "description", "body"} <= set(form)
    for part in form["body"]:
        assert {"type", "id", "attributes"} <= set(part)
        assert part["attributes"]["label"]
