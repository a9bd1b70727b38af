"""Where a robot was when it sensed something."""

from __future__ import annotations

import math
from typing import Any

from rcp_gateway.api import Session
from rcp_gateway.client_api import ClientApi
from rcp_kernel.wire import Request
from rcp_mcp.answers import body_of
from rcp_mcp.catalogue import Catalogue
from rcp_protocol.plain import is_map

__all__ = ["Poses"]


class Poses:
    """Finds the pose of the robot that a resource belongs to."""

    def __init__(self, client_api: ClientApi, catalogue: Catalogue) -> None:
        self._client_api = client_api
        self._catalogue = catalogue

    async def of(self, session: Session, path: str) -> dict[str, Any] | None:
        """Return the latest pose of the robot with a resource; None if the caller sees none."""
        parts = path.split("/")
        if parts[1] != "tenant":
            return None
        for end in range(len(parts) - 1, 3, -1):
            pose = "/".join((*parts[:3], "sensor", *parts[4:end], "pose"))
            if self._catalogue.find(session, pose) is not None:
                return await self._read(session, pose)
        return None

    async def _read(self, session: Session, path: str) -> dict[str, Any] | None:
        reply = await self._client_api.request(session, Request(type="read", path=path))
        body = None if reply.error is not None else body_of(reply)
        if not is_map(body):
            return None
        pose = body.get("pose", body)
        at, turned = pose.get("position"), pose.get("orientation")
        if not is_map(at) or not all(isinstance(at.get(one), (int, float)) for one in "xy"):
            return None
        found: dict[str, Any] = {name: round(at[name], 2) for name in "xyz" if at.get(name)}
        found = {"x": round(at["x"], 2), "y": round(at["y"], 2), **found}
        if is_map(turned):
            x, y, z, w = (float(turned.get(one) or 0) for one in "xyzw")
            found["yaw"] = round(math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)), 2)
        frame = body.get("frame_id") or (body.get("header") or {}).get("frame_id")
        return {**found, "frame": frame, "timestamp": reply.source_timestamp}
