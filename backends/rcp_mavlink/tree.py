"""The place of one vehicle in the tree: its paths, and what is told to the kernel of it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from msgspec.structs import replace

from rcp_kernel.model import Resource
from rcp_kernel.spi import Anchor, Host
from rcp_mavlink.identity import describe
from rcp_mavlink.vehicle import Vehicle

__all__ = ["VehicleTree"]


class VehicleTree:
    """The resources of one vehicle; `prefix` is its name if there are several."""

    def __init__(self, host: Host, prefix: str) -> None:
        self._host, self.prefix = host, prefix
        self.scope = prefix or None
        """Its name for the kernel if there are several; None: the whole backend."""
        self._declared: set[str] = set()

    def name(self, name: str) -> str:
        """Return the path in the tree for one of the vehicle's own paths."""
        if not self.prefix:
            return name
        branch, _, rest = name.partition("/")
        return f"{branch}/{self.prefix}/{rest}"

    def declare(self, resources: Iterable[Resource]) -> None:
        """Declare resources, whose names are paths in the tree."""
        if self.prefix:
            resources = [replace(resource, robot=self.prefix) for resource in resources]
        resources = list(resources)
        self._host.declare(*resources)
        self._declared.update(resource.name for resource in resources)

    def publish(self, name: str, value: Any) -> None:
        """Publish a value of one of its own paths, if it has it."""
        full = self.name(name)
        if full in self._declared:
            self._host.publish(full, value)

    def describe(self, vehicle: Vehicle) -> None:
        """Tell what it is, as far as it has said."""
        self._host.describe(describe(vehicle), self.scope)

    def anchor(self, home: tuple[float, float, float]) -> None:
        """Tell where its map is: latitude and longitude (deg), height above sea level (m)."""
        latitude, longitude, altitude = home
        place = Anchor(latitude=latitude, longitude=longitude, altitude=altitude)
        self._host.anchor(place, self.scope)

    def is_latched(self) -> bool:
        """Return whether its e-stop is latched."""
        return self._host.is_latched(self.scope)
