"""What an e-stop stops as one: a backend's robot, or one of several that a backend fronts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rcp_kernel.motion.latches import robot_key, tenant_key

if TYPE_CHECKING:
    from rcp_kernel.motion.latches import Latch, Latches
    from rcp_kernel.registry import Entry, Owner
    from rcp_kernel.spi import Backend, MotionState

__all__ = ["StopGroup"]


class StopGroup:
    """All robots of a backend, or one of them that it can halt alone."""

    __slots__ = (
        "_latches",
        "_released",
        "_stops",
        "identity",
        "keys",
        "lost",
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
        self.whole: StopGroup = self if robot is None else owner.unit(None)
        self.name = owner.name if robot is None else f"{owner.name}/{robot}"
        """The key of its own latch."""
        tenant = "" if owner.tenant is None else tenant_key(owner.tenant)
        self.identity = "" if owner.tenant is None else robot_key(owner.tenant, self._segments())
        """The robot that it is, or is a part of: backends whose resources lie at the same place in
        the tree front one robot, and share this key of its latch."""
        own = (self.name,) if robot is None else (self.name, owner.name)
        self.keys = (*own, self.identity, tenant)
        """The keys of all latches that hold it but the gateway's, the narrowest first."""
        self.lost: str | None = None
        """The path of a command that ended with the link, or with an earlier gateway, and that the
        robot may still carry out."""
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

    def _segments(self) -> str:
        return "/".join(filter(None, (self.owner.robot, self.robot)))

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
        """Bring it to rest; return when it is measured to be, as far as the backend measures.

        :raises AdapterUnavailable: there is no backend, or it cannot reach the robot.
        """
        backend = self._open()
        await (backend.halt() if self.robot is None else backend.halt_robot(self.robot))

    async def hold(self) -> None:
        """Bring it to rest without an e-stop.

        :raises AdapterUnavailable: as `halt` does.
        """
        await self._open().hold(self.robot)

    def motion(self) -> MotionState | None:
        """Return what is measured of its motion; None: nothing is.

        :raises AdapterUnavailable: there is no backend.
        """
        return self._open().motion(self.robot)

    def _open(self) -> Backend:
        backend = self.backend
        if backend is None:
            raise self.owner.unavailable()
        return backend
