"""Metadata of files: of the recording, the software and the robots. No secret is among it."""

from __future__ import annotations

import platform
from collections.abc import Iterable, Mapping, Sequence

from rcp_kernel.contract.version import gateway_version
from rcp_kernel.model import Pattern
from rcp_kernel.tree.entry import RobotUnit

__all__ = ["about", "robot_path", "robots_of"]


def about(name: str, patterns: Sequence[Pattern], **more: str) -> dict[str, str]:
    """Describe a recording and the software."""
    return {
        "recording": name,
        "paths": " ".join(pattern.text for pattern in patterns),
        "gateway": gateway_version(),
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        **more,
    }


def robot_path(unit: RobotUnit) -> str:
    """Return the path of a robot, as the inventory lists it."""
    return "/".join(filter(None, (f"/tenant/{unit.tenant}", unit.owner.robot, unit.robot)))


def robots_of(units: Iterable[RobotUnit]) -> Mapping[str, Mapping[str, str]]:
    """Describe robots."""
    robots: dict[str, dict[str, str]] = {}
    for unit in units:
        facts = unit.facts
        known = {
            "backend": unit.owner.name,
            "kind": facts.kind,
            "vendor": facts.vendor,
            "model": facts.model,
            "firmware": facts.firmware,
            "serial": facts.serial,
        }
        told = {key: value for key, value in known.items() if value}
        robots[robot_path(unit)] = robots.get(robot_path(unit), {}) | told
    return robots
