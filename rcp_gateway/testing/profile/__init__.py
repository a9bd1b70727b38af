"""The profile suite: tests that a robot behaves as its profiles define, measured at its device."""

from __future__ import annotations

from rcp_gateway.testing.backend._base import Robot
from rcp_gateway.testing.profile._driving import MobileTests
from rcp_gateway.testing.profile._flying import FlyingTests
from rcp_gateway.testing.profile._reaching import ReachingTests
from rcp_gateway.testing.profile._rig import Body, ProfileRig
from rcp_gateway.testing.profile._sensing import PowerTests, SensingTests
from rcp_profiles import STANDARD

__all__ = ["Body", "ProfileRig", "ProfileSuite"]

_PROBES = {
    "actuator/cmd_vel": ("body",),
    "action/move_to": ("body",),
    "sensor/battery": ("charge",),
    "sensor/scan": ("obstacle",),
    "service/enable": ("powered",),
    "action/move_joints": ("joints",),
    "action/follow_trajectory": ("joints",),
    "sensor/joint_states": ("joints",),
    "sensor/tool_pose": ("tool",),
    "action/move_tool": ("tool",),
    "action/move_gripper": ("opening",),
    "action/arm": ("armed", "land"),
    "sensor/gnss": ("geographic",),
}


class ProfileSuite(MobileTests, SensingTests, PowerTests, ReachingTests, FlyingTests):
    """Every proof of what profiles mean.

    Give `kind` (and `config`), the `profiles` that it is to have, and the probes of the device that these need::

        class TestRoverProfiles(ProfileSuite):
            kind = rcp_rover.ROVER profiles = ("mobile", "battery")

            async def body(self) -> Body:
                wheels = self.backend.rover return Body(x=wheels.x, y=wheels.y, yaw=wheels.yaw,
                forward=wheels.v, yaw_rate=wheels.w)

            async def charge(self) -> float:
                return self.backend.rover.pack.charge

    What the robot does not claim is skipped, and must be refused.
    """

    def test_no_test_of_the_profile_suite_is_changed_without_a_reason(self) -> None:
        """See that nothing was overridden or taken out but under xfail with a reason."""
        assert self.altered(ProfileSuite) == []

    async def test_it_claims_what_its_author_says(self, robot: Robot) -> None:
        """See that discovery tells the profiles of the suite, and every resource they require."""
        said = {one.name for name in self.profiles for one in STANDARD[name].whole}
        standard = {name for name in self.claimed if name in STANDARD}
        assert standard == said, f"it claims {sorted(standard)}, and is said to {sorted(said)}"
        for name in sorted(said):
            for definition in STANDARD[name].resources:
                if definition.required:
                    path = robot.path(self.full(definition.name))
                    reply = await robot.client.request("discover", path)
                    assert reply["body"]["resources"], f"{definition.name} is missing"

    async def test_each_claim_can_be_proved(self, robot: Robot) -> None:
        """See that the author gave the probes that the claimed resources need."""
        missing = [
            f"{probe}() is not given, which {name} needs"
            for name, probes in _PROBES.items()
            for probe in probes
            if self.full(name) in robot.resources
            and robot.resources[self.full(name)].profiles
            and getattr(type(self), probe) is getattr(ProfileSuite, probe)
        ]
        assert not missing, "; ".join(missing)

    async def test_what_it_does_not_claim_is_refused(self, robot: Robot) -> None:
        """See that no profile's resource answers unless it is claimed, or is the robot's own."""
        for profile in STANDARD.values():
            for definition in profile.resources:
                name = self.full(definition.name)
                if name in robot.resources or definition.gateway:
                    continue
                for type_ in ("read", "write", "execute"):
                    reply = await robot.ask(type_, name)
                    assert reply["error"]["code"] == "unknown_path", (type_, name, reply)
