"""Long answers in pages: their limits, their cursors, and the parts that are written one by one."""

from __future__ import annotations

from rcp_requests.object_list import EncodedBody, ObjectList
from rcp_requests.pages import LONGEST, MOST, cursor_of, place_of, room

__all__ = ["LONGEST", "MOST", "EncodedBody", "ObjectList", "cursor_of", "place_of", "room"]
