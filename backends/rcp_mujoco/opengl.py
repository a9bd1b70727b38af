"""Selection of MuJoCo's OpenGL implementation, which must precede the import of MuJoCo."""

from __future__ import annotations

import ctypes.util
import os
import sys

__all__ = ["choose_opengl"]


def choose_opengl() -> None:
    """Select off-screen rendering, unless the environment selects something else."""
    if not sys.platform.startswith("linux") or os.environ.get("MUJOCO_GL"):
        return
    # Without either, EGL too: MuJoCo then reports what is missing.
    osmesa = not ctypes.util.find_library("EGL") and ctypes.util.find_library("OSMesa")
    os.environ["MUJOCO_GL"] = "osmesa" if osmesa else "egl"
