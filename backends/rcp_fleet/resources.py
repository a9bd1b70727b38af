"""A gateway's resources, as the hub declares them."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import Meta

from rcp_client.messages import ResourceInfo
from rcp_kernel.model import Operation, Resource

__all__ = ["name_of", "resource_of"]


def name_of(path: str, gateway: str) -> str:
    """Return the hub's name of a gateway's path: its id follows the branch."""
    _, _, _, branch, rest = path.split("/", 4)
    return f"{branch}/{gateway}/{rest}"


def resource_of(info: ResourceInfo, gateway: str) -> Resource:
    """Describe a resource that the gateway of a robot serves."""
    operations = Operation.NONE
    for name in info.operations:
        operations |= Operation[name.upper()]
    return Resource(
        name=name_of(info.path, gateway),
        description=info.description,
        robot=gateway,
        operations=operations & ~Operation.DISCOVER,
        examples=tuple(info.examples),
        deadline=info.deadline,
        timeout=info.timeout,
        policy=info.policy,  # pyright: ignore[reportArgumentType] - of the same protocol
        max_age=info.max_age,
        meta={**info.meta, "gateway": gateway, "path": info.path},
        **{name: _type(schema) for name, schema in info.schemas.items()},
    )


def _type(schema: dict[str, Any]) -> Any:
    """Return a type that has this schema and accepts anything: the robot's gateway validates."""
    bare = {key: item for key, item in schema.items() if key != "$id"}
    return Annotated[Any, Meta(extra_json_schema=bare)]
