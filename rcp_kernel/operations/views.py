"""Resources that show each reader something else."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rcp_kernel.clients.session import Session

__all__ = ["Filter", "View"]

View = Callable[[Session], Any]
"""Makes the value of a resource for whoever asks."""

Filter = Callable[[Session, Any], Any]
"""Returns what a session may see of a sample, None for one that is hidden from it."""
