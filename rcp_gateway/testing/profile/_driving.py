"""`drive` and `mobile`: the robot drives to its goals at the commanded velocity, and stops."""

from __future__ import annotations

import itertools
import math
from contextlib import suppress
from typing import Any

from rcp_gateway.testing._suite import eventually
from rcp_gateway.testing.backend._base import Robot
from rcp_gateway.testing.profile._rig import Body, ProfileRig, needs
from rcp_kernel.errors import RcpError
from rcp_kernel.values import value_type
from rcp_protocol.timeouts import timeout

__all__ = ["DriveTests", "MobileTests"]

_WAY = 0.3  # m to drive before its direction is judged
_ANGLE = 0.4  # rad to turn before its direction is judged
_SHARE = 0.2  # relative tolerance of a speed
_FIRST = 0.5  # m that it may have moved before its first feedback
_SLACK = 0.03  # m/s or rad/s, additional absolute tolerance


def _close(found: float, wanted: float, slack: float = _SLACK) -> bool:
    return abs(found - wanted) <= abs(wanted) * _SHARE + slack


class DriveTests(ProfileRig):
    """A commanded velocity is the velocity of the body."""

    async def _travels(self, start: Body) -> tuple[float, float]:
        """Wait until it has moved some distance; return how far ahead and to the left."""
        found = (0.0, 0.0)

        async def gone() -> bool:
            nonlocal found
            found = (await self.body()).ahead_of(start)
            return math.hypot(*found) >= _WAY

        await eventually(gone, f"it moves {_WAY} m", self.complete_within)
        return found

    async def _reaches(self, what: str, wanted: float, field: str) -> None:
        """Wait until the device reaches a speed."""
        found = math.nan

        async def has() -> bool:
            nonlocal found
            found = getattr(await self.body(), field)
            return _close(found, wanted)

        try:
            await eventually(has, what, self.cancel_within)
        except AssertionError:
            raise AssertionError(f"{what} is {found:g}, and was commanded {wanted:g}") from None

    @needs("actuator/cmd_vel")
    async def test_a_forward_velocity_moves_it_ahead(self, robot: Robot) -> None:
        async with self.driven(self.speed) as start:
            ahead, left = await self._travels(start)
            assert ahead > 0, f"it moved {-ahead:g} m back"
            assert abs(left) < 0.3 * ahead, f"it moved {left:g} m to the left of straight ahead"
            await self._reaches("its speed, in m/s,", self.speed, "forward")

    @needs("actuator/cmd_vel")
    async def test_a_negative_velocity_moves_it_back(self, robot: Robot) -> None:
        reply = await self.ask(
            "write", "actuator/cmd_vel", body={"linear": {"x": -self.speed}}, dry_run=True
        )
        if reply["status"] != "completed":
            assert reply["error"]["code"] == "out_of_range", reply
            return
        async with self.driven(-self.speed) as start:
            ahead, _ = await self._travels(start)
            assert ahead < 0, f"it moved {ahead:g} m ahead"

    @needs("actuator/cmd_vel")
    async def test_a_positive_yaw_rate_turns_it_left(self, robot: Robot) -> None:
        if not self.turn:
            reply = await self.ask("write", "actuator/cmd_vel", body={"angular": {"z": 0.1}})
            assert reply["status"] == "rejected", f"it cannot turn, and takes a yaw rate: {reply}"
            return
        async with self.driven(self.turn_speed, turn=self.turn) as start:
            last, turned = start, 0.0

            async def has_turned() -> bool:
                nonlocal last, turned
                body = await self.body()
                turned += body.turned_from(last)
                last = body
                return abs(turned) >= _ANGLE

            rate = last.yaw_rate
            try:
                await eventually(has_turned, "it turns", self.complete_within)
            except AssertionError:
                rate = (await self.body()).yaw_rate
                raise AssertionError(
                    f"it turned {turned:g} rad, at {rate:g} rad/s; commanded {self.turn:g} rad/s"
                ) from None
            assert turned > 0, f"it turned {-turned:g} rad to the right"
            await self._reaches("its yaw rate, in rad/s,", self.turn, "yaw_rate")

    @needs("actuator/cmd_vel")
    async def test_a_velocity_to_the_left_moves_it_left_or_is_refused(self, robot: Robot) -> None:
        value = {"linear": {"y": self.speed}}
        await self.make_ready()
        start = await self.body()
        reply = await self.ask("write", "actuator/cmd_vel", body=value, valid_for=0.2)
        if reply["status"] == "completed":
            async with self.driven(left=self.speed) as start:
                _, left = await self._travels(start)
                assert left > 0, f"it moved {-left:g} m to the right"
        else:
            assert reply["error"]["code"] in ("out_of_range", "invalid_value"), reply
            assert math.hypot(*(await self.body()).ahead_of(start)) < _WAY

    @needs("actuator/cmd_vel")
    async def test_it_stops_when_the_command_lapses(self, robot: Robot) -> None:
        await self.make_ready()

        async def moves() -> bool:
            if (await self.body()).moves:
                return True
            await self.drive(self.speed, for_=0.3)  # again: a slow start may outlast it
            return False

        await eventually(moves, "it moves", self.complete_within)
        await self.rests("the command's time is over")

    @needs("actuator/cmd_vel")
    async def test_a_hold_stops_it(self, robot: Robot) -> None:
        await self.make_ready()
        await self.drive(self.speed)

        async def moves() -> bool:
            return (await self.body()).moves

        await eventually(moves, "it moves", self.complete_within)
        await self.do("execute", "service/hold")
        body = await self.body()
        assert not body.moves, f"the hold is completed, but the robot moves: {body}"

    @needs("actuator/cmd_vel", "sensor/velocity")
    async def test_its_velocity_is_told_as_it_is(self, robot: Robot) -> None:
        async with self.driven(self.speed, turn=self.turn):
            reported: Any = None
            body: Body | None = None

            async def is_true() -> bool:
                nonlocal reported, body
                reported, body = await self.fresh("sensor/velocity"), await self.body()
                linear, angular = reported["linear"], reported["angular"]
                return (
                    _close(linear["x"], body.forward)
                    and _close(linear["y"], body.left)
                    and _close(angular["z"], body.yaw_rate)
                    and body.forward > self.speed / 2
                    and body.yaw_rate >= self.turn / 2
                )

            try:
                await eventually(is_true, "sensor/velocity", self.cancel_within)
            except AssertionError:
                raise AssertionError(f"sensor/velocity is {reported}, not {body}") from None

    @needs("actuator/cmd_vel", "sensor/pose")
    async def test_its_pose_is_told_as_it_is(self, robot: Robot) -> None:
        async with self.driven(self.speed, turn=self.turn) as start:
            await self._travels(start)
        await self._pose_is_true()

    async def _pose_is_true(self) -> None:
        pose: Any = None
        body: Body | None = None

        async def is_true() -> bool:
            nonlocal pose, body
            pose, body = await self.fresh("sensor/pose"), await self.body()
            at, turned = pose["position"], pose["orientation"]
            yaw = math.atan2(
                2 * (turned["w"] * turned["z"] + turned["x"] * turned["y"]),
                1 - 2 * (turned["y"] ** 2 + turned["z"] ** 2),
            )
            off = math.dist((at["x"], at["y"], at["z"]), (body.x, body.y, body.z))
            return off < self.near and abs(math.remainder(yaw - body.yaw, math.tau)) < 0.1

        try:
            await eventually(is_true, "sensor/pose", self.cancel_within)
        except AssertionError:
            raise AssertionError(f"sensor/pose is {pose}, not {body}") from None


class MobileTests(DriveTests):
    """A goal is a pose in the frame that it names."""

    async def _goes(self, x: float, y: float, **goal: Any) -> list[Any]:
        """Send it to a goal relative to its pose, check that it arrives, and return the feedback."""
        await self.make_ready()
        start = await self.body()
        at = {"x": start.x + x, "y": start.y + y, "z": start.z}
        goal = {"position": at, "frame": self.frame, **goal}
        result, feedback = await self.run("action/move_to", goal)
        body = await self.body()
        off = math.hypot(body.x - at["x"], body.y - at["y"])
        assert off <= self.near, f"sent ({x:g}, {y:g}) m, it went {_way(start, body)}"
        assert abs(result["error"] - off) <= self.near, f"it is {off:g} m off, and tells {result}"
        end = result["pose"]["position"]
        assert math.hypot(end["x"] - body.x, end["y"] - body.y) <= self.near, (end, body)
        return feedback

    @needs("action/move_to")
    async def test_it_goes_one_metre_along_x(self, robot: Robot) -> None:
        await self._goes(self.hop, 0.0)

    @needs("action/move_to")
    async def test_it_goes_one_metre_along_y(self, robot: Robot) -> None:
        await self._goes(0.0, self.hop)

    @needs("action/move_to")
    async def test_its_feedback_tells_the_metres_and_seconds_left(self, robot: Robot) -> None:
        feedback = await self._goes(self.hop, 0.0)
        left = [one["distance_remaining"] for one in feedback]
        assert left, "no feedback came"
        slack = max(_FIRST, self.near)
        what = f"{self.hop:g} m was left, but {left[0]:g} m reported"
        assert abs(left[0] - self.hop) <= slack, what
        assert left[-1] <= left[0], f"the distance grew: {left}"
        rises = [b - a for a, b in itertools.pairwise(left)]
        assert all(rise < self.near for rise in rises), f"the distance rises: {left}"
        if len(left) > 1:
            assert left[-1] < left[0], f"the distance does not decrease: {left}"
        times = [one["eta"] for one in feedback if one["eta"] is not None]
        assert not times or times[-1] <= times[0] + 1.0, f"the time left rises: {times}"

    @needs("action/move_to")
    async def test_it_turns_to_the_heading_of_its_goal(self, robot: Robot) -> None:
        await self.make_ready()
        start = await self.body()
        yaw = math.remainder(start.yaw + 1.0, math.tau)
        at = {"x": start.x + self.hop, "y": start.y, "z": start.z}
        goal = {"position": at, "frame": self.frame, "yaw": yaw}
        reply = await self.ask("execute", "action/move_to", body=goal)
        if reply["status"] == "rejected":  # it faces its direction of travel
            assert reply["error"]["details"]["pointer"] == "/yaw", reply
            assert math.hypot(*(await self.body()).ahead_of(start)) <= self.near
            return
        assert reply["status"] == "completed", reply
        found = (await self.body()).yaw
        assert abs(math.remainder(found - yaw, math.tau)) < 0.2, f"heads {found:g}, not {yaw:g}"

    @needs("action/move_to")
    async def test_a_frame_that_it_does_not_know_is_refused(self, robot: Robot) -> None:
        await self.make_ready()
        start = await self.body()
        goal = {"position": {"x": start.x + 1.0, "y": start.y}, "frame": "no_such_frame"}
        reply = await self.ask("execute", "action/move_to", body=goal)
        assert reply["status"] == "rejected", f"a goal in a frame that there is not: {reply}"
        # The gateway may have refused it; where it knows none of a robot's frames, the robot has to.
        name = self.full("action/move_to")
        input_type = value_type(self.running.resources[name].input)
        with suppress(RcpError):
            async with timeout(self.complete_within):
                result = await self.backend.execute(name, input_type.convert(goal), _ignore)
            raise AssertionError(f"the backend took a goal in a frame that there is not: {result}")
        assert math.hypot(*(await self.body()).ahead_of(start)) <= self.near

    @needs("action/move_to", "param/speed_limit")
    async def test_it_keeps_to_the_speed_limit(self, robot: Robot) -> None:
        await self.make_ready()
        before = await self.fresh("param/speed_limit")
        top = await self._fastest(self.hop)
        wanted = self.limit or min(self.speed, top / 2)
        limit = await self.do("write", "param/speed_limit", body=wanted)
        assert _close(await self.fresh("param/speed_limit"), limit)
        most = limit * (1 + _SHARE) + _SLACK
        assert top > most, f"limit {limit:g} m/s, and without it only {top:g}: nothing is shown"
        fastest = await self._fastest(-self.hop, once_below=most)
        assert fastest <= most, f"limit {limit:g} m/s, driven {fastest:g}"
        await self.do("write", "param/speed_limit", body=before)

    async def _fastest(self, way: float, once_below: float = math.inf) -> float:
        """Send it some way along x; return its highest speed, after it was slow enough for the first time.

        An aeroplane is faster at first.
        """
        start = await self.body()
        goal = {"position": {"x": start.x + way, "y": start.y, "z": start.z}, "frame": self.frame}
        path = self.running.path(self.full("action/move_to"))
        id_ = await self.running.client.send(type="execute", path=path, body=goal)
        fastest, slowed = 0.0, False

        async def there() -> bool:
            nonlocal fastest, slowed
            body = await self.body()
            slowed = slowed or body.speed <= once_below
            fastest = max(fastest, body.speed) if slowed else fastest
            return math.hypot(body.x - start.x - way, body.y - start.y) <= self.near

        await eventually(there, "it arrives", self.complete_within)
        final = await self.running.client.final(id_, self.complete_within)
        assert final["status"] == "completed", final
        assert slowed, f"it was never below {once_below:g} m/s"
        return fastest


def _ignore(feedback: Any = None, *, fraction: float | None = None) -> None:
    """Ignore feedback."""


def _way(start: Body, end: Body) -> str:
    return f"({end.x - start.x:.2f}, {end.y - start.y:.2f}) m"
