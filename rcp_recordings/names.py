"""The words of our recordings: names of metadata, of channels' facts, of files."""

from __future__ import annotations

from typing import Literal

__all__ = [
    "ACTIVE",
    "COMMAND",
    "DESCRIPTION",
    "ESTOP",
    "EVENT",
    "FACTS",
    "KIND",
    "NATIVE",
    "NOTICE",
    "PATH",
    "QOS",
    "RECOVERY",
    "ROBOT",
    "SAMPLE",
    "TOPIC",
    "VALUE_SCHEMA",
    "MessageKind",
]

ACTIVE = ".active"
"""What the name of a file ends in until it is complete."""
FACTS, ROBOT, RECOVERY = "rcp", "rcp.robot", "rcp.recovery"
"""Names of metadata records."""
PATH, KIND = "path", "kind"
"""Facts of a channel: the resource that it is about, and how."""
DESCRIPTION, VALUE_SCHEMA = "description", "value_schema"
"""Of a channel of samples: what the resource is, and the JSON Schema of its values where the channel's own
schema is another one."""
TOPIC, QOS = "ros_topic", "offered_qos_profiles"
"""Of a channel of ROS messages."""
SAMPLE, NATIVE, COMMAND, EVENT, ESTOP = "sample", "native", "command", "event", "estop"
NOTICE = "notice"
MessageKind = Literal["sample", "native", "command", "event", "estop", "notice"]
"""Kinds of channels. `native`: the ROS message that a sample is a part of; `notice`: what is told of a robot as a
whole."""
