"""The camera: the ground below and the boxes that stand on it, as a PNG with a palette."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from typing import Any

from rcp_mavlink_sim.files import Files
from rcp_mavlink_sim.mount import Mount, quaternion
from rcp_mavlink_sim.options import Box
from rcp_mavlink_sim.state import VehicleState
from rcp_mavlink_sim.wire import mav

__all__ = ["HEIGHT", "WIDTH", "Camera"]

WIDTH, HEIGHT = 240, 180  # px
_FOCUS = WIDTH / 2 / math.tan(math.radians(35))  # px, 70 degrees wide
_EYE = 0.3  # m above the ground when landed
_NEAR = 0.05  # m in front of the camera
_FAR = 120.0  # m: ground farther away is haze
_LINE = 0.12  # m, the lines of the ground, every 5 m

_SKY, _HAZE, _FIELD, _LINES, _TOP, _ACROSS, _ALONG = 0, 1, 2, 4, 5, 6, 7
_PALETTE = bytes(
    (
        *(140, 180, 220),
        *(150, 165, 150),
        *(92, 120, 70),  # the ground: squares of 1 m in two shades
        *(80, 106, 60),
        *(176, 176, 150),
        *(226, 160, 84),  # boxes: the top, and the sides in two shades
        *(186, 120, 52),
        *(150, 94, 40),
    )
)
Vector = tuple[float, float, float]


class Camera:
    """Takes pictures in the direction of the mount and stores them on board."""

    def __init__(self, vehicle: VehicleState, files: Files) -> None:
        self._vehicle, self._files = vehicle, files
        self.zoom = self.focus = 0.0
        """In percent."""
        self.recording_since: float | None = None
        """Simulated time at which the video began; None if it records none."""

    def capture(self, mount: Mount, *, captured: bool) -> None:
        """Take a picture and report it to everybody, also by CAMERA_IMAGE_CAPTURED if `captured`."""
        v = self._vehicle
        path = self._files.store_picture(mount.photos + 1, self.picture(mount))
        if captured:
            lat, lon = (round(angle * 1e7) for angle in v.geographic())
            above = round(-v.body.d * 1000)
            v.broadcast(
                mav.MAVLink_camera_image_captured_message(
                    round(v.time * 1000), 0, 0, lat, lon, round(v.origin[2] * 1000) + above, above,
                    quaternion(*self._direction(mount)), mount.photos + 1, 1, f"mftp:///{path}".encode(),
                )
            )  # fmt: skip
        mount.shoot()

    def picture(self, mount: Mount) -> bytes:
        """Return what it sees now, as a PNG file."""
        view = _View(self._vehicle, *self._direction(mount))
        rows = [bytearray(row) for row in view.ground()]
        there = [(self._vehicle.place_of(one.latitude, one.longitude), one) for one in self._boxes]
        for place, box in sorted(there, key=lambda one: -math.dist(one[0], view.eye[:2])):
            for colour, corners in view.sides(place, box):
                _fill(rows, view.projected(corners), colour)
        return _png(rows)

    @property
    def _boxes(self) -> tuple[Box, ...]:
        return self._vehicle.options.boxes

    def _direction(self, mount: Mount) -> Vector:
        """Return roll, pitch and yaw in the world, rad; the mount levels roll and pitch."""
        yaw = self._vehicle.body.yaw + math.radians(mount.yaw)
        return math.radians(mount.roll), math.radians(mount.pitch), yaw


class _View:
    """A pinhole camera in the world: north, east, down."""

    def __init__(self, vehicle: VehicleState, roll: float, pitch: float, yaw: float) -> None:
        body = vehicle.body
        self.eye: Vector = (body.n, body.e, min(body.d, 0.0) - _EYE)
        cp, sp, cy, sy = math.cos(pitch), math.sin(pitch), math.cos(yaw), math.sin(yaw)
        right, down = (-sy, cy, 0.0), (sp * cy, sp * sy, cp)
        cr, sr = math.cos(roll), math.sin(roll)
        self._ahead: Vector = (cp * cy, cp * sy, -sp)
        self._right = _sum(right, cr, down, sr)
        self._down = _sum(down, cr, right, -sr)

    def ground(self) -> Iterator[list[int]]:
        """Draw the ground and the sky, row by row from the top."""
        north, east, height = self.eye[0], self.eye[1], -self.eye[2]
        (an, ae, ad), (rn, re, rd), (dn, de, dd) = self._ahead, self._right, self._down
        columns = [column - WIDTH / 2 + 0.5 for column in range(WIDTH)]
        for number in range(HEIGHT):
            v = number - HEIGHT / 2 + 0.5
            n0, e0, d0 = an * _FOCUS + dn * v, ae * _FOCUS + de * v, ad * _FOCUS + dd * v
            row: list[int] = []
            for u in columns:
                steep = d0 + rd * u
                if steep <= 0:
                    row.append(_SKY)
                    continue
                far = height / steep
                if far * _FOCUS > _FAR:
                    row.append(_HAZE)
                    continue
                n, e = north + far * (n0 + rn * u), east + far * (e0 + re * u)
                line = n % 5 < _LINE or e % 5 < _LINE
                row.append(_LINES if line else _FIELD + ((n // 1 + e // 1) % 2 > 0))
            yield row

    def sides(
        self, place: tuple[float, float], box: Box
    ) -> Iterator[tuple[int, tuple[Vector, ...]]]:
        """Iterate over the sides of a box that face the camera: colour and corners."""
        half, top = box.side / 2, -box.height
        north, east, _ = self.eye
        low, high = place[0] - half, place[0] + half
        left, right = place[1] - half, place[1] + half
        if self.eye[2] < top:
            yield _TOP, ((low, left, top), (low, right, top), (high, right, top), (high, left, top))
        for at, shown in ((low, north < low), (high, north > high)):
            if shown:
                yield _ACROSS, ((at, left, 0), (at, right, 0), (at, right, top), (at, left, top))
        for at, shown in ((left, east < left), (right, east > right)):
            if shown:
                yield _ALONG, ((low, at, 0), (high, at, 0), (high, at, top), (low, at, top))

    def projected(self, corners: tuple[Vector, ...]) -> list[tuple[float, float]]:
        """Project a face; what is behind the camera is cut off."""
        seen = [self._seen(corner) for corner in corners]
        shape: list[Vector] = []
        for a, b in zip(seen, [*seen[1:], seen[0]], strict=True):
            if a[2] >= _NEAR:
                shape.append(a)
            if (a[2] < _NEAR) != (b[2] < _NEAR):
                part = (_NEAR - a[2]) / (b[2] - a[2])
                shape.append(_sum(a, 1 - part, b, part))
        return [(WIDTH / 2 + _FOCUS * x / z, HEIGHT / 2 + _FOCUS * y / z) for x, y, z in shape]

    def _seen(self, point: Vector) -> Vector:
        away = _sum(point, 1.0, self.eye, -1.0)
        return tuple(  # type: ignore[return-value]  # right, down, ahead
            sum(a * b for a, b in zip(away, axis, strict=True))
            for axis in (self._right, self._down, self._ahead)
        )


def _sum(a: Vector, by: float, b: Vector, and_by: float) -> Vector:
    return (a[0] * by + b[0] * and_by, a[1] * by + b[1] * and_by, a[2] * by + b[2] * and_by)


def _fill(rows: list[bytearray], shape: list[tuple[float, float]], colour: int) -> None:
    """Fill a convex polygon: each row from its leftmost to its rightmost edge."""
    if not shape:
        return
    first = max(0, math.ceil(min(y for _, y in shape) - 0.5))
    last = min(HEIGHT - 1, math.floor(max(y for _, y in shape) - 0.5))
    for number in range(first, last + 1):
        y = number + 0.5
        crossed = [
            x0 + (y - y0) * (x1 - x0) / (y1 - y0)
            for (x0, y0), (x1, y1) in zip(shape, [*shape[1:], shape[0]], strict=True)
            if (y0 <= y) != (y1 <= y)
        ]
        if crossed:
            start = max(0, math.ceil(min(crossed) - 0.5))
            stop = min(WIDTH, math.ceil(max(crossed) - 0.5))
            if start < stop:
                rows[number][start:stop] = bytes((colour,)) * (stop - start)


def _png(rows: list[bytearray]) -> bytes:
    head = struct.pack(">IIBBBBB", WIDTH, HEIGHT, 8, 3, 0, 0, 0)
    data = zlib.compress(b"".join(b"\0" + row for row in rows))
    parts: tuple[tuple[bytes, Any], ...] = (
        (b"IHDR", head), (b"PLTE", _PALETTE), (b"IDAT", data), (b"IEND", b""),
    )  # fmt: skip
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in parts
    )
