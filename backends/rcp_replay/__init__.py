"""Replay: plays a recording through the tree, at any speed; nothing can be commanded."""

from __future__ import annotations

from collections.abc import Iterable

from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.spi import BackendKind
from rcp_replay.config import ReplayConfig, lacking
from rcp_replay.messages import ReplayRequest, ReplayState

__all__ = ["ReplayConfig", "ReplayRequest", "ReplayState", "rcp_backends"]


def _open(config: ReplayConfig, host: object) -> object:
    from rcp_replay.backend import open_replay

    return open_replay(config, host)  # pyright: ignore[reportArgumentType]


@hookimpl
def rcp_backends() -> Iterable[BackendKind]:
    """Offer replay."""
    description = "A recording, played through the tree."
    needs = ("mcap", "mcap_ros2", "zstandard")
    kind = BackendKind("replay", ReplayConfig, _open, description, needs, lacks=lacking)  # pyright: ignore[reportArgumentType]
    return [kind]
