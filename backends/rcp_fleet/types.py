"""The types of the robots' resources: each schema is fetched and compiled once for all of them."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Annotated, Any, NewType

from msgspec import Meta

from rcp_client.client import Client
from rcp_client.messages import ResourceInfo
from rcp_kernel.values import value_type

__all__ = ["RobotTypes"]

_AT_ONCE = 4  # gateways asked again at once


class RobotTypes:
    """Types by the id of their schema, which has its digest."""

    def __init__(self) -> None:
        self._known: dict[str, Any] = {}
        self._fetching = asyncio.Lock()
        """Robots of one kind come in numbers: the first one's schemas serve all."""
        self.turns = asyncio.Semaphore(_AT_ONCE)
        """Taken by what asks gateways once more for what is not urgent."""

    async def discover(self, client: Client, pattern: str) -> list[ResourceInfo]:
        """List the resources of a gateway, and learn the types that are new."""
        found = await client.discover(pattern, schemas=False, offers=True)
        if self._lacks(found):
            async with self._fetching:
                if self._lacks(found):
                    found = await client.discover(pattern, offers=True)
                    self._learn(found)
        return found

    def of(self, schema_id: str) -> Any:
        """Return a type that has this schema and accepts anything: the robot's gateway validates."""
        return self._known[schema_id]

    def _lacks(self, found: Iterable[ResourceInfo]) -> bool:
        return any(id_ not in self._known for info in found for id_ in info.schema_ids.values())

    def _learn(self, found: Iterable[ResourceInfo]) -> None:
        for info in found:
            for part, id_ in info.schema_ids.items():
                if id_ not in self._known:
                    type_ = _type(id_.rpartition(".")[0], info.schemas[part])
                    # A robot must not name its schema by the id of another's.
                    info.schema_ids[part] = actual = value_type(type_).schema_id
                    self._known.setdefault(actual, type_)


def _type(name: str, schema: dict[str, Any]) -> Any:
    bare = {key: item for key, item in schema.items() if key != "$id"}
    make: Any = NewType  # hashable, and named in the schema's id, as `Annotated` is not
    return make(name, Annotated[Any, Meta(extra_json_schema=bare)])
