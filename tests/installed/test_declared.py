"""What the distributions declare is what their packages import."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Any

import pytest

from installed.fresh import ROOT

GATEWAY = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
CLIENT = tomllib.loads((ROOT / "clients/python/pyproject.toml").read_text())["project"]
EXTRAS = {
    "rcp_a2a": ("a2a", "grpc"),
    "rcp_can": ("can",),
    "rcp_conditions": ("conditions",),
    "rcp_configuration": ("configuration",),
    "rcp_dashboard": ("dashboard",),
    "rcp_fleet": ("fleet",),
    "rcp_guard": ("can", "ros2"),
    "rcp_hubs": ("hubs",),
    "rcp_jwt": ("jwt",),
    "rcp_asgi": ("tls",),
    "rcp_kernel": ("tls",),
    "rcp_mavlink": ("mavlink",),
    "rcp_mavlink_sim": ("mavlink",),
    "rcp_mcp": ("mcp", "dashboard"),  # pictures of raw images, where the dashboard's library is
    "rcp_recorder": ("recorder",),
    "rcp_recordings": ("recorder", "parquet"),
    "rcp_replay": ("recorder",),
    "rcp_mujoco": ("mujoco",),
    "rcp_ros2": ("ros2",),
    "rcp_tracing": ("tracing",),
    "rcp_triggers": ("triggers",),
    "rcp_vda5050": ("vda5050",),
    "rcp_zenoh": ("zenoh",),
    "rcpd": ("fast", "tls"),
}
"""The extras that bring what a package imports; any other has the dependencies alone."""
BROUGHT = packages_distributions()
KIT = {"hypothesis", "jsonschema", "pytest"}
"""What `rcp_gateway.testing` needs: it is for those who test."""
LATER = {"compression"}
"""What the standard library has from Python 3.14 on."""
MESSAGES = re.compile(
    r"rclpy|rosidl_\w+|rcl_interfaces|ament_index_python|\w+_(msgs|srvs|interfaces)"
)
"""Modules of ROS 2, which come with `ros-rclpy` or with a sourced ROS 2."""


def packages() -> Iterator[Path]:
    for folder in (".", "clients/python", "transports", "plugins", "backends"):
        for found in sorted((ROOT / folder).glob("rcp*/__init__.py")):
            yield found.parent


def imported(package: Path) -> set[str]:
    """Return the modules of others that a package imports anywhere."""
    found: set[str] = set()
    for file in package.rglob("*.py"):
        if "node_modules" in file.parts or file.is_relative_to(package / "web"):
            continue
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {name.name.partition(".")[0] for name in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                found.add(node.module.partition(".")[0])
    ours = {one.name for one in packages()}
    return {
        name
        for name in found - sys.stdlib_module_names - LATER - ours
        if not MESSAGES.fullmatch(name)
    }


def names(requirements: list[str]) -> set[str]:
    return {re.split(r"[\s\[<>=;~!]", one, maxsplit=1)[0].lower() for one in requirements}


def of_extra(extra: str) -> set[str]:
    """Return what an extra of the gateway brings, with what it has of other extras."""
    found: set[str] = set()
    for one in GATEWAY["optional-dependencies"][extra]:
        own = re.match(r"rcp-gateway\[([\w,-]+)\]", one)
        found |= set().union(*map(of_extra, own[1].split(","))) if own else names([one])
    return found


def declared(project: dict[str, Any], package: str) -> set[str]:
    found = names(project["dependencies"])
    for extra in EXTRAS.get(package, ()) if project is GATEWAY else ():
        found |= of_extra(extra)
    if project is GATEWAY:
        found |= names(CLIENT["dependencies"])
    else:  # and OpenTelemetry, but only of a program that has it
        found |= names(CLIENT["optional-dependencies"]["console"]) | {"opentelemetry-api"}
    return found


@pytest.mark.parametrize("package", list(packages()), ids=lambda path: path.name)
def test_whatever_is_imported_is_declared(package: Path) -> None:
    project = CLIENT if package.parent.name == "python" else GATEWAY
    allowed = declared(project, package.name)
    modules = imported(package) - (KIT if package.name == "rcp_gateway" else set())
    for module in sorted(modules):
        of = {re.sub(r"[-_.]+", "-", name).lower() for name in BROUGHT.get(module, [module])}
        assert of & allowed, f"{package.name} imports {module}, of {', '.join(sorted(of))}"


def test_both_distributions_have_one_version() -> None:
    assert CLIENT["version"] == GATEWAY["version"]
    assert f"rcp-client=={CLIENT['version']}" in GATEWAY["dependencies"]
