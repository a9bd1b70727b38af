"""What robots say of themselves in the graph, for the inventory."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Mapping as Named
from collections.abc import Set as AbstractSet

from rcp_kernel.spi import Host, RobotFacts
from rcp_ros2.binding import Binding
from rcp_ros2.description import Descriptions
from rcp_ros2.naming import Naming

__all__ = ["Facts"]


class Facts:
    """Describes each robot, and again when more is known of it."""

    def __init__(
        self,
        host: Host,
        naming: Naming,
        bindings: Named[str, Binding],
        descriptions: Descriptions,
        hardware: Callable[[str], AbstractSet[str]],
    ) -> None:
        """Tell with `hardware` the hardware ids in the diagnostics of a namespace.

        Frames are not told: what is told is where goals are taken without conversion, and a node of
        the graph does not say that.
        """
        self._host = host
        self._naming = naming
        self._bindings = bindings
        self._descriptions = descriptions
        self._hardware = hardware
        self._told: dict[str | None, RobotFacts] = {}

    def tell(self) -> None:
        """Describe the robots of which something new is known."""
        spaces: dict[str | None, str] = {}
        profiles: dict[str | None, set[str]] = {}
        for binding in self._bindings.values():
            robot, space, _ = self._naming.split(binding.mapping.target)
            if robot == binding.resource.robot:
                spaces[robot] = space
                own = profiles.setdefault(robot, set())
                own.update(id_.partition("/")[0] for id_ in binding.resource.profiles)
        for robot, space in spaces.items():
            facts = self._facts(space, profiles[robot])
            if facts != self._told.get(robot, RobotFacts()):
                self._told[robot] = facts
                self._host.describe(facts, robot)

    def _facts(self, space: str, profiles: set[str]) -> RobotFacts:
        description, hardware = self._descriptions.of(space), self._hardware(space)
        return RobotFacts(
            kind="arm" if "arm" in profiles and "drive" not in profiles else None,
            model=None if description is None else description.name,
            serial=next(iter(hardware)) if len(hardware) == 1 else None,  # of parts there are many
        )
