"""A claim takes types, units and meaning from the profile, and says in what a robot falls short."""

from __future__ import annotations

from typing import Annotated, Any

import msgspec
import pytest

from rcp_kernel.errors import InvalidValue, OutOfRange, PluginError
from rcp_kernel.model import Operation, Resource
from rcp_kernel.types import PoseStamped, Twist, quantity
from rcp_kernel.values import value_type
from rcp_profiles import STANDARD, Definition, Profile, claim, offer, twist_limits
from rcp_profiles import messages as m

MOBILE = (
    "sensor/pose",
    "sensor/velocity",
    "actuator/cmd_vel",
    "action/move_to",
    "param/speed_limit",
)


def named(resources: list[Resource]) -> dict[str, Resource]:
    return {resource.name: resource for resource in resources}


def own(name: str, **facts: Any) -> Resource:
    return Resource(name=name, description="The robot's own.", **facts)


@pytest.mark.parametrize("profile", STANDARD.values(), ids=STANDARD)
def test_a_profile_is_claimed_by_the_names_of_its_resources(profile: Profile) -> None:
    names = [one.name for one in profile.definitions.values() if not one.gateway]
    found = named(claim([profile.name], *names))
    assert list(found) == names
    for name, resource in found.items():
        defined = profile.definitions[name].resource
        assert profile.id in resource.profiles
        assert msgspec.structs.replace(resource, profiles=()) == defined


def test_what_a_profile_requires_is_required_of_a_robot() -> None:
    with pytest.raises(PluginError) as caught:
        claim(["mobile"], "sensor/pose", "sensor/velocity", "actuator/cmd_vel")
    assert str(caught.value) == (
        "the claim of drive/1.0, mobile/1.1 does not hold: "
        "action/move_to is missing, which mobile/1.1 requires; "
        "param/speed_limit is missing, which mobile/1.1 requires"
    )


def test_an_optional_resource_may_be_left_out() -> None:
    found = claim(["drive"], "sensor/velocity", "actuator/cmd_vel")
    assert [resource.profiles for resource in found] == [("drive/1.0",)] * 2


def test_a_claim_tells_all_profiles_that_a_resource_is_part_of() -> None:
    found = named(claim(["mobile", "battery"], *MOBILE, "sensor/battery"))
    assert found["sensor/velocity"].profiles == ("drive/1.0", "mobile/1.1")
    assert found["action/move_to"].profiles == ("mobile/1.1",)
    assert found["sensor/battery"].profiles == ("battery/1.0",)


def test_limits_bound_the_types_of_the_profile() -> None:
    limits = {"linear.x": (-1.0, 1.0), "linear.y": (0, 0), "angular.z": (None, 2.0)}
    (_, drive) = claim(["drive"], "sensor/velocity", offer("actuator/cmd_vel", limits))
    type_ = value_type(drive.value)
    value = type_.convert({"linear": {"x": 1.0}, "angular": {"z": -5.0}})
    assert isinstance(value, Twist)
    assert type_.convert({}) == type_.convert({"linear": {"x": 0.0}, "angular": {}})
    for beyond in ({"linear": {"x": 1.1}}, {"linear": {"y": 0.1}}, {"angular": {"z": 2.1}}):
        with pytest.raises(OutOfRange):
            type_.convert(beyond)
    x = type_.schema["$defs"]["LinearVelocity"]["properties"]["x"]
    assert (x["unit"], x["minimum"], x["maximum"]) == ("m/s", -1.0, 1.0)


def test_what_a_velocity_is_not_limited_to_is_zero() -> None:
    limits = twist_limits(x=1.5, yaw=2.0)
    (_, drive) = claim(["drive"], "sensor/velocity", offer("actuator/cmd_vel", limits))
    type_ = value_type(drive.value)
    type_.convert({"linear": {"x": -1.5}, "angular": {"z": 2.0}})
    for axis in ("y", "z"):
        with pytest.raises(OutOfRange):
            type_.convert({"linear": {axis: 0.01}})
    for axis in ("x", "y"):
        with pytest.raises(OutOfRange):
            type_.convert({"angular": {axis: 0.01}})


def test_limits_of_a_number_take_the_place_of_wider_ones() -> None:
    found = named(
        claim(
            ["mobile"],
            *MOBILE[:3],
            offer("action/move_to", {"speed": (0.1, 2.0)}),
            offer("param/speed_limit", (0, 2.0)),
        )
    )
    with pytest.raises(OutOfRange):
        value_type(found["param/speed_limit"].value).convert(2.1)
    goal = {"position": {"x": 1.0, "y": 0.0}}
    assert value_type(found["action/move_to"].input).convert(goal).speed is None
    with pytest.raises(OutOfRange):
        value_type(found["action/move_to"].input).convert({**goal, "speed": 0.05})


def test_joints_with_limits_are_the_only_ones() -> None:
    bounds = {"positions.base": (-1.0, 1.0), "positions.wrist-1": (0.0, 2.0)}
    points = {f"points.{place}": bound for place, bound in bounds.items()}
    found = named(
        claim(
            ["arm"],
            "sensor/joint_states",
            offer("action/move_joints", bounds),
            offer("action/follow_trajectory", points),
        )
    )
    type_ = value_type(found["action/move_joints"].input)
    assert type_.convert({"positions": {"wrist-1": 1.5}}).positions.given() == {"wrist-1": 1.5}
    with pytest.raises(OutOfRange):
        type_.convert({"positions": {"base": 1.5}})
    with pytest.raises(InvalidValue, match="elbow"):
        type_.convert({"positions": {"elbow": 0.0}})
    with pytest.raises(OutOfRange):
        value_type(found["action/follow_trajectory"].input).convert(
            {"points": [{"time": 0.0, "positions": {"base": -2.0}}]}
        )


def test_the_same_claim_again_has_the_same_types() -> None:
    limits = {"positions.base": (-1.0, 1.0)}
    points = {"points.positions.base": (-1.0, 1.0)}

    def claimed() -> list[Resource]:
        return claim(
            ["arm", "drive"],
            "sensor/joint_states",
            offer("action/move_joints", limits),
            offer("action/follow_trajectory", points),
            "sensor/velocity",
            offer("actuator/cmd_vel", twist_limits(x=1.0)),
        )

    assert claimed() == claimed()


def test_examples_beyond_the_limits_are_left_out() -> None:
    slow = offer("actuator/cmd_vel", {"angular.z": (-0.01, 0.01)})
    (_, drive) = claim(["drive"], "sensor/velocity", slow)
    assert drive.examples == ({"linear": {"x": 0.1}},)


@pytest.mark.parametrize(
    ("bounds", "says"),
    [
        ({"linear.q": (0, 1)}, "LinearVelocity has no field q"),
        ({"linear": (0, 1)}, "is no number"),
        ({"": (0, 1)}, "is no number"),
        ({"": (0, 1), "linear.x": (0, 1)}, "exclude each other"),
    ],
)
def test_a_limit_of_nothing_is_told(bounds: Any, says: str) -> None:
    with pytest.raises(PluginError, match=says):
        claim(["drive"], "sensor/velocity", offer("actuator/cmd_vel", bounds))


def test_what_no_profile_has_is_passed_on() -> None:
    mine = own("param/pen", value=bool)
    assert claim(["battery"], "sensor/battery", mine)[-1] == mine
    with pytest.raises(PluginError, match="param/pen: none of the claimed profiles has it"):
        claim(["battery"], "sensor/battery", "param/pen")


class Wide(m.MoveTo, frozen=True, forbid_unknown_fields=True):
    """A goal with more to say."""

    hurry: bool = False


class Demanding(m.MoveTo, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A goal that the profile's clients cannot give."""

    hurry: bool


class Flat(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A goal of another kind."""

    north: quantity("m")
    east: quantity("m")


class FarPose(PoseStamped, frozen=True):
    """A pose with more in it."""

    covariance: tuple[quantity("m2"), ...] = ()


Feet = Annotated[float, msgspec.Meta(ge=0, extra_json_schema={"unit": "[ft_i]/s"})]
GOAL = {"output": m.MoveResult, "feedback": m.MoveFeedback}


@pytest.mark.parametrize(
    "resource",
    [
        own("action/move_to", input=Wide, **GOAL),
        own("sensor/pose", value=FarPose),
        own("param/speed_limit", value=quantity("m/s", ge=0, le=3)),
        own("actuator/cmd_vel", value=Twist, safe={}, valid_for=0.1),
    ],
    ids=lambda resource: resource.name,
)
def test_a_resource_of_ones_own_may_be_more_than_the_profile_asks(resource: Resource) -> None:
    names = [name for name in MOBILE if name != resource.name]
    found = named(claim(["mobile"], resource, *names))
    assert found[resource.name].description == "The robot's own."


@pytest.mark.parametrize(
    ("resource", "says"),
    [
        (
            own("action/move_to", input=Flat, **GOAL),
            "action/move_to, input: /position is not taken",
        ),
        (own("action/move_to", input=Demanding, **GOAL), "input: /hurry is required"),
        (own("action/move_to", input=m.MoveTo), "action/move_to has no output"),
        (
            own("action/move_to", input=m.MoveTo, output=m.MoveFeedback, feedback=m.MoveFeedback),
            "output: /pose is missing",
        ),
        (own("param/speed_limit", value=Feet), r"the value is in \[ft_i\]/s, not in m/s"),
        (own("param/speed_limit", value=str), "param/speed_limit, value: the value may be string"),
        (
            own("param/speed_limit", value=quantity("m/s", ge=0), operations=Operation.READ),
            "param/speed_limit does not offer write",
        ),
        (own("sensor/pose", value=Twist), "sensor/pose, value: /position is missing"),
        (own("actuator/cmd_vel", value=Twist), "actuator/cmd_vel has no `valid_for`"),
    ],
)
def test_a_resource_of_ones_own_must_be_what_the_profile_says(
    resource: Resource, says: str
) -> None:
    names = [name for name in MOBILE if name != resource.name]
    with pytest.raises(PluginError, match=says):
        claim(["mobile"], resource, *names)


def test_what_energises_must_say_so() -> None:
    switch = own("service/enable")
    with pytest.raises(PluginError, match="service/enable does not say that it `energises`"):
        claim(["power"], "service/reset_system", switch)


def test_robots_of_one_backend_claim_each_for_itself() -> None:
    found = claim(["battery"], "sensor/battery", own("param/pen", value=bool), robot="r1")
    assert [(one.name, one.robot) for one in found] == [
        ("sensor/r1/battery", "r1"),
        ("param/r1/pen", "r1"),
    ]
    (part,) = claim(["battery"], "sensor/battery", place="rear")
    assert (part.name, part.robot) == ("sensor/rear/battery", None)


def test_a_profile_that_is_none_is_told_with_the_nearest() -> None:
    with pytest.raises(PluginError, match="did you mean 'mobile'"):
        claim(["mobil"], *MOBILE)


HOOK = Definition(
    resource=Resource(name="sensor/hook", description="Its height.", value=quantity("m")),
    frame="trolley",
)


def test_a_vendors_profile_is_claimed_as_a_record() -> None:
    crane = Profile(name="acme.crane", version="2.1", description="A crane.", resources=(HOOK,))
    (found,) = claim([crane], offer("sensor/hook", (0, 12)))
    assert found.profiles == ("acme.crane/2.1",)
    other = msgspec.structs.replace(
        crane, name="acme.tall", resources=(msgspec.structs.replace(HOOK, frame="map"),)
    )
    with pytest.raises(PluginError, match="define 'sensor/hook' in different ways"):
        claim([crane, other], "sensor/hook")


@pytest.mark.parametrize(("name", "version"), [("Crane", "1.0"), ("crane", "1"), ("a/b", "1.0")])
def test_a_profile_with_a_bad_name_or_version_is_none(name: str, version: str) -> None:
    with pytest.raises(PluginError):
        Profile(name=name, version=version, description="A crane.", resources=(HOOK,))


def test_two_maps_of_one_input_are_bounded_side_by_side() -> None:
    limits = {"points.positions.elbow": (-1.0, 1.0), "points.velocities.elbow": (-2.0, 2.0)}
    offers = ("sensor/joint_states", "action/move_joints")
    claimed = named(claim(["arm"], *offers, offer("action/follow_trajectory", limits)))
    type_ = value_type(claimed["action/follow_trajectory"].input)
    assert {"WaypointPositions", "WaypointVelocities"} <= type_.schema["$defs"].keys()
    point = {"time": 1.0, "positions": {"elbow": 0.5}, "velocities": {"elbow": 1.5}}
    assert type_.convert({"points": [point]}).points[0].velocities.given() == {"elbow": 1.5}
    with pytest.raises(OutOfRange):
        type_.convert({"points": [point | {"velocities": {"elbow": 2.5}}]})
