"""Frames on request: values and goals in the frames that clients name."""

from __future__ import annotations

from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager

from rcp_frames.config import FramesConfig, Origin, check
from rcp_frames.converter import Frames
from rcp_gateway.hookspecs import hookimpl
from rcp_kernel.features import Feature, FeatureHost, FeatureKind
from rcp_streams.frames import FRAMES

__all__ = ["FramesConfig", "Origin", "rcp_features"]


def _make(config: FramesConfig, host: FeatureHost) -> Feature:
    frames = Frames(config, host)

    @asynccontextmanager
    async def running() -> AsyncGenerator[None]:
        try:
            yield
        finally:
            frames.close()

    return Feature(services={FRAMES: frames}, reconfigure=frames.configure, running=running)


@hookimpl
def rcp_features() -> Iterable[FeatureKind]:
    """Offer frames."""
    return [FeatureKind("frames", FramesConfig, _make, __doc__ or "", check=check)]
