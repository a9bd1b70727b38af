"""What the sensors say, held against the truth."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rcp_kernel.values import Encoding, value_type
from rcp_sim import SimConfig
from rcp_sim.body import DESCRIPTION, joints, transforms
from rcp_sim.camera import EYE, HEIGHT, WIDTH, picture
from rcp_sim.depth import COLUMNS, REACH, ROWS, Depth
from rcp_sim.messages import Box
from rcp_sim.raycast import Fan
from rcp_sim.sensors import Sensors, battery, pose
from rcp_sim.simulation import Simulation
from rcp_sim.world import WAREHOUSE, World

NOW = 1_800_000_000_000_000_000


def bench(**config: Any) -> tuple[Simulation, Sensors]:
    settings_ = SimConfig(**{"map_resolution": 0.5, **config})
    sim = Simulation(settings_)
    return sim, Sensors(settings_, sim.rover)


def one_by_one(world: World, x: float, y: float, angle: float, reach: float) -> float:
    """Cast a single ray against every face: slow, and plainly right."""
    best = math.inf
    cosine, sine = math.cos(angle), math.sin(angle)
    for face in world.faces:
        along, across = (cosine, sine) if face.upright else (sine, cosine)
        start, side = (x, y) if face.upright else (y, x)
        if along == 0 or (start - face.at) * face.normal <= 0:
            continue
        distance = (face.at - start) / along
        if distance > 0 and face.low <= side + distance * across <= face.high:
            best = min(best, distance)
    return best if best <= reach else math.inf


@settings(max_examples=100)
@given(st.floats(-19, 19), st.floats(-19, 19), st.floats(-7, 7), st.floats(2, 60))
def test_a_fan_of_rays_measures_what_single_rays_do(
    x: float, y: float, heading: float, reach: float
) -> None:
    angles = [-math.pi + i * 2 * math.pi / 64 for i in range(64)]
    ranges, hits = Fan(angles).cast(WAREHOUSE.faces, x, y, heading, reach)
    wrong = 0
    for angle, measured, hit in zip(angles, ranges, hits, strict=True):
        expected = one_by_one(WAREHOUSE, x, y, heading + angle, reach)
        wrong += not math.isclose(measured, expected, abs_tol=1e-6)
        assert (hit < 0) == math.isinf(measured)
    assert wrong <= 4  # rays that graze edges may fall to either side: before, behind, left, right


def test_a_scan_has_infinity_where_nothing_returns() -> None:
    sim, sensors = bench()
    scan = sensors.scan(sim, NOW)
    assert len(scan.ranges) == 360
    assert math.inf in scan.ranges
    finite = [r for r in scan.ranges if r != math.inf]
    assert finite
    assert all(scan.range_min <= r <= scan.range_max for r in finite)
    value, _ = value_type(type(scan)).check(scan)
    assert b'"Infinity"' in value_type(type(scan)).encode(value, Encoding.JSON)


def test_a_scan_sees_a_box_ahead_at_its_distance() -> None:
    sim, sensors = bench(noise=0)
    sim.place(Box(3.0, 0.0, 1.0, 1.0))
    ahead = sensors.scan(sim, NOW).ranges[180]
    assert ahead == pytest.approx(2.5)


def test_noise_is_the_same_for_the_same_seed_and_none_if_wanted() -> None:
    first, second, other = (bench(seed=seed) for seed in (3, 3, 4))
    same = [s.imu(sim.rover, NOW) for sim, s in (first, second, other)]
    assert same[0] == same[1] != same[2]
    assert first[1].scan(first[0], NOW) == second[1].scan(second[0], NOW)
    sim, exact = bench(noise=0)
    assert exact.imu(sim.rover, NOW).linear_acceleration.z == pytest.approx(9.80665)


def test_odometry_drifts_from_the_truth_but_not_far() -> None:
    def driven(noise: float) -> tuple[float, float]:
        sim, sensors = bench(noise=noise)
        sim.drive(0.8, 0.2)
        for _ in range(1000):
            sim.step(0.02)
            sensors.wheels.follow(sim.rover)
        said = sensors.odometry(sim.rover, NOW).pose.position
        return math.dist((said.x, said.y), (sim.rover.x, sim.rover.y)), sim.rover.travelled

    error, way = driven(1)
    assert 0.001 < error < 0.1 * way
    assert driven(0)[0] < 1e-6


def test_the_imu_feels_acceleration_and_turning() -> None:
    sim, sensors = bench(noise=0)
    sim.drive(1.0, 0.5)
    sim.step(0.1)
    felt = sensors.imu(sim.rover, NOW)
    assert felt.linear_acceleration.x == pytest.approx(1.0)
    assert felt.angular_velocity.z == pytest.approx(sim.rover.w) != 0


def test_the_pose_is_that_of_the_papers_example() -> None:
    sim, _ = bench()
    plain = value_type(type(pose(sim.rover, NOW))).encode(pose(sim.rover, NOW), Encoding.JSON)
    for part in (
        b'"position":{"x":',
        b'"orientation":{"x":',
        b'"frame_id":"map"',
        b'"timestamp":"',
    ):
        assert part in plain


def test_the_battery_reads_like_its_pack() -> None:
    sim, _ = bench()
    state = battery(sim, NOW)
    assert 9.5 < state.voltage < 12.7
    assert state.current < 0
    assert state.percentage == pytest.approx(0.95)
    assert not state.charging


def unpacked(png: bytes) -> list[bytes]:
    assert png.startswith(b"\x89PNG\r\n\x1a\n")
    at, pixels = 8, b""
    while at < len(png):
        size, kind = struct.unpack(">I4s", png[at : at + 8])
        body = png[at + 8 : at + 8 + size]
        assert zlib.crc32(kind + body) == struct.unpack(">I", png[at + 8 + size :][:4])[0]
        pixels += body if kind == b"IDAT" else b""
        at += size + 12
    rows = zlib.decompress(pixels)
    return [rows[i * (WIDTH + 1) + 1 : (i + 1) * (WIDTH + 1)] for i in range(HEIGHT)]


def test_the_camera_sees_a_box_come_nearer() -> None:
    def width_of_box(distance: float) -> int:
        sim, _ = bench(world="empty")
        sim.place(Box(distance, 0.0, 0.5, 0.5))
        image = picture(sim, NOW)
        assert (image.width, image.height) == (WIDTH, HEIGHT)
        row = unpacked(image.data)[HEIGHT // 2 + 1]
        return sum(pixel >= 120 + 2 * 16 for pixel in row)

    assert 0 < width_of_box(6.0) < width_of_box(3.0) < width_of_box(1.0)


def test_the_map_changes_with_the_boxes(make_rig: Callable[..., Any]) -> None:
    rig = make_rig()
    rig.tick(1)
    assert rig.host.count("sensor/map") == 1
    rig.sim.place(Box(3.0, 1.0, 1.0, 1.0))
    rig.tick(1)
    before, after = rig.host.samples["sensor/map"]
    assert sum(after.data) > sum(before.data)


def test_the_texture_of_a_wall_moves_with_the_rover() -> None:
    sim, _ = bench()
    sim.rover.x, sim.rover.y, sim.rover.yaw = 0.0, -18.0, -math.pi / 2
    before = unpacked(picture(sim, NOW).data)[HEIGHT // 2 + 8]
    assert len(set(before)) > 1  # seams between what is plain
    sim.rover.x = 1.0
    after = unpacked(picture(sim, NOW).data)[HEIGHT // 2 + 8]
    assert before != after
    assert set(before) == set(after)


def points(cloud: Any) -> list[tuple[float, float, float]]:
    assert cloud.width * cloud.point_step == cloud.row_step == len(cloud.data)
    assert [(f.name, f.offset) for f in cloud.fields] == [("x", 0), ("y", 4), ("z", 8), ("rgb", 12)]
    return [point[:3] for point in struct.iter_unpack("=3f4x", cloud.data)]


@settings(max_examples=60)
@given(st.floats(-18, 18), st.floats(-18, 18), st.floats(-4, 4))
def test_each_point_of_a_cloud_lies_on_the_floor_or_on_a_face(
    x: float, y: float, yaw: float
) -> None:
    sim, _ = bench()
    sim.rover.x, sim.rover.y, sim.rover.yaw = x, y, yaw
    cosine, sine = math.cos(yaw), math.sin(yaw)
    found = points(Depth(1, 0).cloud(sim, NOW))
    assert len(found) <= COLUMNS * ROWS
    for ahead, left, up in found[::7]:
        place = (x + cosine * ahead - sine * left, y + sine * ahead + cosine * left)
        assert 0 < ahead <= REACH
        on_floor = abs(up + EYE) < 1e-6
        assert on_floor or abs(WAREHOUSE.clearance(*place)) < 1e-3


def test_a_cloud_shows_a_box_ahead_at_its_distance_and_height() -> None:
    sim, _ = bench(world="empty")
    sim.place(Box(4.5, 0.0, 1.0, 1.0))
    box = [one for one in points(Depth(1, 0).cloud(sim, NOW)) if one[0] == pytest.approx(4)]
    above = [up + EYE for _, left, up in box if abs(left) < 0.4]
    assert len(above) > 100
    assert 1.7 < max(above) <= 1.8


def test_the_transforms_lead_from_the_map_to_where_the_rover_is() -> None:
    sim, sensors = bench()
    sim.drive(0.8, 0.3)
    for _ in range(500):
        sim.step(0.02)
        sensors.wheels.follow(sim.rover)
    tree = {t.child_frame_id: t for t in transforms(sim.rover, sensors.wheels, NOW).transforms}
    assert {child: t.header.frame_id for child, t in tree.items()} == {
        "odom": "map",
        "base_link": "odom",
        "laser": "base_link",
        "camera": "base_link",
    }
    assert tree["odom"].header.stamp.sec == NOW // 10**9
    odom, base = tree["odom"].transform, tree["base_link"].transform
    turn = 2 * math.atan2(odom.rotation.z, odom.rotation.w)
    cosine, sine = math.cos(turn), math.sin(turn)
    x = odom.translation.x + cosine * base.translation.x - sine * base.translation.y
    y = odom.translation.y + sine * base.translation.x + cosine * base.translation.y
    assert (x, y) == pytest.approx((sim.rover.x, sim.rover.y))
    assert 0 < math.hypot(odom.translation.x, odom.translation.y) < 1  # the wheels are wrong


def test_wheels_turn_as_far_as_the_rover_drives() -> None:
    sim, _ = bench()
    sim.drive(1.0, 0.0)
    for _ in range(100):
        sim.step(0.02)
    state = joints(sim.rover, NOW)
    assert state.position == pytest.approx([sim.rover.path / 0.08] * 2)
    assert state.velocity == pytest.approx([sim.rover.v / 0.08] * 2)
    sim.drive(0.0, 1.0)
    sim.step(0.5)
    left, right = (
        b - a for a, b in zip(state.position, joints(sim.rover, NOW).position, strict=True)
    )
    assert left < right


def test_the_description_has_the_joints_and_frames_that_are_told_of() -> None:
    sim, sensors = bench()
    robot = ET.fromstring(DESCRIPTION)
    links = {link.get("name") for link in robot.iter("link")}
    assert set(joints(sim.rover, NOW).name) <= {joint.get("name") for joint in robot.iter("joint")}
    tree = transforms(sim.rover, sensors.wheels, NOW).transforms
    assert {t.child_frame_id for t in tree} - {"odom"} <= links
    assert not list(robot.iter("mesh"))
