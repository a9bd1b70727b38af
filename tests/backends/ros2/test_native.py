"""The serialised types of resources: texts that decoders read, and commands in the robot's own bytes."""

from __future__ import annotations

import math
import struct

import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Twist, TwistStamped, Vector3
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import LaserScan
from std_srvs.srv import Trigger
from test_msgs.msg import Arrays, BasicTypes, BoundedSequences, Strings, WStrings

from rcp_ros2.cdr import Codec, Malformed
from rcp_ros2.definitions import define_text, parse
from rcp_ros2.idl import fields_of, load
from rcp_ros2.native import message_text, native_type

ALL = [Odometry, LaserScan, Twist, BasicTypes, Arrays, BoundedSequences, Strings, WStrings, Time]


@pytest.mark.parametrize("cls", ALL, ids=lambda cls: cls.__name__)
def test_a_text_has_each_message_in_it_once_and_the_fields_in_their_order(cls: type) -> None:
    native = native_type(cls)
    texts = parse(native.name, native.schema)
    assert [part.name for part in texts[native.name]] == [field.name for field in fields_of(cls)]
    assert "\0" not in native.schema
    named = [line for line in native.schema.splitlines() if line.startswith("MSG: ")]
    assert len(named) == len(set(named)) == len(texts) - 1
    for name, parts in texts.items():
        assert [part.name for part in parts] == [f.name for f in fields_of(load(name))], name


def test_a_text_keeps_the_constants_that_viewers_show() -> None:
    from sensor_msgs.msg import BatteryState

    assert "POWER_SUPPLY_STATUS_CHARGING" in native_type(BatteryState).schema


def test_a_type_without_a_package_has_the_text_that_it_was_made_of() -> None:
    define_text("own_msgs/msg/Part", "int32[<=3] numbers\nstring<=5 word\nbyte raw")
    define_text("own_msgs/msg/Whole", "own_msgs/Part[2] parts\ngeometry_msgs/Vector3 place")
    text = message_text(load("own_msgs/msg/Whole"))
    assert text.startswith("own_msgs/Part[2] parts\ngeometry_msgs/Vector3 place\n====")
    assert "MSG: own_msgs/Part\nint32[<=3] numbers\nstring<=5 word\nbyte raw\n" in text
    assert "MSG: geometry_msgs/Vector3\n" in text


def test_a_command_is_decoded_and_garbage_is_none() -> None:
    decode = native_type(Twist).decode
    assert decode is not None
    value = decode(serialize_message(Twist(linear=Vector3(x=0.5))))
    assert (value.linear.x, value.angular.z) == (0.5, 0.0)
    for wrong in (
        b"",
        b"\x00\x01",
        b"\x00\x01\x00\x00" + bytes(7),
        b"\xff\xff\xff\xff" + bytes(48),
    ):
        with pytest.raises(Malformed):
            decode(wrong)


def test_a_length_that_lies_is_refused_at_once() -> None:
    decode = native_type(LaserScan).decode
    assert decode is not None
    data = bytearray(serialize_message(LaserScan(ranges=[1.0, math.inf])))
    at = len(data) - 4 - 8 - 4
    struct.pack_into("<I", data, at, 2**32 - 1)
    with pytest.raises(Malformed):
        decode(bytes(data))


def test_a_result_is_encoded_as_ros_does() -> None:
    native = native_type(Trigger.Response, written=True)
    assert native.name == "std_srvs/srv/Trigger_Response"
    response = Trigger.Response(success=True, message="done")
    data = serialize_message(response)
    assert native.encode is not None
    value = Codec(Trigger.Response).decode(data)
    assert deserialize_message(native.encode(value), Trigger.Response) == response
    assert native_type(Trigger.Request).schema.strip() == ""


def test_the_time_of_a_stamped_velocity_is_not_a_clients_affair() -> None:
    from rcp_ros2.standard import _native_twist

    native = _native_twist(TwistStamped)
    message = TwistStamped()
    message.twist.linear.x = 0.75
    assert native.decode is not None
    assert native.decode(serialize_message(message)).linear.x == 0.75
