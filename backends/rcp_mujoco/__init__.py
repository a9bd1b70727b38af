"""Robots in MuJoCo: any MJCF or URDF, in real time, faster, or step by step.

Importing this costs nothing; MuJoCo is imported when a backend is opened.
"""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager

from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.spi import Backend, BackendKind, Host
from rcp_mujoco.config import MujocoConfig
from rcp_mujoco.robots import model_path

__all__ = ["MujocoConfig", "open_mujoco", "rcp_backends"]


@asynccontextmanager
async def open_mujoco(config: MujocoConfig, host: Host) -> AsyncGenerator[Backend]:
    """Simulate a robot while entered.

    :raises ConfigError: the model does not load, or lacks a part.
    """
    import asyncio
    import importlib

    from rcp_mujoco.opengl import choose_opengl

    choose_opengl()
    await asyncio.to_thread(importlib.import_module, "rcp_mujoco.backend")
    from rcp_mujoco.backend import open_robot

    async with open_robot(config, host) as backend:
        yield backend


def _lacks(config: MujocoConfig) -> str | None:
    if (path := model_path(config)).is_file():
        return None
    return f"`model`: there is no file '{path}': write its path, or `rover` or `arm`"


@hookimpl
def rcp_backends() -> Iterable[BackendKind]:
    """Offer simulated robots."""
    text = "Robots in the MuJoCo simulator."
    needs, wants = ("mujoco", "numpy"), ("OpenGL",)  # which draws cameras
    kind = BackendKind("mujoco", MujocoConfig, open_mujoco, text, needs, wants=wants, lacks=_lacks)
    return [kind]
