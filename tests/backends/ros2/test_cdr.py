"""The compiled decoder against rclpy's own, over every form a field can have."""

from __future__ import annotations

import math
import random
import struct
from typing import Any

import msgspec
import pytest
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import LaserScan
from std_srvs.srv import Trigger

from backends.ros2.messages import MESSAGES, message, message_class, ours, theirs
from rcp_kernel.errors import ConfigError
from rcp_kernel.values import Encoding, value_type
from rcp_ros2.cdr import Codec, Malformed
from rcp_ros2.filler import filler
from rcp_ros2.idl import MissingType, fields_of, load
from rcp_ros2.services import reader
from rcp_ros2.types import inward


@pytest.mark.parametrize("name", MESSAGES)
def test_defaults_decode_as_rclpy_decodes_them(name: str) -> None:
    cls = message_class(name)
    data = serialize_message(cls())
    codec = Codec(cls)
    value = codec.decode(data)
    assert ours(value) == theirs(deserialize_message(data, cls))
    checked, _ = value_type(codec.type).check(value)
    assert checked is not None


@pytest.mark.parametrize("name", MESSAGES)
def test_any_value_decodes_as_rclpy_decodes_it(name: str) -> None:
    cls = message_class(name)
    codec = Codec(cls)
    for seed in range(40):
        data = serialize_message(message(cls, random.Random(seed)))
        assert ours(codec.decode(data)) == theirs(deserialize_message(data, cls)), seed


@pytest.mark.parametrize("cls", [Trigger.Response, *map(message_class, MESSAGES)])
def test_an_answer_is_read_as_its_bytes_are_decoded(cls: Any) -> None:
    codec = Codec(cls)
    read = reader(codec)
    for seed in range(10):
        data = serialize_message(message(cls, random.Random(seed)))
        assert ours(read(deserialize_message(data, cls))) == ours(codec.decode(data)), seed


@pytest.mark.parametrize("name", MESSAGES)
def test_the_inward_type_makes_the_same_message(name: str) -> None:
    cls = message_class(name)
    value = inward(cls)()
    made = filler(cls)(value)
    assert theirs(deserialize_message(serialize_message(made), cls)) == theirs(cls())


def test_integers_at_their_ends_survive_json_and_the_way_in() -> None:
    cls = message_class("BasicTypes")
    top = {"int64_value": 2**63 - 1, "uint64_value": 2**64 - 1, "int8_value": -128}
    declared = value_type(inward(cls))
    value = declared.convert({**top, "uint64_value": str(2**64 - 1)})
    data = serialize_message(filler(cls)(value))
    back = Codec(cls).decode(data)
    assert {name: getattr(back, name) for name in top} == top
    text = value_type(Codec(cls).type).encode(back, Encoding.JSON)
    assert b'"uint64_value":"18446744073709551615"' in text


def test_big_endian_is_decoded_too() -> None:
    body = struct.pack(">?BBxfdbBhHxxiIqQ", True, 2, 3, 1.5, 2.5, -1, 2, -3, 4, -5, 6, -7, 8)
    value = Codec(message_class("BasicTypes")).decode(b"\x00\x00\x00\x00" + body)
    assert msgspec.structs.astuple(value) == (True, 2, 3, 1.5, 2.5, -1, 2, -3, 4, -5, 6, -7, 8)


def test_another_encoding_is_malformed() -> None:
    with pytest.raises(Malformed, match="0007"):
        Codec(message_class("BasicTypes")).decode(b"\x00\x07\x00\x00" + bytes(64))


@pytest.mark.parametrize("name", ["Arrays", "Strings", "UnboundedSequences", "WStrings", "Nested"])
def test_bytes_cut_short_are_malformed_and_never_another_value(name: str) -> None:
    cls = message_class(name)
    data = serialize_message(message(cls, random.Random(7)))
    codec = Codec(cls)
    whole = ours(codec.decode(data))
    cut = 0
    for length in range(0, len(data) - 1, 3):
        try:
            assert ours(codec.decode(data[:length])) == whole  # only padding was cut
        except Malformed:
            cut += 1
    assert cut > 10


def test_a_length_that_lies_is_malformed() -> None:
    lie = b"\x00\x01\x00\x00" + b"\xff\xff\xff\x7f" * 8
    for name in ("Strings", "UnboundedSequences", "WStrings"):
        with pytest.raises(Malformed):
            Codec(message_class(name)).decode(lie)


def test_a_projection_decodes_the_part_alone() -> None:
    odom = Odometry()
    odom.pose.pose.position.x = 3.0
    odom.twist.covariance[35] = math.nan
    data = serialize_message(odom)
    assert Codec(Odometry, "pose.pose.position").decode(data).x == 3.0
    assert math.isnan(Codec(Odometry, "twist.covariance").decode(data)[35])
    assert Codec(Odometry, "child_frame_id").decode(data) == ""
    ranges = serialize_message(LaserScan(ranges=[1.0, math.inf]))
    assert list(Codec(LaserScan, "ranges").decode(ranges)) == [1.0, math.inf]


def test_a_projection_that_leads_nowhere_names_the_fields_there_are() -> None:
    with pytest.raises(ConfigError, match=r"has no field 'poze'.*header"):
        Codec(Odometry, "poze.pose")
    with pytest.raises(ConfigError, match="has no fields"):
        Codec(Odometry, "child_frame_id.x")


def test_a_type_that_is_not_installed_says_how_to_get_it() -> None:
    with pytest.raises(MissingType) as caught:
        load("example_interfaces/msg/Bool")
    assert "pip install ros-example-interfaces" in caught.value.remedy
    with pytest.raises(MissingType):
        load("std_msgs/msg/NoSuchThing")


def test_units_follow_the_context() -> None:
    schema = value_type(Codec(Odometry).type).schema["$defs"]
    twist = schema["Twist"]["properties"]
    assert "Vector3_m_s" in twist["linear"]["$ref"]
    assert schema["Vector3_rad_s"]["properties"]["z"]["unit"] == "rad/s"
    assert schema["Time"]["properties"]["sec"]["unit"] == "s"


def test_inward_floats_are_finite_and_unknown_fields_refused() -> None:
    declared = value_type(inward(load("geometry_msgs/msg/Twist")))
    for bad in ({"linear": {"x": "NaN"}}, {"linaer": {}}):
        with pytest.raises(Exception, match=r"finite|unknown field"):
            declared.convert(bad)
    assert fields_of(load("geometry_msgs/msg/Twist"))[0].name == "linear"
