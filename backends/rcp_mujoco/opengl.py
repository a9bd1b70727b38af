"""Which OpenGL MuJoCo draws with; decided before MuJoCo is imported, which looks it up then."""

from __future__ import annotations

import ctypes.util
import os
import sys

__all__ = ["choose_opengl"]


def choose_opengl() -> None:
    """Have MuJoCo draw without a display, unless the environment says how."""
    if not sys.platform.startswith("linux") or os.environ.get("MUJOCO_GL"):
        return
    # Without either it is EGL too: MuJoCo then says what is missing.
    osmesa = not ctypes.util.find_library("EGL") and ctypes.util.find_library("OSMesa")
    os.environ["MUJOCO_GL"] = "osmesa" if osmesa else "egl"
