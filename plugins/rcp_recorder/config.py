"""The configuration of `[features.recorder]`."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.errors import ConfigError
from rcp_kernel.model import Pattern

__all__ = ["BlackBoxConfig", "RecorderConfig", "check"]


class BlackBoxConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What is kept in memory of each robot, and written when something happens to it."""

    paths: tuple[str, ...] = ("/tenant/**",)
    """Patterns of the resources to keep."""
    seconds: Annotated[float, Meta(gt=0, le=600)] = 30.0
    """How long before an incident."""
    mb: Annotated[float, Meta(gt=0, le=4096)] = 16.0
    """Memory for each robot; the oldest samples leave first."""
    after: Annotated[float, Meta(ge=0, le=600)] = 30.0
    """How long an incident is recorded, in s."""


class RecorderConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What is recorded, where, and for how long it is kept."""

    folder: Annotated[str, Meta(min_length=1)]
    """Where recordings are; it belongs to this gateway alone."""
    paths: tuple[str, ...] = ()
    """Patterns of the resources to record always."""
    roll_mb: Annotated[float, Meta(gt=0)] = 128.0
    """A file of this size is followed by another one."""
    roll_seconds: Annotated[float, Meta(gt=0)] = 3600.0
    """A file of this age is followed by another one."""
    keep_mb: Annotated[float, Meta(gt=0)] = 10_240.0
    """Space of all recordings, damaged ones too; the oldest are deleted first, pinned ones never."""
    free_mb: Annotated[float, Meta(ge=0)] = 256.0
    """Recording stops while less of the disk is free."""
    queue_mb: Annotated[float, Meta(gt=0, le=1e9)] = 32.0
    """Memory for what waits to be written; what does not fit is dropped and counted."""
    sample_kb: Annotated[float, Meta(gt=0)] = 1024.0
    """Longer samples are not recorded, but counted."""
    black_box: BlackBoxConfig | None = None
    """Incidents, if they are to be recorded."""


def check(table: RecorderConfig, _gateway: GatewayConfig) -> None:
    """Check the patterns.

    :raises ConfigError: one matches no resource of a robot, or is none.
    """
    kept = () if table.black_box is None else table.black_box.paths
    for text in (*table.paths, *kept):
        try:
            Pattern(text)
        except ValueError as error:
            raise ConfigError(f"[features.recorder] paths: {error}") from error
        if not text.startswith(("/tenant/", "/**")):
            raise ConfigError(
                f"[features.recorder] paths: {text!r} matches no robot; "
                "begin it with /tenant/<tenant>/ or /tenant/*/"
            )
