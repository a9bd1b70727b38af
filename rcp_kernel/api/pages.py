"""Long answers in pages: their limits, their cursors, and the parts that are written one by one."""

from __future__ import annotations

from rcp_kernel.requests.pages import LONGEST, MOST, cursor_of, place_of, room
from rcp_kernel.requests.parts import Parts, Written

__all__ = ["LONGEST", "MOST", "Parts", "Written", "cursor_of", "place_of", "room"]
