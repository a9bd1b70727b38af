"""The vehicle's parameters as resources: declared when listed, published, read and written."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Iterable, Sequence
from fnmatch import fnmatchcase
from typing import Any

from rcp_kernel.spi import Progress
from rcp_mavlink import messages as m
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.described import Described
from rcp_mavlink.paramcoding import REAL
from rcp_mavlink.parameter_hazards import check_latched
from rcp_mavlink.parameters import Parameters
from rcp_mavlink.resources import parameter
from rcp_mavlink.tree import VehicleTree
from rcp_mavlink.vehicle import Vehicle

__all__ = ["ParameterResources"]

_STORAGE = 245  # MAV_CMD_PREFLIGHT_STORAGE


class ParameterResources:
    """`param/*` of one vehicle; `listed` is called when the list has come."""

    def __init__(
        self,
        vehicle: Vehicle,
        tree: VehicleTree,
        commands: Commands,
        parameters: Parameters,
        described: Described,
        patterns: Sequence[str],
        *,
        listed: Callable[[], None],
    ) -> None:
        self._vehicle, self._tree, self._commands = vehicle, tree, commands
        self._parameters, self._described = parameters, described
        self._patterns, self._listed = patterns, listed

    def verbs(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return the handler of each path that is executed."""
        return {"service/param/read": self._read_any, "service/param/save": self._save}

    async def list(self) -> None:
        """Have the vehicle list its parameters, and declare those that the patterns name."""
        await self._parameters.list()
        self._listed()
        published = await self._described.load()
        known = self._parameters.known
        names = [n for n in known if any(fnmatchcase(n, p) for p in self._patterns)]
        made = [
            parameter(self._tree.name(f"param/{name}"), name, known[name].type, published)
            for name in sorted(names)
        ]
        if made:
            self._tree.declare(made)
        for name in names:
            self.publish(name)

    def publish(self, name: str) -> None:
        """Publish the value of a parameter, if it is a resource."""
        self._tree.publish(f"param/{name}", self.value(name))

    def value(self, name: str) -> float | int:
        """Return the last reported value of a parameter."""
        known = self._parameters.known[name]
        whole = known.type < REAL and math.isfinite(known.value)
        return int(known.value) if whole else known.value

    async def read(self, name: str) -> float | int:
        """Request the value of a parameter."""
        await self._parameters.read(name)
        return self.value(name)

    async def write(self, name: str, value: float) -> float | int:
        """Write a parameter; return the value in effect.

        :raises EstopActive: it may move the vehicle, whose e-stop is latched.
        """
        self.check_latched((name,))
        await self._parameters.write(name, value)
        return self.value(name)

    def check_latched(self, names: Iterable[str]) -> None:
        """Refuse parameters that may move a vehicle whose e-stop is latched."""
        if self._tree.is_latched():
            check_latched(names, armed=self._vehicle.armed)

    async def _read_any(self, given: m.ReadParam, _: Progress) -> m.ParamValue:
        return m.ParamValue(given.name, await self._parameters.read(given.name))

    async def _save(self, _: None, __: Progress) -> None:
        """Have PX4 store its parameters; ArduPilot has stored each at once, and refuses to be asked."""
        if self._vehicle.family.px4:
            await self._commands.send(Command(_STORAGE, (1.0, 0.0, 0.0, 0.0)), "save parameters")
