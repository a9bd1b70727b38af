"""What an e-stop stops as one: a backend's robot, or one of several that a backend fronts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rcp_kernel.motion.latches import tenant_key

if TYPE_CHECKING:
    from rcp_kernel.motion.latches import Latch, Latches
    from rcp_kernel.registry import Entry, Owner
    from rcp_kernel.spi import Backend

__all__ = ["Unit"]


class Unit:
    """All robots of a backend, or one of them that it can halt alone."""

    __slots__ = (
        "_latches",
        "_released",
        "_stops",
        "keys",
        "name",
        "own",
        "owner",
        "retired",
        "robot",
        "whole",
    )

    def __init__(self, owner: Owner, latches: Latches | None, robot: str | None = None) -> None:
        self.owner = owner
        self.robot = robot
        """The one robot's name in the tree; None means all of the backend."""
        self.whole: Unit = self if robot is None else owner.unit(None)
        self.name = owner.name if robot is None else f"{owner.name}/{robot}"
        """The key of its latch."""
        tenant = "" if owner.tenant is None else tenant_key(owner.tenant)
        self.keys = (self.name, tenant) if robot is None else (self.name, owner.name, tenant)
        """The keys of all latches that hold it but the gateway's, the narrowest first."""
        self.retired: Latch | None = None
        """What holds it for good."""
        self._latches = latches
        self.own: dict[str, Entry] = {}
        """The resources that are its own: of all of a backend, those of none of its robots."""
        self._stops = 0
        self._released = 0

    @property
    def place(self) -> str | None:
        """The segment after the branch in all of its paths; None without one."""
        return self.owner.robot or self.robot

    @property
    def tenant(self) -> str | None:
        """Whose it is."""
        return self.owner.tenant

    @property
    def latch(self) -> Latch | None:
        """The e-stop that holds it, or None."""
        if self._latches is None:
            return None
        return self.whole.retired or self._latches.of(self.keys)

    @property
    def stops(self) -> int:
        """How many e-stops it has had: what was admitted before one never reaches it."""
        return self._stops if self.robot is None else self._stops + self.whole.stops

    @property
    def released(self) -> int:
        """When the last e-stop on it was reset, ns; 0 if none was in this run."""
        return self._released if self.robot is None else max(self._released, self.whole.released)

    @property
    def entries(self) -> dict[str, Entry]:
        """The resources that stop with it, by the backend's own names."""
        return self.owner.entries if self.robot is None else self.own

    @property
    def backend(self) -> Backend | None:
        """The open backend, or None."""
        return self.owner.backend

    def count_stop(self) -> None:
        """Let nothing that was admitted until now reach it."""
        self._stops += 1

    def release(self, moment: int) -> None:
        """Let nothing that was sent before `moment`, in ns, reach it."""
        self._released = moment

    async def halt(self) -> None:
        """Bring it to rest, if there is a backend that can."""
        backend = self.backend
        if backend is not None:
            await (backend.halt() if self.robot is None else backend.halt_robot(self.robot))
