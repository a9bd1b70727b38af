"""Values of the common kinds as well-known Foxglove types, which panels draw by themselves.

A kind is recognised by the fields of the published schema, whichever backend has it.
"""

from __future__ import annotations

import base64
from collections.abc import Callable
from typing import Any, NamedTuple

from rcp_protocol.clock import parse_time

__all__ = ["WellKnown", "fields_of", "well_known"]

Convert = Callable[[Any, int], dict[str, Any]]
_SECOND = 1_000_000_000
_ORIGIN = {
    "position": {"x": 0.0, "y": 0.0, "z": 0.0},
    "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
}
_NUMERIC = {1: 2, 2: 1, 3: 4, 4: 3, 5: 6, 6: 5, 7: 7, 8: 8}
"""foxglove.NumericType (uint8 1, int8 2, …) by the number of sensor_msgs/PointField (int8 1, uint8 2, …)."""
_TIME = {
    "type": "object",
    "title": "time",
    "properties": {
        "sec": {"type": "integer", "minimum": 0},
        "nsec": {"type": "integer", "minimum": 0, "maximum": 999_999_999},
    },
}
_NUMBER: dict[str, Any] = {"type": "number"}
_INTEGER: dict[str, Any] = {"type": "integer"}
_TEXT: dict[str, Any] = {"type": "string"}
_BYTES = {"type": "string", "contentEncoding": "base64"}


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


def _list(items: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": items}


_VECTOR = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER, w=_NUMBER)
_POSE = _object(position=_VECTOR, orientation=_QUATERNION)
_TRANSFORM = _object(
    timestamp=_TIME,
    parent_frame_id=_TEXT,
    child_frame_id=_TEXT,
    translation=_VECTOR,
    rotation=_QUATERNION,
)
_FIELD = _object(name=_TEXT, offset=_INTEGER, type=_INTEGER)


class WellKnown(NamedTuple):
    """A type that panels know."""

    name: str
    schema: dict[str, Any]
    """JSON Schema."""
    convert: Convert
    """From a value and the time of its sample, ns."""
    same: frozenset[str]
    """Fields of the result that are those of the value, in JSON."""


def well_known(schema: dict[str, Any]) -> WellKnown | None:
    """Return the type as which values of a published schema are sent; None: as they are."""
    fields = fields_of(schema)
    return next((known for needs, known in _KNOWN if needs <= fields), None)


def fields_of(schema: dict[str, Any]) -> set[str]:
    """Return the names of a value's fields, also if it may be null."""
    named = schema.get("$ref", "")
    if named.startswith("#/$defs/"):
        return fields_of(schema.get("$defs", {}).get(named.removeprefix("#/$defs/"), {}))
    return set(schema.get("properties", ()))


def _stamp(nanoseconds: int) -> dict[str, int]:
    second, rest = divmod(max(0, nanoseconds), _SECOND)
    return {"sec": second, "nsec": rest}


def _head(value: Any, sampled: int) -> dict[str, Any]:
    """Return the fields of a stamped value in a frame."""
    stamp = getattr(value, "timestamp", None)
    moment = sampled if not isinstance(stamp, str) else parse_time(stamp)
    return {
        "timestamp": _stamp(moment),
        "frame_id": getattr(value, "frame_id", None) or "base_link",
    }


def _header(header: Any) -> dict[str, Any]:
    """Return the same for a value with the header of ROS."""
    stamp = {"sec": max(0, header.stamp.sec), "nsec": header.stamp.nanosec}
    return {"timestamp": stamp, "frame_id": header.frame_id}


def _vector(value: Any) -> dict[str, float]:
    return {"x": value.x, "y": value.y, "z": value.z}


def _quaternion(value: Any) -> dict[str, float]:
    return {"x": value.x, "y": value.y, "z": value.z, "w": value.w}


def _pose(value: Any) -> dict[str, Any]:
    return {"position": _vector(value.position), "orientation": _quaternion(value.orientation)}


def _data(data: bytes) -> str:
    return base64.b64encode(data).decode()


def _pose_in_frame(value: Any, sampled: int) -> dict[str, Any]:
    return {**_head(value, sampled), "pose": _pose(value)}


def _scan(value: Any, sampled: int) -> dict[str, Any]:
    ranges = list(value.ranges)
    last = value.angle_min + value.angle_increment * max(0, len(ranges) - 1)
    return {
        **_head(value, sampled),
        "pose": _ORIGIN,
        "start_angle": value.angle_min,
        "end_angle": last,
        "ranges": ranges,  # JSON has no infinity: a ray without an echo is null
        "intensities": list(getattr(value, "intensities", None) or ()),
    }


def _image(value: Any, sampled: int) -> dict[str, Any]:
    return {**_head(value, sampled), "data": _data(value.data), "format": value.format}


def _fix(value: Any, sampled: int) -> dict[str, Any]:
    return {
        **_head(value, sampled),
        "latitude": value.latitude,
        "longitude": value.longitude,
        "altitude": value.altitude,
        "position_covariance": [0.0] * 9,
        "position_covariance_type": 0,
    }


def _grid(value: Any, sampled: int) -> dict[str, Any]:
    cell = value.resolution
    return {
        **_head(value, sampled),
        "pose": _pose(value.origin),
        "column_count": value.width,
        "cell_size": {"x": cell, "y": cell},
        "row_stride": value.width,
        "cell_stride": 1,
        "fields": [{"name": "occupancy", "offset": 0, "type": 1}],
        "data": _data(value.data),
    }


def _transforms(value: Any, sampled: int) -> dict[str, Any]:
    return {"transforms": [_transform(one, sampled) for one in value.transforms]}


def _transform(value: Any, _sampled: int) -> dict[str, Any]:
    head = _header(value.header)
    return {
        "timestamp": head["timestamp"],
        "parent_frame_id": head["frame_id"],
        "child_frame_id": value.child_frame_id,
        "translation": _vector(value.transform.translation),
        "rotation": _quaternion(value.transform.rotation),
    }


def _flat_transform(value: Any, sampled: int) -> dict[str, Any]:
    head = _head(value, sampled)
    return {
        "timestamp": head["timestamp"],
        "parent_frame_id": head["frame_id"],
        "child_frame_id": value.child_frame_id,
        "translation": _vector(value.translation),
        "rotation": _quaternion(value.rotation),
    }


def _points(value: Any, _sampled: int) -> dict[str, Any]:
    fields = [
        {"name": one.name, "offset": one.offset, "type": _NUMERIC.get(one.datatype, 0)}
        for one in value.fields
    ]
    return {
        **_header(value.header),
        "pose": _ORIGIN,
        "point_stride": value.point_step,
        "fields": fields,
        "data": _data(value.data),
    }


def _of(name: str, convert: Convert, same: str, **properties: Any) -> WellKnown:
    title = f"foxglove.{name}"
    schema = {"title": title, **_object(**properties)}
    return WellKnown(title, schema, convert, frozenset(same.split()))


_STAMPED = {"timestamp": _TIME, "frame_id": _TEXT}
_POSE_PROPERTIES = {**_STAMPED, "pose": _POSE}
_KNOWN: list[tuple[set[str], WellKnown]] = [
    (
        {"ranges", "angle_min", "angle_increment"},
        _of(
            "LaserScan",
            _scan,
            "ranges intensities",
            **_POSE_PROPERTIES,
            start_angle=_NUMBER,
            end_angle=_NUMBER,
            ranges=_list(_NUMBER),
            intensities=_list(_NUMBER),
        ),
    ),
    (
        {"data", "format", "width", "height", "frame_id"},
        _of("CompressedImage", _image, "data format", **_STAMPED, data=_BYTES, format=_TEXT),
    ),
    (
        {"latitude", "longitude", "altitude", "fix"},
        _of(
            "LocationFix",
            _fix,
            "latitude longitude altitude",
            **_STAMPED,
            latitude=_NUMBER,
            longitude=_NUMBER,
            altitude=_NUMBER,
            position_covariance=_list(_NUMBER),
            position_covariance_type=_INTEGER,
        ),
    ),
    (
        {"resolution", "width", "height", "origin", "data", "frame_id"},
        _of(
            "Grid",
            _grid,
            "data",
            **_POSE_PROPERTIES,
            column_count=_INTEGER,
            cell_size=_object(x=_NUMBER, y=_NUMBER),
            row_stride=_INTEGER,
            cell_stride=_INTEGER,
            fields=_list(_FIELD),
            data=_BYTES,
        ),
    ),
    (
        {"point_step", "row_step", "fields", "data", "header"},
        _of(
            "PointCloud",
            _points,
            "data",
            **_POSE_PROPERTIES,
            point_stride=_INTEGER,
            fields=_list(_FIELD),
            data=_BYTES,
        ),
    ),
    ({"transforms"}, _of("FrameTransforms", _transforms, "", transforms=_list(_TRANSFORM))),
    (
        {"header", "child_frame_id", "transform"},
        WellKnown(
            "foxglove.FrameTransform",
            {"title": "foxglove.FrameTransform", **_TRANSFORM},
            _transform,
            frozenset(),
        ),
    ),
    (
        {"translation", "rotation", "frame_id", "child_frame_id"},
        WellKnown(
            "foxglove.FrameTransform",
            {"title": "foxglove.FrameTransform", **_TRANSFORM},
            _flat_transform,
            frozenset(("child_frame_id", "translation", "rotation")),
        ),
    ),
    (
        {"position", "orientation", "frame_id"},
        _of("PoseInFrame", _pose_in_frame, "", **_POSE_PROPERTIES),
    ),
]
"""The first one whose fields a value has."""
