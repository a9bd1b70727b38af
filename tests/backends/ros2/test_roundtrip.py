"""Every form a field can have goes from ROS through each encoding and back, unchanged."""

from __future__ import annotations

import importlib
import random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message

from backends.ros2.messages import FINITE, MESSAGES, message, message_class, ours, theirs
from rcp_kernel.values import Encoding, value_type
from rcp_ros2.cdr import Codec
from rcp_ros2.filler import filler
from rcp_ros2.types import inward

CALLS = [
    getattr(getattr(importlib.import_module("test_msgs.srv"), name), part)
    for name in ("Arrays", "BasicTypes", "Empty")
    for part in ("Request", "Response")
]
GOALS = [
    getattr(getattr(importlib.import_module("test_msgs.action"), name), part)
    for name in ("Fibonacci", "NestedMessage")
    for part in ("Goal", "Result", "Feedback")
]
TYPES = [message_class(name) for name in MESSAGES] + CALLS + GOALS
chances = st.integers(0, 2**32).map(random.Random)


@pytest.mark.parametrize("cls", TYPES, ids=lambda cls: cls.__name__)
@settings(max_examples=12)
@given(chance=chances)
def test_what_ros_says_is_what_a_client_reads(cls: Any, chance: random.Random) -> None:
    codec = Codec(cls)
    value = codec.decode(bytes(serialize_message(message(cls, chance))))
    declared = value_type(codec.type)
    for encoding in Encoding:
        again = declared.decode(declared.encode(value, encoding), encoding)
        assert ours(again) == ours(value), encoding


@pytest.mark.parametrize("cls", TYPES, ids=lambda cls: cls.__name__)
@settings(max_examples=12)
@given(chance=chances)
def test_what_a_client_reads_and_sends_back_is_what_ros_said(
    cls: Any, chance: random.Random
) -> None:
    """Without NaN and infinities, which commands refuse."""
    said = message(cls, chance, FINITE)
    codec = Codec(cls)
    value = codec.decode(bytes(serialize_message(said)))
    for encoding in Encoding:
        read = value_type(codec.type).encode(value, encoding)
        sent = filler(cls)(value_type(inward(cls)).decode(read, encoding))
        again = deserialize_message(serialize_message(sent), cls)
        assert theirs(again) == theirs(deserialize_message(serialize_message(said), cls)), encoding
