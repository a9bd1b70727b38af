"""A gateway's resources, as the hub declares them."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

from rcp_client.messages import ResourceInfo
from rcp_kernel.model import Operation, Resource
from rcp_kernel.spi import Dimensions, RobotFacts

__all__ = [
    "CONFIGURATION",
    "ESTOP",
    "LEASES",
    "ROBOTS",
    "STATUS",
    "TREE",
    "facts_of",
    "name_of",
    "resource_of",
]

TREE, STATUS, ROBOTS, ESTOP = "/system/tree", "/system/status", "/system/robots", "/system/estop"
LEASES = "/system/leases"
"""What a hub follows of a gateway."""

CONFIGURATION = "/system/configuration"
"""The one path of a gateway's own that hubs show."""


def name_of(path: str, gateway: str) -> str:
    """Return the hub's name of a gateway's path: its id follows the branch."""
    if path == CONFIGURATION:
        return f"service/{gateway}/gateway/configuration"
    _, _, _, branch, rest = path.split("/", 4)
    return f"{branch}/{gateway}/{rest}"


def resource_of(info: ResourceInfo, gateway: str, type_of: Callable[[str], Any]) -> Resource:
    """Describe a resource that the gateway of a robot serves; `type_of` knows its schemas' ids.

    The robot's own serialized bytes do not cross the link, so that `native` is left out.
    """
    offered = info.operations if info.offers is None else info.offers
    types = {name: type_of(id_) for name, id_ in info.schema_ids.items()}
    if info.path == CONFIGURATION:  # discovery does not tell the type of a service's value
        types["value"] = types["output"]
    return Resource(
        name=name_of(info.path, gateway),
        description=info.description,
        robot=gateway,
        operations=_operations(tuple(offered)),
        examples=tuple(info.examples),
        deadline=info.deadline,
        timeout=info.timeout,
        policy=info.policy,  # pyright: ignore[reportArgumentType] - of the same protocol
        max_age=info.max_age,
        valid_for=info.valid_for,
        safe=info.safe,
        moves=info.moves,
        energises=info.energises,
        atomic=info.atomic,
        meta={**info.meta, "gateway": gateway, "path": info.path},
        profiles=tuple(info.profiles),
        **types,
    )


@lru_cache
def _operations(names: tuple[str, ...]) -> Operation:
    """Return what a resource offers here, where discovery is the hub's own."""
    operations = Operation.NONE
    for name in names:
        operations |= Operation[name.upper()]
    return operations & ~Operation.DISCOVER


def facts_of(robots: list[dict[str, Any]]) -> RobotFacts:
    """Return what a gateway's inventory says of its robot; of several, it says nothing."""
    if len(robots) != 1:
        return RobotFacts()
    (told,) = robots
    sheet = told.get("fact_sheet", {})
    dimensions = sheet.get("dimensions")
    return RobotFacts(
        kind=told.get("kind"),
        vendor=told.get("vendor"),
        model=told.get("model"),
        firmware=told.get("firmware"),
        serial=told.get("serial"),
        dimensions=None if dimensions is None else Dimensions(**dimensions),
        frames=tuple(sheet.get("frames", ())),
    )
