"""Simulated drives on a CAN bus, for the demo, tests and bench use without a gateway."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from rcp_can.profiles import profile
from rcp_can.sim.plant import Plant
from rcp_can.sim.twin import Bench, Twin

__all__ = ["Bench", "Plant", "Twin", "make_twin"]


def make_twin(name: str, node: int, plant: Plant | None = None, **options: Any) -> Twin:
    """Create the twin of a profile; `options` are those of the profile and of the twin."""
    module, _, attribute = profile(name).twin.partition(":")
    return getattr(import_module(module), attribute)(node, plant, **options)
