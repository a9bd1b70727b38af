"""The physics: what moves, what lapses, what brakes, and what is a fault."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from backends.mujoco.physics import ELBOW, PUCK, model_of, robot_of, run, until
from rcp_kernel.errors import ConfigError, InvalidValue, ModeForbids, PreconditionFailed
from rcp_kernel.types import LaserScan
from rcp_kernel.values import value_type
from rcp_mujoco import MujocoConfig
from rcp_mujoco.arm import Motion
from rcp_mujoco.config import ArmConfig, GripperConfig, WheelsConfig
from rcp_mujoco.gripper import Grip
from rcp_mujoco.paths import Quintic, Spline, Waypoint
from rcp_mujoco.resources import catalogue
from rcp_mujoco.robots import MODELS
from rcp_mujoco.wheels import make_trip

STAMP = 1_800_000_000_000_000_000


def readings(robot: Any) -> dict[str, Any]:
    return {reading.name: reading.read(STAMP) for reading in robot.readings()}


# Models


def test_a_joints_range_bounds_its_actuator(tmp_path: Path) -> None:
    robot = robot_of(model_of(ELBOW, tmp_path), actuate="position")
    (drive,) = robot.simulation.drives
    assert (drive.name, drive.mode, drive.unit) == ("elbow", "position", "rad")
    assert (drive.low, drive.high) == (-1.0, 0.5)
    robot.simulation.command(drive, 0.4, None)
    run(robot, 2.0)
    assert readings(robot)["sensor/joint_states"].position == [pytest.approx(0.4, abs=0.05)]


@pytest.mark.parametrize(
    ("actuate", "unit", "safe"), [("velocity", "rad/s", 0.0), ("torque", "N.m", 0.0)]
)
def test_a_urdf_has_the_actuators_that_are_configured(
    actuate: Any, unit: str, safe: float, tmp_path: Path
) -> None:
    robot = robot_of(model_of(ELBOW, tmp_path), actuate=actuate)
    (drive,) = robot.simulation.drives
    assert (drive.mode, drive.unit, drive.safe) == (actuate, unit, safe)
    run(robot, 1.0)
    robot.simulation.command(drive, 1.0, 0.2)
    run(robot, 0.1)
    assert robot.simulation.fault is None


def test_sensors_of_a_model_have_the_units_of_what_they_measure(tmp_path: Path) -> None:
    robot = robot_of(model_of(PUCK, tmp_path))
    run(robot, 0.5)
    values = readings(robot)
    assert values["sensor/place"] == 0.0
    assert values["sensor/clock"] == pytest.approx(0.498)
    assert values["sensor/contact/bumper"] == 0.0
    assert len(values["sensor/speed"]) == 3
    assert robot.simulation.drives[0].name == "push_force"  # a segment of a path


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (None, "there is no file"),
        ("", "not a model"),
        ("<mujoco><nonsense/></mujoco>", "unrecognized element"),
        ("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>", "nothing in .* can move"),
        (PUCK.replace('joint="slide"', 'joint="slid"'), "slid"),
        (PUCK.replace("<worldbody>", '<option timestep="0"/><worldbody>'), "timestep"),
    ],
)
def test_a_missing_or_damaged_model_is_told(content: str | None, why: str, tmp_path: Path) -> None:
    model = str(tmp_path / "gone.xml") if content is None else model_of(content, tmp_path)
    with pytest.raises(ConfigError, match=why):
        robot_of(model)


def test_a_trajectory_whose_speed_overflows_is_refused() -> None:
    start, points = np.zeros(1), [Waypoint(100.0, np.zeros(1), np.array([1e308]))]
    points.append(Waypoint(200.0, np.zeros(1), None))
    with np.errstate(all="ignore"), pytest.raises(InvalidValue, match="waypoint 0"):
        Spline(start, points, speed=1.0, names=["elbow"])


@pytest.mark.parametrize(
    "part",
    [
        {"wheels": {"left": ["left"], "right": ["right"], "radius": 0.1, "track": 0.3}},
        {"arm": {"joints": ["push_force"]}},
        {"wheels": {"left": ["push_force"], "right": ["push_force"], "radius": 0.1, "track": 0.3}},
        {"gripper": {"actuator": "fingers", "open": 1.0, "closed": 0.0}},
        {"gripper": {"actuator": "push_force", "open": 1.0, "closed": 0.0}},
        {"keyframe": "home"},
    ],
)
def test_a_part_that_the_model_lacks_is_told(part: Any, tmp_path: Path) -> None:
    model = PUCK.replace('name="far"', 'name="base_link"')
    table = {"model": model_of(model, tmp_path), **part}
    config = msgspec.convert(table, MujocoConfig)
    with pytest.raises(ConfigError):
        robot_of(**{field: getattr(config, field) for field in config.__struct_fields__})


GEARED = """
<mujoco>
  <option gravity="0 0 0"/>
  <worldbody>
    <body><joint name="elbow" damping="1"/><geom size="0.1" pos="0.3 0 0"/></body>
  </worldbody>
  <actuator><position name="elbow" joint="elbow" kp="50" gear="{gear}"/></actuator>
</mujoco>
"""


@pytest.mark.parametrize(("gear", "unit"), [(-1.0, "rad"), (2.0, "1")])
def test_brakes_hold_a_geared_joint_where_it_is(gear: float, unit: str, tmp_path: Path) -> None:
    robot = robot_of(model_of(GEARED.format(gear=gear), tmp_path))
    simulation = robot.simulation
    (drive,) = simulation.drives
    assert drive.unit == unit
    simulation.command(drive, 0.5, None)
    run(robot, 3.0)
    here = float(simulation.data.qpos[0])
    assert here == pytest.approx(0.5 / gear, abs=0.02)
    simulation.brake("stopped")
    run(robot, 1.0)
    simulation.release()
    run(robot, 1.0)
    assert float(simulation.data.qpos[0]) == pytest.approx(here, abs=0.02)


def test_a_geared_motors_control_is_no_torque(tmp_path: Path) -> None:
    model = GEARED.format(gear=150).replace('kp="50"', "").replace("<position", "<motor")
    assert robot_of(model_of(model, tmp_path)).simulation.drives[0].unit == "1"


def test_added_positions_are_bounded_in_radians(tmp_path: Path) -> None:
    degrees = GEARED.replace('damping="1"', 'range="-90 90"').partition("<actuator>")[0]
    robot = robot_of(model_of(f"{degrees}</mujoco>", tmp_path), actuate="position")
    (drive,) = robot.simulation.drives
    assert (drive.low, drive.high) == (pytest.approx(-math.pi / 2), pytest.approx(math.pi / 2))


def test_forces_have_the_unit_of_their_joint(tmp_path: Path) -> None:
    sensors = '<actuatorfrc name="push" actuator="push force"/><subtreecom name="com" body="puck"/>'
    robot = robot_of(model_of(PUCK.replace("<sensor>", f"<sensor>{sensors}"), tmp_path))
    schemas = {reading.name: value_type(reading.value).schema for reading in robot.readings()}
    assert schemas["sensor/push"]["unit"] == "N"
    assert schemas["sensor/com"]["items"]["unit"] == "m"


ROVER: Any = {"left": ("left_wheel",), "right": ("right_wheel",), "radius": 0.08, "track": 0.36}


def test_names_that_paths_cannot_tell_apart_get_a_number(tmp_path: Path) -> None:
    text = (MODELS / "rover.xml").read_text(encoding="utf-8")
    more = '<velocimeter name="velocity" site="imu"/><touch name="a b" site="imu"/>'
    motor = '<motor name="left wheel" joint="left_wheel"/></actuator>'
    text = text.replace("<sensor>", f'<sensor>{more}<touch name="a_b" site="imu"/>')
    model = model_of(text.replace("</actuator>", motor), tmp_path)
    robot = robot_of(model, wheels=WheelsConfig(**ROVER))
    names = [resource.name for resource in catalogue(robot, robot.readings()).resources]
    assert len(names) == len(set(names))
    expected = {"sensor/velocity_2", "sensor/contact/a_b", "sensor/contact/a_b_2"}
    assert expected < set(names)
    assert "actuator/left_wheel_2" in names


def test_joints_with_dots_in_their_names_form_an_arm(tmp_path: Path) -> None:
    text = (MODELS / "arm.xml").read_text(encoding="utf-8").replace('"joint_', '"arm.joint_')
    actuators = tuple(f"arm.joint_{number}" for number in range(1, 7))
    robot = robot_of(model_of(text, tmp_path), arm=ArmConfig(joints=actuators, tool="tool"))
    names = [resource.name for resource in catalogue(robot, robot.readings()).resources]
    assert "action/move_joints" in names
    assert robot.arm is not None
    assert robot.arm.names[0] == "arm_joint_1"


def test_a_force_that_nothing_measures_is_refused(tmp_path: Path) -> None:
    text = (MODELS / "arm.xml").read_text(encoding="utf-8")
    config = GripperConfig(actuator="gripper", open=0.04, closed=0.0)
    robot = robot_of(model_of(text, tmp_path), gripper=config)
    assert robot.gripper is not None
    with pytest.raises(InvalidValue, match="no touch sensors"):
        robot.gripper.move(Grip(0.0, 5.0))


# Time


def test_a_command_lapses_in_the_simulations_time() -> None:
    robot = robot_of()
    robot.wheels.drive(0.5, 0.0, 0.5)
    run(robot, 0.498)
    assert robot.wheels.target == (0.5, 0.0)
    assert robot.simulation.lapsed == []
    run(robot, 0.01)
    assert robot.wheels.target == (0.0, 0.0)
    assert robot.simulation.lapsed == ["cmd_vel"]
    until(robot, lambda: robot.snapshot().at_rest, 2.0)


def test_a_keyframe_does_not_command_a_force(tmp_path: Path) -> None:
    key = '<keyframe><key ctrl="5"/></keyframe></mujoco>'
    robot = robot_of(model_of(PUCK.replace("</mujoco>", key), tmp_path))
    run(robot, 1.0)
    assert robot.simulation.data.qpos[0] == pytest.approx(0.0, abs=1e-6)
    assert not robot.simulation.commanded
    robot.reset(None)
    assert not robot.simulation.commanded


def test_a_newer_command_starts_the_window_anew() -> None:
    robot = robot_of()
    for _ in range(5):
        robot.wheels.drive(0.5, 0.0, 0.5)
        run(robot, 0.4)
    assert robot.wheels.velocity[0] == pytest.approx(0.5, abs=0.05)


def test_a_single_actuator_lapses_too() -> None:
    robot = robot_of()
    drive = robot.simulation.drive("left_wheel")
    robot.simulation.command(drive, 3.0, 0.1)
    run(robot, 0.2)
    assert robot.simulation.data.ctrl[drive.number] == 0.0


def test_noise_comes_from_the_seed_and_from_nothing_else() -> None:
    def scans(seed: int) -> list[Any]:
        robot = robot_of(seed=seed)
        found: list[Any] = []
        for _ in range(3):
            run(robot, 0.1)
            found.append(readings(robot)["sensor/scan"].ranges)
        return found

    assert scans(1) == scans(1)
    assert scans(1) != scans(2)


def test_a_reset_with_a_seed_repeats_a_run_exactly() -> None:
    robot = robot_of(seed=3)
    runs: list[Any] = []
    for _ in range(2):
        robot.reset(3)
        robot.wheels.drive(0.4, 0.3, 1.0)
        run(robot, 1.0)
        runs.append((robot.simulation.data.qpos.tolist(), readings(robot)["sensor/scan"].ranges))
    assert runs[0] == runs[1]


# Stops


def test_brakes_stop_a_motor_that_would_coast(tmp_path: Path) -> None:
    robot = robot_of(model_of(PUCK, tmp_path))
    robot.simulation.command(robot.simulation.drives[0], 10.0, 1.0)
    run(robot, 0.2)
    fast = robot.simulation.data.qvel[0]
    robot.simulation.neutral(robot.simulation.drives[0])
    run(robot, 0.5)
    assert robot.simulation.data.qvel[0] == pytest.approx(fast)  # it coasts
    robot.simulation.brake("test")
    until(robot, lambda: robot.simulation.at_rest, 1.0)
    assert robot.simulation.data.qvel[3] < -1.0  # the ball, which is not the robot's, falls on


def test_brakes_hold_a_load(tmp_path: Path) -> None:
    robot = robot_of(model_of(ELBOW, tmp_path), actuate="torque")
    simulation = robot.simulation
    simulation.data.qpos[0] = 0.3
    simulation.brake("test")
    run(robot, 5.0)
    assert simulation.data.qpos[0] == pytest.approx(0.3, abs=0.005)
    assert simulation.at_rest


def test_brakes_override_whoever_else_sets_controls() -> None:
    robot = robot_of()
    robot.simulation.brake("test")
    for _ in range(500):
        robot.simulation.data.ctrl[:] = 8.0
        robot.simulation.step()
    assert np.abs(robot.simulation.data.qvel).max() < 0.01
    assert robot.simulation.at_rest


def test_what_is_left_of_a_motion_is_known_before_its_first_step() -> None:
    path = Quintic(np.array([0.0, 1.0]), np.array([0.5, -1.0]), speed=1.5, acceleration=4.0)
    assert Motion(path).left == pytest.approx(2.0)  # its first feedback may come before a step


def test_an_arm_that_is_stopped_holds_its_place_when_the_brakes_are_released() -> None:
    robot = robot_of("arm")
    goal = robot.arm.positions + np.array([1.5, 0.3, -0.3, 0, 0, 0])
    motion = Motion(Quintic(robot.arm.positions.copy(), goal, speed=1.5, acceleration=4.0))
    robot.arm.follow(motion)
    run(robot, 0.6)
    robot.simulation.brake("the robot was halted")
    assert motion.failure == "the robot was halted"
    until(robot, lambda: robot.simulation.at_rest, 1.0)
    here = robot.arm.positions.copy()
    run(robot, 1.0)
    robot.simulation.release()
    run(robot, 1.0)
    assert np.abs(robot.arm.positions - here).max() < 0.02


def test_a_robot_that_passes_through_standstill_is_not_at_rest(tmp_path: Path) -> None:
    robot = robot_of(model_of(PUCK, tmp_path))
    simulation = robot.simulation
    simulation.data.qvel[0] = 0.05
    simulation.command(simulation.drives[0], -10.0, None)
    slowest = math.inf
    for _ in range(100):
        simulation.step()
        slowest = min(slowest, abs(simulation.data.qvel[0]))
        assert not simulation.at_rest
    assert slowest < 0.01


# Divergence


@pytest.mark.parametrize("state", ["qpos", "qvel", "ctrl"])
def test_a_diverged_simulation_stops_and_is_never_reset_by_itself(state: str) -> None:
    robot = robot_of()
    run(robot, 0.1)
    getattr(robot.simulation.data, state)[0] = math.nan
    robot.simulation.step()
    fault = robot.simulation.fault
    assert fault is not None
    assert "not a number" in fault
    stopped = robot.simulation.time
    run(robot, 1.0)
    assert (robot.simulation.fault, robot.simulation.time) == (fault, stopped)
    assert not robot.simulation.at_rest
    with pytest.raises(PreconditionFailed, match="not a number"):
        robot.wheels.drive(0.1, 0.0, 1.0)
    robot.reset(None)
    run(robot, 0.2)
    assert robot.simulation.fault is None
    assert robot.simulation.at_rest


def test_an_explosion_is_a_fault() -> None:
    robot = robot_of()
    robot.simulation.data.qvel[:] = 1e12
    robot.simulation.step()
    assert robot.simulation.fault is not None


# Wheels


def test_a_trip_ends_at_rest_at_its_goal_and_turned() -> None:
    robot = robot_of()
    trip = make_trip(0.8, 0.5, -1.0, None, None)
    robot.wheels.go(trip)
    lefts: list[float] = []

    def over() -> bool:
        lefts.append(trip.left)
        return trip.over

    until(robot, over)
    x, y, yaw = robot.wheels.pose
    assert trip.phase == "done"
    assert math.dist((x, y), (0.8, 0.5)) < 0.08
    assert yaw == pytest.approx(-1.0, abs=0.06)
    assert robot.simulation.at_rest
    far = [left for left in lefts[100:] if left > 0.1]
    assert all(b <= a + 1e-3 for a, b in itertools.pairwise(far))


def test_positive_yaw_turns_left_and_positive_speed_goes_along_x() -> None:
    robot = robot_of()
    robot.wheels.drive(0.5, 0.0, 1.0)
    run(robot, 1.0)
    assert robot.wheels.pose[0] > 0.3
    assert abs(robot.wheels.pose[1]) < 0.01
    robot.wheels.drive(0.0, 0.5, 2.0)
    run(robot, 2.0)
    assert robot.wheels.pose[2] == pytest.approx(0.9, abs=0.2)
    x, y, yaw = robot.wheels.odometry
    assert math.dist((x, y), robot.wheels.pose[:2]) < 0.1
    assert yaw == pytest.approx(robot.wheels.pose[2], abs=0.1)


def test_a_trip_against_a_wall_gives_up() -> None:
    robot = robot_of()
    trip = make_trip(9.0, 0.0, None, None, None)
    robot.wheels.go(trip)
    until(robot, lambda: trip.over)
    assert trip.failure is not None
    assert "something is in the way" in trip.failure


def test_a_velocity_is_refused_on_a_trip_and_zero_ends_it() -> None:
    robot = robot_of()
    trip = make_trip(2.0, 0.0, None, None, None)
    robot.wheels.go(trip)
    run(robot, 0.5)
    with pytest.raises(ModeForbids, match="on its way"):
        robot.wheels.drive(0.1, 0.0, 1.0)
    robot.wheels.drive(0.0, 0.0, 1.0)
    assert trip.failure == "stopped by actuator/cmd_vel"


def test_the_end_of_a_velocity_does_not_end_the_trip_that_took_over_but_a_zero_does() -> None:
    robot = robot_of()
    robot.wheels.drive(0.5, 0.0, 0.5)
    run(robot, 0.1)
    trip = make_trip(2.0, 0.0, None, None, None)
    robot.wheels.go(trip)
    robot.wheels.end_velocity()
    assert not trip.over
    robot.wheels.drive(0.0, 0.0, 0.5)
    assert trip.over
    until(robot, lambda: robot.snapshot().at_rest, 2.0)


def test_wheels_that_are_commanded_one_by_one_do_not_keep_an_earlier_velocity() -> None:
    robot = robot_of()
    left = robot.simulation.drive("left_wheel")
    robot.wheels.drive(0.5, 0.0, 0.5)
    run(robot, 0.3)
    robot.wheels.yield_wheels()
    robot.simulation.command(left, 1.0, 0.1)
    assert robot.simulation.data.ctrl.tolist() == [1.0, 0.0]
    robot.wheels.yield_wheels()
    robot.simulation.command(robot.simulation.drive("right_wheel"), 1.0, 0.1)
    assert robot.simulation.data.ctrl.tolist() == [1.0, 1.0]
    run(robot, 0.2)
    assert robot.simulation.data.ctrl.tolist() == [0.0, 0.0]
    until(robot, lambda: robot.snapshot().at_rest, 2.0)


def test_a_trip_is_over_within_its_tolerance_only() -> None:
    robot = robot_of()
    trip = make_trip(0.3, 0.1, -1.0, 0.002, None)
    robot.wheels.go(trip)
    until(robot, lambda: trip.over)
    assert trip.failure is None
    assert math.dist(robot.wheels.pose[:2], (0.3, 0.1)) <= 0.002


def test_the_lapse_of_a_command_that_was_replaced_is_not_told() -> None:
    robot = robot_of()
    robot.wheels.drive(0.5, 0.0, 0.1)
    run(robot, 0.2)
    robot.wheels.drive(0.3, 0.0, 0.5)
    assert robot.simulation.lapsed == []


def test_the_lidar_sees_the_walls_where_they_are() -> None:
    robot = robot_of()
    run(robot, 0.2)
    scan = readings(robot)["sensor/scan"]
    assert isinstance(scan, LaserScan)
    assert len(scan.ranges) == 180
    ahead = min(range(180), key=lambda i: abs(scan.angle_min + i * scan.angle_increment))
    assert scan.ranges[ahead] == pytest.approx(6.0 - 0.05, abs=0.03)
    corner = min(range(180), key=lambda i: abs(scan.angle_min + i * scan.angle_increment + 2.356))
    assert scan.ranges[corner] == math.inf  # beyond its 8 m


def test_the_imu_reads_gravity_upwards_at_rest() -> None:
    robot = robot_of()
    run(robot, 1.0)
    imu = readings(robot)["sensor/imu"]
    assert imu.linear_acceleration.z == pytest.approx(9.81, abs=0.05)
    assert imu.orientation.w == pytest.approx(1.0, abs=1e-3)


# Arm and gripper


def motion_to(robot: Any, x: float, y: float, z: float) -> Motion:
    down = robot.kinematics.tool().quaternion
    qpos = robot.simulation.data.qpos.copy()
    joints = robot.kinematics.solve(qpos, np.array([x, y, z]), down)
    motion = Motion(Quintic(robot.arm.positions.copy(), joints, speed=1.5, acceleration=4.0))
    robot.arm.follow(motion)
    until(robot, lambda: motion.over)
    assert motion.arrived, motion.failure
    return motion


def grip_to(robot: Any, width: float, force: float | None = None) -> Grip:
    grip = Grip(width, force)
    robot.gripper.move(grip)
    until(robot, lambda: grip.over)
    assert grip.done, grip.failure
    return grip


def test_the_arm_picks_up_the_box_and_holds_it_through_a_stop() -> None:
    robot = robot_of("arm")
    motion_to(robot, 0.45, 0.0, 0.12)
    motion_to(robot, 0.45, 0.0, 0.02)
    assert not robot.gripper.holding
    grip_to(robot, 0.0, 8.0)
    assert robot.gripper.holding
    assert robot.gripper.width == pytest.approx(0.04, abs=0.004)
    motion_to(robot, 0.4, 0.1, 0.2)
    robot.simulation.brake("test")
    run(robot, 1.0)
    robot.simulation.release()
    run(robot, 1.0)
    box = readings(robot)["sensor/pose/box"].position
    assert (box.x, box.y, box.z) == pytest.approx((0.4, 0.1, 0.2), abs=0.02)
    motion_to(robot, 0.4, 0.1, 0.025)
    grip_to(robot, 0.08)
    assert not robot.gripper.holding


def test_a_gripper_that_closes_on_nothing_does_not_say_that_it_holds() -> None:
    robot = robot_of("arm")
    grip_to(robot, 0.0)
    assert robot.gripper.holding is False


def test_joints_that_are_held_up_do_not_arrive() -> None:
    robot = robot_of("arm")
    simulation = robot.simulation
    goal = robot.arm.positions + np.array([1.0, 0, 0, 0, 0, 0])
    motion = Motion(Quintic(robot.arm.positions.copy(), goal, speed=1.5, acceleration=4.0))
    robot.arm.follow(motion)
    simulation.model.actuator_forcerange[0] = (-0.1, 0.1)  # too weak for what it has to move
    until(robot, lambda: motion.over)
    assert not motion.arrived
    assert "joint_1 is" in str(motion.failure)
    assert abs(simulation.data.ctrl[0] - robot.arm.positions[0]) < 0.02  # and does not press on


def test_a_cancelled_motion_brakes_along_its_path() -> None:
    robot = robot_of("arm")
    goal = robot.arm.positions + np.array([2.0, 0, 0, 0, 0, 0])
    motion = Motion(Quintic(robot.arm.positions.copy(), goal, speed=1.5, acceleration=4.0))
    robot.arm.follow(motion)
    run(robot, 0.8)
    assert robot.simulation.data.qvel[0] > 1.0
    robot.arm.abandon(motion)
    run(robot, 0.1)
    assert robot.simulation.data.qvel[0] > 0.2  # no jolt
    until(robot, lambda: motion.over, 2.0)
    assert motion.failure == "cancelled"


def test_a_trajectory_passes_its_waypoints_at_their_times() -> None:
    robot = robot_of("arm")
    start = robot.arm.positions.copy()
    there, back = start.copy(), start.copy()
    there[0], back[3] = 0.5, 1.2
    points = [Waypoint(1.0, there, None), Waypoint(2.0, back, None)]
    motion = Motion(Spline(start, points, speed=1.5, names=robot.arm.names))
    robot.arm.follow(motion)
    run(robot, 1.0)
    assert robot.arm.positions[0] == pytest.approx(0.5, abs=0.06)
    until(robot, lambda: motion.over)
    assert motion.arrived
    assert np.abs(robot.arm.positions - back).max() < 0.02
