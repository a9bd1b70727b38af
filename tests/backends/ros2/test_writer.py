"""The encoder for types without code, against rclpy's own, over every form a field can have."""

from __future__ import annotations

import random

import pytest
from rclpy.serialization import deserialize_message, serialize_message

from backends.ros2.messages import MESSAGES, message, message_class, ours, theirs
from rcp_ros2.cdr import Codec
from rcp_ros2.types import inward
from rcp_ros2.writer import writer


@pytest.mark.parametrize("name", MESSAGES)
def test_random_values_are_read_by_rclpy_as_they_were(name: str) -> None:
    cls = message_class(name)
    codec, write = Codec(cls), writer(cls)
    chance = random.Random(name)
    for _ in range(50):
        sent = serialize_message(message(cls, chance))
        value = codec.decode(sent)
        data = write(value)
        assert theirs(deserialize_message(data, cls)) == theirs(deserialize_message(sent, cls))
        assert ours(codec.decode(data)) == ours(value)


@pytest.mark.parametrize("name", MESSAGES)
def test_defaults_are_read_by_rclpy_as_its_own(name: str) -> None:
    cls = message_class(name)
    data = writer(cls)(inward(cls)())
    assert theirs(deserialize_message(data, cls)) == theirs(cls())
