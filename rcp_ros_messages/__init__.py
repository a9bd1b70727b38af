"""ROS 2 messages for robots of any kind: common types as data, and which resource is which message.

For adapters that speak to ROS clients. Nothing of ROS is imported.
"""

from __future__ import annotations

from rcp_ros_messages.cdr import encode_cdr
from rcp_ros_messages.mapping import ACTIONS, COMMANDS, TOPICS, ActionMapping, Command, Topic
from rcp_ros_messages.message_type import (
    Constant,
    Field,
    MessageType,
    full_name,
    message_text,
    message_type,
    parse_all,
    short_name,
    zero,
)
from rcp_ros_messages.refusal import refused_response
from rcp_ros_messages.source import Source, time_of

__all__ = [
    "ACTIONS",
    "COMMANDS",
    "TOPICS",
    "ActionMapping",
    "Command",
    "Constant",
    "Field",
    "MessageType",
    "Source",
    "Topic",
    "encode_cdr",
    "full_name",
    "message_text",
    "message_type",
    "parse_all",
    "refused_response",
    "short_name",
    "time_of",
    "zero",
]
