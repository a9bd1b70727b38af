"""What a backend reports about its robots, and what the gateway hands to it, as records."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Annotated, Any, Literal, Protocol, runtime_checkable

import msgspec
from msgspec import Meta

from rcp_kernel.contract.identity import Principal
from rcp_kernel.types import Transform
from rcp_kernel.values import Encoding

__all__ = [
    "Anchor",
    "Dimensions",
    "Encoded",
    "FrameTree",
    "FrameWatch",
    "MotionState",
    "Native",
    "OwnLeases",
    "Progress",
    "Publication",
    "RobotFacts",
    "RobotLease",
    "RobotLeaseRequest",
    "RobotLink",
    "StopPlan",
    "Watchdog",
]


@runtime_checkable
class Native(Protocol):
    """A value in the backend's own serialized form, decoded only on demand.

    The backend guarantees its validity: the result of `decode` is not validated again.
    """

    data: bytes
    """The serialised bytes, as a subscription with `encoding: native` receives them."""

    def decode(self) -> Any:
        """Return the value; called at most once, on the event loop."""
        ...


@runtime_checkable
class Encoded(Native, Protocol):
    """A value that another gateway has numbered and encoded: it is passed on as it is.

    From its first one on, a resource has the numbers of its source; one that is not newer is not
    published again, and what the kernel learns otherwise (a written value) has no number.
    """

    encoding: Encoding
    """The encoding of `data`."""
    seq: int
    """Number of the sample at its source."""
    timestamp: int
    """Source time, ns since the UNIX epoch."""


class Publication(msgspec.Struct, frozen=True, gc=False):
    """One value for `Host.publish_batch`, or read from a robot, with its time."""

    name: str
    value: Any
    timestamp: int | None = None
    """Source time, ns since the UNIX epoch; None takes the time of receipt."""


class MotionState(msgspec.Struct, frozen=True):
    """Whether a robot is at rest, as its own measurements say."""

    at_rest: bool | None
    """False: it moves, or is not yet where the stop is to bring it (on the ground, for `land`);
    None: unknown, because it cannot be reached or its feedback is too old."""
    detail: str = ""
    """Why it is not at rest, or what is unknown: `moves at 0.8 m/s`, `no feedback for 1.2 s`."""
    energised: bool | None = None
    """Whether it is armed or its motors hold torque; None: unknown."""


class RobotLink(msgspec.Struct, frozen=True, kw_only=True):
    """What the link with the gateway of a robot has carried since this backend was opened."""

    latency: float | None
    """Seconds of the last round trip; None: unknown, or the link is down."""
    sent: int
    """Bytes to the robot."""
    received: int
    lost: int
    """Links that ended because messages were lost on the way."""


class RobotLease(msgspec.Struct, frozen=True, kw_only=True):
    """A lease that a robot's own gateway has granted. Times are by its clock, ns since the epoch."""

    id: str
    scope: str
    """In the paths of this gateway, and never more than the robot."""
    holder: str
    """The principal's name."""
    priority: int
    since: int
    expires: int
    reason: str | None
    reported: int
    """When the robot's gateway reported it."""


class OwnLeases(msgspec.Struct, frozen=True):
    """All leases on a robot, as its own gateway lists them."""

    leases: tuple[RobotLease, ...]
    reported: int
    """When the robot's gateway reported it, ns by its clock."""


class RobotLeaseRequest(msgspec.Struct, frozen=True, kw_only=True):
    """A request for a lease on a robot, or a part of it, to its own gateway."""

    do: Literal["acquire", "renew", "release", "hand_over"]
    scope: str
    """In the paths of this gateway."""
    lease: str | None = None
    """The id that the robot's gateway has given it; None: the one on exactly this scope."""
    ttl: float | None = None
    """In seconds."""
    take: bool = False
    reason: str | None = None
    heir: Principal | None = None
    """To whom it is handed over."""
    program: str | None = None
    """Which of the principal's programs requests it, as a digest."""
    former: str | None = None
    """The same of the gateway where that program was before, if there is any."""


class Watchdog(msgspec.Struct, frozen=True):
    """A mechanism that stops a robot when it no longer receives messages from the gateway."""

    mechanism: str
    """By its usual name: `ArduPilot GCS failsafe (FS_GCS_ENABLE=1, FS_GCS_TIMEOUT=5)`."""
    within: float | None
    """Seconds from the gateway's last sign of life until it acts; None: there is no watchdog."""
    verified: bool = False
    """Whether the setting was read back from the device."""
    robot: str | None = None
    """Which robot or part of one; None: all of the backend."""


class StopPlan(msgspec.Struct, frozen=True):
    """What the guard process sends to stop a robot when the gateway's event loop is blocked.

    Plain data for a sender of `rcp_guard`, which imports nothing of the gateway.
    """

    sender: str
    """The name of a sender: `can`, `ros2`, `udp`."""
    data: dict[str, Any]
    """As the sender's module documents it."""
    period: float = 0.05
    """Seconds between two transmissions."""
    lasts: float | None = None
    """Seconds for which it is sent, so as not to overrule a failsafe of the robot itself that acts
    later; None: until the guard's bound."""


class Dimensions(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The size of a robot at rest, in m along its own axes, and its mass in kg."""

    length: float | None = None
    width: float | None = None
    height: float | None = None
    mass: float | None = None


class RobotFacts(msgspec.Struct, frozen=True, kw_only=True):
    """What a robot is, as far as its backend knows; shown by the inventory."""

    kind: str | None = None
    """The usual word: `rover`, `copter`, `plane`, `boat`, `arm`, `forklift`, `motor`."""
    vendor: str | None = None
    model: str | None = None
    firmware: str | None = None
    """Name and version, as the robot itself reports them."""
    serial: str | None = None
    dimensions: Dimensions | None = None
    frames: tuple[str, ...] = ()
    """The frames in which it takes goals and reports poses."""


class Anchor(msgspec.Struct, frozen=True, kw_only=True):
    """Where a frame of a robot is fixed to the earth: its origin, and how it is turned there.

    With `yaw` 0 its x axis points east; z points up.
    """

    latitude: Annotated[float, Meta(ge=-90, le=90, extra_json_schema={"unit": "deg"})]
    """On the WGS 84 ellipsoid, deg."""
    longitude: Annotated[float, Meta(ge=-180, le=180, extra_json_schema={"unit": "deg"})]
    altitude: Annotated[float, Meta(extra_json_schema={"unit": "m"})] = 0.0
    """Above mean sea level, m."""
    yaw: Annotated[float, Meta(extra_json_schema={"unit": "rad"})] = 0.0
    """From east to the frame's x axis, counter-clockwise, rad."""
    frame: Annotated[str, Meta(min_length=1, max_length=64)] = "map"


class FrameTree(Protocol):
    """The transforms between a robot's frames, where its backend receives them itself (TF)."""

    def frames(self) -> Collection[str]:
        """Return the names of all frames."""
        ...

    def lookup(self, target: str, source: str, time: int | None) -> tuple[Transform, float]:
        """Return the pose of `source` in `target` at a source time, ns, or the nearest one known.

        None: now, by the robot's clock. The seconds between that time and the pose's are returned
        too; 0: it is exact, or never changes. Called on the event loop for single samples: no I/O.

        :raises LookupError: nothing connects the two.
        """
        ...


class FrameWatch(msgspec.Struct, frozen=True):
    """The values of a resource in a frame, as a client requests them from the robot's own gateway."""

    frame: str
    rate: float | None
    """Hz; None: every sample."""
    principal: Principal
    """Who wants them, and whose rights there count."""
    publish: Callable[[Any], None]
    """Called with each value: `Encoded`."""
    missing: Callable[[str], None]
    """Called with the reason why there are none for now, in one sentence."""


class Progress(Protocol):
    """Report feedback of a running command; newest wins for a slow client, none are reordered."""

    def __call__(self, feedback: Any = None, *, fraction: float | None = None) -> None:
        """Send `feedback` (of the resource's feedback type) and the part done, 0…1."""
        ...
