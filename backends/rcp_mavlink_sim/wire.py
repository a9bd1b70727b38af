"""The dialect of the simulated vehicle, untyped: pymavlink's generated types are inexact."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega

__all__ = ["mav"]

mav: Any = ardupilotmega
