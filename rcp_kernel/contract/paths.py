"""Full paths: their segments, those that several parts know, and the paths that a record names.

A full path is `/tenant/<tenant>/<branch>/<name>…`, or lies in `/system`. Where a backend has robots,
the first name is that of the robot.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

__all__ = [
    "ESTOP",
    "EVERYTHING",
    "MOST_TOUCHES",
    "bounded_touches",
    "can_name_resource",
    "depth_in_tenant",
    "is_system",
    "names_of",
]

ESTOP = "/system/estop"
"""The e-stop: requests to it are never limited, and its replies are sent whatever else waits."""
EVERYTHING = "/**"
"""Stands for all paths: only readers from whom nothing is hidden may see such a record."""
MOST_TOUCHES = 256
"""Maximum number of further paths of a record; beyond it, the record counts as naming everything."""


def is_system(path: str) -> bool:
    """Return whether a path is in the gateway's own branch."""
    return path.startswith("/system/")


def depth_in_tenant(path: str) -> int:
    """Return how deep a full path lies: 0 is the tenant, 1 a branch or a robot, from 2 on resources."""
    return path.count("/") - 2


def can_name_resource(path: str) -> bool:
    """Return whether a full path in a tenant is long enough for a resource; shorter ones are scopes."""
    return depth_in_tenant(path) >= 2


def names_of(path: str, tenant: str | None) -> list[str]:
    """Return the names after tenant and branch in a full path; none if it is in another tenant."""
    segments = path.split("/")
    return segments[4:] if segments[1:3] == ["tenant", tenant] else []


def bounded_touches(paths: Iterable[str]) -> tuple[str, ...]:
    """Remove duplicates; return only `EVERYTHING` if there are too many, or it is among them.

    Readers of a record must be allowed to see all of them.
    """
    found = tuple(islice(dict.fromkeys(paths), MOST_TOUCHES + 1))
    return (EVERYTHING,) if len(found) > MOST_TOUCHES or EVERYTHING in found else found
