"""The dialect that the twin speaks, as a module whose generated types nobody has to satisfy."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega

__all__ = ["mav"]

mav: Any = ardupilotmega
