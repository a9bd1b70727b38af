"""MuJoCo's bindings: made in C++ without type information, so that all of them is `Any`."""

from __future__ import annotations

import importlib
from typing import Any

__all__ = ["mujoco"]

mujoco: Any = importlib.import_module("mujoco")
