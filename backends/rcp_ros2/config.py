"""The configuration of one ROS 2 backend: what stands at which path, and how patient it is."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct, field

from rcp_kernel.errors import RcpError
from rcp_kernel.model import Kind, Policy, kind_of
from rcp_ros2.definitions import parse

__all__ = [
    "Assets",
    "Diagnostics",
    "Jpeg",
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
MessageName = Annotated[str, Meta(pattern=r"^[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*$")]
FieldPath = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_]+(\.[A-Za-z0-9_]+)*$")]
Seconds = Annotated[float, Meta(gt=0, extra_json_schema={"unit": "s"})]


class Qos(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What to ask of the middleware instead of what the other side offers."""

    reliability: Literal["reliable", "best_effort"] | None = None
    durability: Literal["volatile", "transient_local"] | None = None
    depth: Annotated[int, Meta(ge=1, le=10_000)] | None = None
    history: Literal["keep_last", "keep_all"] | None = None
    deadline: Seconds | None = None
    """Between two messages, at most: promised by a publisher, asked for by a subscription."""
    lifespan: Seconds | None = None
    """For which a message is worth sending."""
    liveliness: Literal["automatic", "manual_by_topic"] | None = None
    lease: Seconds | None = None
    """For which the other side counts as alive without a sign."""


class Mapping(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What one path stands for: a topic, a service, an action, or a parameter of a node."""

    topic: RosName | None = None
    service: RosName | None = None
    action: RosName | None = None
    node: RosName | None = None
    """With `parameter` or `parameters`: the node that has them."""
    parameter: str | None = None
    parameters: tuple[str, ...] = ()
    """Of a service that sets them together, all or none; `*` is every one the node has."""
    type: TypeName | None = None
    """`nav_msgs/msg/Odometry`; without it the graph tells, once somebody offers the topic."""
    field: FieldPath | None = None
    """Only this part of the messages of a sensor or event: `pose.pose`."""
    unit: str | None = None
    """UCUM unit of the numbers of which nothing is known: of a parameter, of a message of one's
    own. ROS's definitions carry none."""
    frame: str | None = None
    """The frame of what carries none, for its schema: of a `pose.pose`, of a velocity."""
    qos: Qos = Qos()
    description: str | None = None
    deadline: Seconds | None = None
    timeout: Seconds | None = None
    """For an answer; for an action the whole of it."""
    silence: Seconds | None = None
    """Of an action: for how long its server may say nothing; see the backend's own `silence`."""
    policy: Policy | None = None
    max_age: Seconds | None = None
    history: Annotated[int, Meta(ge=1, le=100_000)] | None = None
    valid_for: Annotated[float, Meta(ge=0, extra_json_schema={"unit": "s"})] | None = None
    """Seconds a write stands; velocities have 0.5 by themselves, 0 lets a write stand for ever."""
    safe: Any = None
    """What the dead-man and `halt` write; all zeros without it."""
    require_subscriber: bool = True
    """Refuse a write that no node would hear."""
    moves: bool | None = None
    """Whether it may move the robot: refused under an e-stop. None: every actuator and action does,
    and every service but those of types that are known to ask only."""
    energises: bool | None = None
    """Whether it arms the robot or gives its motors torque: refused under an e-stop."""
    feedback: RosName | None = None
    """Topic of an actuator's or action's measured velocity: without it nothing is moved."""
    feedback_timeout: Seconds | None = None
    """Age above which that feedback does not count; None takes `stop.max_age`."""

    def __post_init__(self) -> None:
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
        """What the target is, for messages."""
        if self.node is not None:
            return "node"
        return "topic" if self.topic else "service" if self.service else "action"


class Diagnostics(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How `/diagnostics` is followed, where `expose` names it."""

    stale: Seconds = 5.0
    """Without news of a status, after which it counts as stale."""


class Log(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which records of `/rosout` are told, where `expose` names it."""

    level: Literal["debug", "info", "warn", "error", "fatal"] = "info"
    """The least that is told."""


class Jpeg(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How images become JPEGs, for those who ask for these."""

    quality: Annotated[int, Meta(ge=1, le=100)] = 80
    rate: Annotated[float, Meta(gt=0, le=120, extra_json_schema={"unit": "Hz"})] = 15.0
    """At most so many a second of one camera."""


class Assets(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Where the meshes and textures that a robot's description names are found."""

    paths: dict[str, str] = {}
    """Package → folder, of those that are not installed here, or installed as links."""
    size: Annotated[int, Meta(ge=1, le=2**28, extra_json_schema={"unit": "By"})] = 2**24
    """Of one file, at most; a larger one is refused."""


class Transforms(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How the tree of frames is kept, where `expose` names `/tf` and `/tf_static`."""

    targets: tuple[str, ...] = ("earth", "map", "odom", "base_link")
    """Frames in which every other frame that is connected gets a sensor; roots are added."""
    names: dict[str, tuple[str, str]] = {}
    """Sensors by names of one's own: each with the frame that is the target, and the source."""
    buffer: Annotated[float, Meta(gt=0, le=600, extra_json_schema={"unit": "s"})] = 10.0
    """For which a moving frame is remembered."""
    rate: Annotated[float, Meta(gt=0, le=200, extra_json_schema={"unit": "Hz"})] = 30.0
    """At most so many values a second of one pair."""

    def __post_init__(self) -> None:
        for path in self.names:
            if not path.startswith(("sensor/", "/sensor/")):
                raise ValueError(f"{path!r} is not a sensor, but a transform must be one")


class StopService(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A service that stops the robot: called at each stop, before it is confirmed."""

    name: RosName
    type: TypeName | None = None
    """`std_srvs/srv/SetBool`; without it the graph tells."""
    request: dict[str, Any] = {}
    released: dict[str, Any] | None = None
    """What it is called with when the e-stop is reset; None calls nothing."""


class StopTopic(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A topic that stops the robot: published for as long as the e-stop is latched."""

    name: RosName
    type: TypeName = "std_msgs/msg/Bool"
    value: dict[str, Any] = field(default_factory=lambda: {"data": True})
    released: dict[str, Any] | None = field(default_factory=lambda: {"data": False})
    """What is published when the e-stop is reset; None publishes nothing."""


class Stop(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How a robot is stopped, and how its rest is measured. Relative names are each robot's own."""

    feedback: RosName | bool = True
    """Topic of the measured velocity, without which a stop is not confirmed; true takes the
    odometry that `map` or `expose` names, if there is one; false measures nothing."""
    speed: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "m/s"})] = 0.05
    """At or below which the robot counts as at rest."""
    turn: Annotated[float, Meta(gt=0, extra_json_schema={"unit": "rad/s"})] = 0.1
    """The same for its rotation, and for the velocities of joints."""
    max_age: Seconds = 0.5
    """Age above which a measurement does not count."""
    rate: Annotated[float, Meta(ge=10, le=100, extra_json_schema={"unit": "Hz"})] = 20.0
    """At which the safe values are repeated, at least; three times as fast as whoever else
    publishes, up to 100 Hz."""
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
    """None takes ROS_DOMAIN_ID, or 0."""
    node: Annotated[str, Meta(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")] = "rcp_gateway"
    """Name of the gateway's own node."""
    namespace: RosName = "/"
    """That of the gateway's node; what lies in it has paths without it."""
    robots: tuple[RobotPattern, ...] = ()
    """Namespaces each of which is a robot: `/fleet/*`. What lies in one has its paths below the
    name that `*` stands for, or the last segment: `sensor/<robot>/…`."""
    nice_names: bool = True
    """Give well-known topics of well-known types the names that people know."""
    expose: tuple[RosPattern, ...] = ()
    """Names of topics, services, actions and nodes to offer as they come; `*` is one segment of
    a name, `**` any number. Nothing is offered that no pattern and no mapping names."""
    hide: tuple[RosPattern, ...] = ()
    """Names that `expose` would offer, and should not."""
    map: dict[str, Mapping] = {}
    types: dict[MessageName, str] = {}
    """The `.msg` text of types that are not installed."""
    diagnostics: Diagnostics = Diagnostics()
    log: Log = Log()
    jpeg: Jpeg = Jpeg()
    tf: Transforms = Transforms()
    assets: Assets = Assets()
    stop: Stop = Stop()
    on_loss: Literal["hold", "continue"] = "hold"
    """What becomes of a goal or command that was lost with its node, once that is back."""
    graph: bool = False
    """Offer the graph itself as `sensor/ros/graph`."""
    use_sim_time: bool = False
    """The robot's time is what `/clock` says."""
    timeout: Seconds = 5.0
    """For an answer of a service, a parameter or an action server."""
    silence: Seconds = 4.0
    """For which a server that used to answer may say nothing while it runs a goal."""
    transition_timeout: Seconds = 30.0
    """For a lifecycle node to come to its new state."""
    grace: Annotated[float, Meta(ge=0, extra_json_schema={"unit": "s"})] = 4.0
    """For the discovery of the graph, before something is said to be missing."""
    poll: Annotated[float, Meta(ge=0.1, le=60, extra_json_schema={"unit": "s"})] = 1.0
    """Between two looks at the graph."""

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
            if mapping.feedback is not None and kind not in (Kind.ACTUATOR, Kind.ACTION):
                raise ValueError(f"{path!r}: `feedback` is for actuators and actions")
            if mapping.field is not None and kind not in (Kind.SENSOR, Kind.EVENT):
                raise ValueError(f"{path!r}: `field` is for sensors and events")
