"""The probes that a backend's author gives the profile suite: the actual state of the device."""

from __future__ import annotations

import functools
import math
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager
from typing import Any, ClassVar

import msgspec
import pytest

from rcp_gateway.testing._client import Message
from rcp_gateway.testing._suite import eventually
from rcp_gateway.testing.backend._base import BackendTests, Robot
from rcp_kernel.model import full_path
from rcp_profiles import STANDARD

__all__ = ["Body", "ProfileRig", "needs"]

_NEEDED = "needed"
_Test = Callable[[Any, Robot], Awaitable[None]]
_LASTING = 600.0  # s: long enough that no dead-man ends a velocity during a test


class Body(msgspec.Struct, frozen=True, kw_only=True):
    """Pose and velocity of a robot, as measured at its device: metres, radians, seconds.

    The position is in the frame of its goals and of `sensor/pose` (`frame`), x and y level and z up; velocities
    are in the body's frame: forward, left, up, and turning left.
    """

    x: float
    y: float
    yaw: float
    z: float = 0.0
    forward: float = 0.0
    left: float = 0.0
    up: float = 0.0
    yaw_rate: float = 0.0
    still: float = 0.02
    """The velocity, m/s or rad/s, up to which it counts as at rest."""

    @property
    def speed(self) -> float:
        """Its speed over the ground, m/s."""
        return math.hypot(self.forward, self.left)

    @property
    def moves(self) -> bool:
        """Whether it moves or turns."""
        return max(self.speed, abs(self.up), abs(self.yaw_rate)) > self.still

    def ahead_of(self, other: Body) -> tuple[float, float]:
        """Return its position relative to another pose: ahead and to the left, m."""
        x, y = self.x - other.x, self.y - other.y
        cos, sin = math.cos(other.yaw), math.sin(other.yaw)
        return x * cos + y * sin, y * cos - x * sin

    def turned_from(self, other: Body) -> float:
        """Return the angle from another heading, left positive, at most half a turn."""
        return math.remainder(self.yaw - other.yaw, math.tau)


def needs(*names: str) -> Callable[[_Test], _Test]:
    """Skip a test of resources that the robot does not offer under its profiles."""

    def of(test: _Test) -> _Test:
        @functools.wraps(test)
        async def proved(self: Any, robot: Robot) -> None:
            self.needs(*names)
            await test(self, robot)

        vars(proved)[_NEEDED] = names
        return proved

    return of


class ProfileRig(BackendTests):
    """The probes of a device. A probe measures at the device itself, never through the gateway.

    Give those of the profiles that the backend claims; a test says which one is missing.
    """

    place: ClassVar[str | None] = None
    """The segment after the branch in the names of the robot under test, where it has one."""
    frame: ClassVar[str] = "map"
    """The frame of `body`, in which goals are given."""
    speed: ClassVar[float] = 0.4
    """A moderate speed, m/s."""
    turn: ClassVar[float] = 0.5
    """A moderate yaw rate, rad/s; 0: it cannot turn."""
    turn_speed: ClassVar[float] = 0.0
    """The speed that it needs in order to turn, m/s; 0: it turns on the spot."""
    limit: ClassVar[float] = 0.0
    """A speed limit that it can keep to, clearly below what it reaches on its way, m/s; 0: `speed`, or half of what it reaches."""
    hop: ClassVar[float] = 1.0
    """How far to send it, m; more than `near`."""
    near: ClassVar[float] = 0.2
    """Maximum distance from its goal at the end, m."""
    reach: ClassVar[float] = 0.2
    """How far a joint is moved, rad."""

    profiles: tuple[str, ...] = ()
    """The standard profiles that it claims, by name; included ones need not be named."""

    # Given by the author

    async def make_ready(self) -> None:
        """Prepare the device to move `hop`, at least 2 m, in each direction; for example armed and flying."""

    async def body(self) -> Body:
        """Return its pose and velocity."""
        raise NotImplementedError

    async def charge(self) -> float:
        """Return the charge of the battery, 0…1."""
        raise NotImplementedError

    async def obstacle(self, bearing: float) -> float | None:
        """Return the distance in metres that a range finder should measure; None: out of range.

        The bearing is in radians, 0 is ahead and positive is left, in the frame of the scan.
        """
        raise NotImplementedError

    async def powered(self) -> bool:
        """Return whether the motors have torque."""
        raise NotImplementedError

    async def joints(self) -> Mapping[str, float]:
        """Return the positions of the joints by name, rad or m."""
        raise NotImplementedError

    async def tool(self) -> tuple[float, float, float]:
        """Return the position of the tool in `base_link`, m."""
        raise NotImplementedError

    async def opening(self) -> float:
        """Return the distance between the fingers, m."""
        raise NotImplementedError

    async def armed(self) -> bool:
        """Return whether the motors are armed."""
        raise NotImplementedError

    # Used by the tests

    @pytest.fixture(autouse=True)
    def _claimed_by_its_author(self, request: pytest.FixtureRequest) -> None:
        """Skip what is in none of its profiles before the device is opened for it."""
        definitions = (
            definition
            for name in self.profiles
            for profile in STANDARD[name].whole
            for definition in profile.resources
        )
        known = {definition.name for definition in definitions}
        wanted: tuple[str, ...] = getattr(request.function, _NEEDED, ())
        for name in wanted:
            if known and name not in known:
                pytest.skip(f"it does not claim {name}")

    def full(self, name: str) -> str:
        """Return a name of a profile with the robot's segment inserted.

        The gateway's `service/hold` is that of what an e-stop can stop alone.
        """
        own = self.running.resources.values()
        alone = any(resource.robot == self.place for resource in own)
        if self.place is None or (name == "service/hold" and not alone):
            return name
        branch, _, rest = name.partition("/")
        return f"{branch}/{self.place}/{rest}"

    @property
    def claimed(self) -> set[str]:
        """The names of the profiles that the robot claims."""
        found = self.running.resources.items()
        ids = [
            id_
            for name, resource in found
            if self.place is None or name.split("/")[1] == self.place
            for id_ in resource.profiles
        ]
        return {id_.partition("/")[0] for id_ in ids}

    def needs(self, *names: str) -> None:
        """Skip a test of resources that the robot does not offer under its profiles."""
        for name in names:
            resource = self.running.resources.get(self.full(name))
            if resource is None or not resource.profiles:
                pytest.skip(f"it does not claim {name}")

    async def ask(self, type_: str, name: str, **fields: Any) -> Message:
        """Send the operator's request; return the final reply."""
        fields.setdefault("within", self.complete_within)
        path = full_path("t", None, self.full(name))
        return await self.running.client.request(type_, path, **fields)

    async def do(self, type_: str, name: str, **fields: Any) -> Any:
        """Send a request that must complete; return its body.

        :raises AssertionError: it did not complete.
        """
        reply = await self.ask(type_, name, **fields)
        assert reply["status"] == "completed", f"{type_} {name} with {fields}: {reply}"
        return reply.get("body")

    async def fresh(self, name: str) -> Any:
        """Read a value."""
        return await self.do("read", name, body={"fresh": True})

    async def run(self, name: str, value: Any) -> tuple[Any, list[Any]]:
        """Run an action to its end; return its result and the feedback that came."""
        path = full_path("t", None, self.full(name))
        client = self.running.client
        id_ = await client.send(type="execute", path=path, body=value)
        replies = await client.replies(id_, self.complete_within)
        assert replies[-1]["status"] == "completed", f"{name} with {value}: {replies[-1]}"
        feedback = [r["body"] for r in replies if r["status"] == "in_progress" and "body" in r]
        return replies[-1].get("body"), feedback

    async def drive(
        self, forward: float = 0.0, left: float = 0.0, turn: float = 0.0, for_: float = _LASTING
    ) -> None:
        """Command a velocity that is valid for some seconds."""
        value = {"linear": {"x": forward, "y": left}, "angular": {"z": turn}}
        await self.do("write", "actuator/cmd_vel", body=value, valid_for=for_)

    @asynccontextmanager
    async def driven(
        self, forward: float = 0.0, left: float = 0.0, turn: float = 0.0
    ) -> AsyncGenerator[Body]:
        """Command a velocity while entered; yield the earlier state, and bring the robot to rest at the end."""
        await self.make_ready()
        start = await self.body()
        await self.drive(forward, left, turn)
        try:
            yield start
        finally:
            await self.drive()
        await self.rests("a velocity of zero")

    async def rests(self, why: str) -> None:
        """Wait until it neither moves nor turns."""

        async def still() -> bool:
            return not (await self.body()).moves

        await eventually(still, f"at rest after {why}", self.cancel_within)
