"""What a robot senses, condensed for a model: obstacles by sector, maps and images as pictures."""

from __future__ import annotations

from typing import Any

from rcp_mcp.clouds import is_cloud, obstacles
from rcp_mcp.maps import is_grid, pictured
from rcp_mcp.pictures import Picture, View, taken_out
from rcp_mcp.scans import is_scan, sectors

__all__ = ["condensed", "needs_pose"]


def needs_pose(plain: Any) -> bool:
    """Return whether a value means little without where the robot was."""
    return is_scan(plain) or is_grid(plain) or (isinstance(plain, dict) and "data" in plain)


def condensed(
    plain: Any, view: View, pose: dict[str, Any] | None = None
) -> tuple[Any, list[Picture], bool]:
    """Return a value for a model, its pictures, and whether nothing but pictures was taken out."""
    if is_scan(plain):
        return sectors(plain), [], False
    if is_cloud(plain) and (near := obstacles(plain)) is not None:
        return near, [], False
    if is_grid(plain):
        frame = plain.get("frame_id") or (plain.get("header") or {}).get("frame_id")
        here = pose if pose is not None and pose.get("frame") == frame else None
        if (found := pictured(plain, view, here)) is not None:
            facts, picture = found
            return {**facts, "data": picture.words}, [picture], False
    rest, pictures = taken_out(plain, view)
    return rest, pictures, True
