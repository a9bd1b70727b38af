"""The configuration of one ROS 2 backend: mappings and time-outs."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct, field

from rcp_kernel.errors import RcpError
from rcp_kernel.model import Kind, Policy, kind_of
from rcp_ros2.conventions import may_be
from rcp_ros2.definitions import parse

__all__ = [
    "Assets",
    "Diagnostics",
    "Jpeg",
    "Limits",
    "Log",
    "Mapping",
    "Qos",
    "Ros2Config",
    "Stop",
    "StopService",
    "StopTopic",
    "Transforms",
]

RosName = Annotated[str, Meta(pattern=r"^~?/?[A-Za-z0-9_~/]+$", max_length=256)]
RosPattern = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_*/]+$", max_length=256)]
RobotPattern = Annotated[str, Meta(pattern=r"^(/[A-Za-z0-9_*]+)+$", max_length=256)]
TypeName = Annotated[
    str, Meta(pattern=r"^[A-Za-z][A-Za-z0-9_]*(/(msg|srv|action))?/[A-Za-z][A-Za-z0-9_]*$")
]
FullName = Annotated[str, Meta(pattern=r"^[a-z][a-z0-9_]*/(msg|srv|action)/[A-Z][A-Za-z0-9]*$")]
FieldPath = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_]+(\.[A-Za-z0-9_]+)*$")]
Seconds = Annotated[float, Meta(gt=0, extra_json_schema={"unit": "s"})]


class Qos(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """QoS policies that replace those derived from the other endpoints."""

    reliability: Literal["reliable", "best_effort"] | None = None
    durability: Literal["volatile", "transient_local"] | None = None
    depth: Annotated[int, Meta(ge=1, le=10_000)] | None = None
    history: Literal["keep_last", "keep_all"] | None = None
    deadline: Seconds | None = None
    """Maximum time between two messages: offered by a publisher, requested by a subscription."""
    lifespan: Seconds | None = None
    """Lifespan of a message."""
    liveliness: Literal["automatic", "manual_by_topic"] | None = None
    lease: Seconds | None = None
    """Liveliness lease duration."""


class Mapping(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The target of one path: a topic, a service, an action, or a parameter of a node."""

    topic: RosName | None = None
    service: RosName | None = None
    action: RosName | None = None
    node: RosName | None = None
    """With `parameter` or `parameters`: the node that owns them."""
    parameter: str | None = None
    parameters: tuple[str, ...] = ()
    """For a service that sets them atomically; `*` selects every parameter of the node."""
    type: TypeName | None = None
    """`nav_msgs/msg/Odometry`; read from the graph by default."""
    field: FieldPath | None = None
    """Select only this part of the messages of a sensor or event: `pose.pose`."""
    unit: str | None = None
    """UCUM unit of numbers without a known unit: a parameter, a custom message.
    ROS message definitions contain no units."""
    frame: str | None = None
    """`frame_id` in the schema of a value without a header: a `pose.pose`, a velocity; and of a command
    that has a header and gives none."""
    nan: bool = False
    """Whether numbers of a command may be NaN or infinite: "leave it as it is", to a PX4."""
    qos: Qos = Qos()
    description: str | None = None
    deadline: Seconds | None = None
    timeout: Seconds | None = None
    """Time-out for a response; for an action, its whole duration."""
    silence: Seconds | None = None
    """For an action: maximum silence of its server; see the backend's `silence`."""
    policy: Policy | None = None
    max_age: Seconds | None = None
    history: Annotated[int, Meta(ge=1, le=100_000)] | None = None
    valid_for: Annotated[float, Meta(ge=0, extra_json_schema={"unit": "s"})] | None = None
    """Validity of a write in s; default 0.5 for velocities; with 0 a write never expires."""
    safe: Any = None
    """Value that the dead-man and `halt` write; default all zeros."""
    require_subscriber: bool = True
    """Refuse a write that no node would receive."""
    moves: bool | None = None
    """Whether it may move the robot and is refused during an e-stop. None: every actuator and
    action
    does, and every service except those of known read-only types."""
    energises: bool | None = None
    """Whether it arms the robot or applies torque; refused during an e-stop."""
    feedback: RosName | None = None
    """Topic with the measured velocity of an actuator or action; without fresh feedback,
    commands are
    refused."""
    feedback_timeout: Seconds | None = None
    """Maximum age of that feedback; None uses `stop.max_age`."""
    profile: bool = False
    """Offer it as the resource of this name that profiles have, with their type: `sensor/pose`, …."""

    crop: Annotated[tuple[float, ...], Meta(min_length=4, max_length=6)] | None = None
    """What of a map (x and y of two corners, in m) or of a point cloud (x, y, z) is kept, in the frame
    of the message."""
    decimate: Annotated[int, Meta(ge=2, le=1000)] | None = None
    """Keep each n-th point of a cloud, or one cell for n x n of a map: the highest, so that no
    obstacle is lost."""
    rate: Annotated[float, Meta(gt=0, le=1000, extra_json_schema={"unit": "Hz"})] | None = None
    """Maximum rate of a sensor, whoever subscribes."""

    def __post_init__(self) -> None:
        if (self.crop or self.decimate) and (self.field is not None or self.profile):
            raise ValueError(
                "`crop` and `decimate` are for whole messages: omit `field` and `profile`"
            )
        half = len(self.crop or ()) // 2
        low, high = (self.crop or ())[:half], (self.crop or ())[half:]
        if len(low) != len(high) or any(a >= b for a, b in zip(low, high, strict=True)):
            raise ValueError("`crop` is the lowest corner, then the highest one: 4 or 6 numbers")
        if self.feedback_timeout is not None and self.feedback is None:
            raise ValueError("`feedback_timeout` requires `feedback`")
        words = ("topic", "service", "action", "parameter", "parameters")
        if len([word for word in words if getattr(self, word)]) != 1:
            raise ValueError(
                "set exactly one of `topic`, `service`, `action`, or `node` with `parameter` or "
                "`parameters`"
            )
        if (self.node is None) != (self.parameter is None and not self.parameters):
            raise ValueError("`node` requires `parameter` or `parameters`, and they require `node`")

    @property
    def target(self) -> str:
        """The ROS name that must be in the graph for the path to work."""
        return self.topic or self.service or self.action or self.node or ""

    @property
    def noun(self) -> str:
        """Kind of the target, for messages."""
        if self.node is not None:
            return "node"
        return "topic" if self.topic else "service" if self.service else "action"


class Diagnostics(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings for `/diagnostics`, if exposed."""

    stale: Seconds = 5.0
    """Time without an update after which a status counts as stale."""


class Log(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings for `/rosout`, if exposed."""

    level: Literal["debug", "info", "warn", "error", "fatal"] = "info"
    """Lowest level that is reported."""


class Jpeg(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings for JPEG conversion."""

    quality: Annotated[int, Meta(ge=1, le=100)] = 80
    rate: Annotated[float, Meta(gt=0, le=120, extra_json_schema={"unit": "Hz"})] = 15.0
    """Maximum rate per camera."""


class Assets(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Locations of the meshes and textures in a robot's description."""

    paths: dict[str, str] = {}
    """Package → folder, of those that are not installed here, or installed as links."""
    size: Annotated[int, Meta(ge=1, le=2**28, extra_json_schema={"unit": "By"})] = 2**24
    """Maximum size of a file; a larger one is refused."""


class Transforms(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings for the tree of frames, if `/tf` and `/tf_static` are exposed."""

    targets: tuple[str, ...] = ("earth", "map", "odom", "base_link")
    """Frames in which every other connected frame gets a sensor; roots are added."""
    names: dict[str, tuple[str, str]] = {}
    """Sensors with custom names: each a target and a source frame."""
    buffer: Annotated[float, Meta(gt=0, le=600, extra_json_schema={"unit": "s"})] = 10.0
    """History of moving frames."""
    rate: Annotated[float, Meta(gt=0, le=200, extra_json_schema={"unit": "Hz"})] = 30.0
    """Maximum rate per pair."""

    def __post_init__(self) -> None:
        for path in self.names:
            if not path.startswith(("sensor/", "/sensor/")):
                raise ValueError(f"{path!r} is not a sensor, but a transform must be one")


class StopService(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A service that stops the robot, called at each stop before the stop is confirmed."""

    name: RosName
    type: TypeName | None = None
    """`std_srvs/srv/SetBool`; read from the graph by default."""
    request: dict[str, Any] = {}
    released: dict[str, Any] | None = None
    """Request sent when the e-stop is reset; None sends none."""


class StopTopic(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A topic that stops the robot, published while the e-stop is latched."""

    name: RosName
    type: TypeName = "std_msgs/msg/Bool"
    value: dict[str, Any] = field(default_factory=lambda: {"data": True})
    released: dict[str, Any] | None = field(default_factory=lambda: {"data": False})
    """Message published when the e-stop is reset; None publishes none."""


class Limits(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Highest velocities that `actuator/cmd_vel` accepts; without any it accepts all.

    With any, a velocity that is not given is zero: the robot cannot do it.
    """

    speed: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "m/s"})]
    """Ahead and back."""
    sideways: Annotated[float, Meta(ge=0, extra_json_schema={"unit": "m/s"})] = 0.0
    turn: Annotated[float, Meta(ge=0, extra_json_schema={"unit": "rad/s"})] = 0.0
    """Rate of turn."""


class Stop(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How a robot is stopped and confirmed at rest. Relative names apply to each robot."""

    feedback: RosName | bool = True
    """Topic of the measured velocity, required to confirm a stop; true uses the odometry in
    `map` or
    `expose`, if any; false uses no measurement."""
    speed: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "m/s"})] = 0.05
    """Speed at or below which the robot counts as at rest."""
    turn: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "rad/s"})] = 0.1
    """Rate of turn at or below which the robot counts as at rest; also applies to joint
    velocities."""
    max_age: Seconds = 0.5
    """Maximum age of a measurement."""
    rate: Annotated[float, Meta(ge=10, le=100, extra_json_schema={"unit": "Hz"})] = 20.0
    """Minimum rate at which safe values are repeated; three times the rate of any competing
    publisher,
    up to 100 Hz."""
    actions: tuple[RosPattern, ...] = ("**",)
    """Action servers whose goals are cancelled, besides those of `map` and `expose`."""
    service: StopService | None = None
    topic: StopTopic | None = None
    twist_mux_lock: RosName | None = None
    """Lock of a twist_mux: true while stopped, false after the reset."""


_FITS = {
    Kind.SENSOR: ("topic", "action"),
    Kind.EVENT: ("topic", "service"),
    Kind.ACTUATOR: ("topic",),
    Kind.SERVICE: ("service",),
    Kind.ACTION: ("action",),
    Kind.PARAM: ("node",),
}


class Ros2Config(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One ROS 2 domain, or the part of it that belongs to one robot."""

    domain_id: Annotated[int, Meta(ge=0, le=232)] | None = None
    """None uses ROS_DOMAIN_ID, or 0."""
    node: Annotated[str, Meta(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")] = "rcp_gateway"
    """Name of the gateway's own node."""
    enclave: Annotated[str, Meta(pattern=r"^(/[A-Za-z0-9_]+)+$")] | None = None
    """SROS 2 enclave of the gateway's node; None uses that of the environment."""
    namespace: RosName = "/"
    """Namespace of the gateway's node; paths of names in it omit it."""
    robots: tuple[RobotPattern, ...] = ()
    """Namespaces that each contain one robot: `/fleet/*`. Their paths are below the part that `*`
    matches, or the last segment: `sensor/<robot>/…`."""
    nice_names: bool = True
    """Give well-known topics of well-known types conventional paths, those of the profiles included."""
    expose: tuple[RosPattern, ...] = ()
    """Names of topics, services, actions and nodes to offer under their own names; `*` is one
    segment,
    `**` any number. Names that match no pattern and no mapping are not offered."""
    hide: tuple[RosPattern, ...] = ()
    """Names to exclude from `expose`."""
    map: dict[str, Mapping] = {}
    limits: Limits | None = None
    types: dict[FullName, str] = {}
    """The text of messages, services and actions that are not installed."""
    interfaces: tuple[str, ...] = ()
    """Folders with packages that are not installed, as in `/opt/ros/<distro>/share`."""
    diagnostics: Diagnostics = Diagnostics()
    log: Log = Log()
    jpeg: Jpeg = Jpeg()
    tf: Transforms = Transforms()
    assets: Assets = Assets()
    stop: Stop = Stop()
    on_loss: Literal["hold", "continue"] = "hold"
    """Behaviour after a node with a running goal or command is lost and returns."""
    graph: bool = False
    """Provide the graph itself as `sensor/ros/graph`."""
    offers: bool = False
    """Let clients offer services and actions on the graph, by `action/ros/offer`."""
    use_sim_time: bool = False
    """Use `/clock` as the robot's time."""
    timeout: Seconds = 5.0
    """Time-out for a response from a service, a parameter or an action server."""
    silence: Seconds = 4.0
    """Maximum silence of an action server while it runs a goal."""
    transition_timeout: Seconds = 30.0
    """Time-out for a lifecycle node to reach its new state."""
    grace: Annotated[float, Meta(ge=0, extra_json_schema={"unit": "s"})] = 4.0
    """Time for graph discovery, before anything is reported missing."""
    poll: Annotated[float, Meta(ge=0.1, le=60, extra_json_schema={"unit": "s"})] = 1.0
    """Interval between two polls of the graph."""

    def __post_init__(self) -> None:
        for name, text in self.types.items():
            parse(name, text)
        if any("**" in pattern for pattern in self.robots):
            raise ValueError(
                "`robots` cannot contain `**`: the end of a robot's namespace would be ambiguous"
            )
        for path, mapping in self.map.items():
            try:
                kind = kind_of(path.removeprefix("/"))
            except RcpError as error:
                raise ValueError(f"{error.message}: {error.remedy}") from None
            together = kind is Kind.SERVICE and bool(mapping.parameters)
            if not together and (mapping.parameters or mapping.noun not in _FITS[kind]):
                raise ValueError(f"{path!r} is a {kind} and cannot be a {mapping.noun}")
            reduces = mapping.crop or mapping.decimate or mapping.rate
            if reduces and (kind is not Kind.SENSOR or mapping.topic is None):
                raise ValueError(
                    f"{path!r}: `crop`, `decimate` and `rate` are for sensors that are topics"
                )
            if mapping.feedback is not None and kind not in (Kind.ACTUATOR, Kind.ACTION):
                raise ValueError(f"{path!r}: `feedback` is for actuators and actions")
            if mapping.profile and (
                mapping.field is not None or not may_be(path.removeprefix("/"))
            ):
                raise ValueError(f"{path!r}: no profile's resource can be made of this mapping")
            if mapping.nan and kind not in (Kind.ACTUATOR, Kind.ACTION, Kind.SERVICE):
                raise ValueError(f"{path!r}: `nan` is for actuators, actions and services")
            if mapping.nan and mapping.profile:
                raise ValueError(f"{path!r}: a profile's resource has no `nan`")
            if mapping.field is not None and kind not in (Kind.SENSOR, Kind.EVENT):
                raise ValueError(f"{path!r}: `field` is for sensors and events")
