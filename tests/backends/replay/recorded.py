"""Recordings for the tests of replay, written by the recorder's own writer."""

from __future__ import annotations

from pathlib import Path

import msgspec

from rcp_kernel.types import PoseStamped, quantity
from rcp_kernel.values import value_type
from rcp_recorder.channels import Channel, Message, Stream, note_channel
from rcp_recorder.mcap_file import OpenFile

__all__ = ["SECOND", "START", "written"]

SECOND = 10**9
START = 1_800_000_000 * SECOND
ROS = "builtin_interfaces/Time stamp\nstring frame_id"


def _channel(name: str, type_: object) -> Channel:
    path, kind = f"/tenant/alpha/{name}", value_type(type_)
    return Channel(
        topic=path,
        kind="sample",
        path=path,
        schema_name=kind.schema_id.rpartition(".")[0],
        schema=msgspec.json.encode(kind.schema),
        facts={"description": "What was measured."},
    )


def written(folder: Path, seconds: float, rate: float = 10.0) -> Path:
    """Write a recording of a speed, a drive, a pose and a command."""
    speed, drive = (_channel(name, quantity("m/s")) for name in ("sensor/speed", "actuator/drive"))
    pose = _channel("sensor/pose", PoseStamped)
    header = Channel(
        topic="/tenant/alpha/sensor/header",
        kind="sample",
        path="/tenant/alpha/sensor/header",
        schema_name="std_msgs/msg/Header",
        schema=ROS.encode(),
        schema_encoding="ros2msg",
        encoding="cdr",
        facts={"value_schema": '{"type":"object","properties":{"frame_id":{"type":"string"}}}'},
    )
    command = note_channel("command", "/tenant/alpha/action/go", "alpha")
    file = OpenFile(
        folder / "drive.alpha.mcap.active", Stream("drive", "alpha", {"recording": "drive"}), 0
    )
    count = int(seconds * rate)
    for number in range(count):
        at = START + int(number * SECOND / rate)
        file.add(Message(speed, at, at - 5, number + 1, b"%d" % number))
        if number % 10 == 0:
            file.add(Message(drive, at, at, number + 1, b"0.5"))
            x = b'{"position":{"x":%d.0,"y":0.0,"z":0.0},"frame_id":"map"}' % number
            file.add(Message(pose, at, at, number + 1, x))
            cdr = (
                b"\x00\x01\x00\x00"
                + number.to_bytes(4, "little")
                + bytes(4)
                + b"\x04\x00\x00\x00map\x00"
            )
            file.add(Message(header, at, at, number + 1, cdr))
        if number % 1000 == 999:
            file.flush(0)
    file.add(Message(command, at, at, 0, b'{"status":"completed"}'))
    return file.finish()
