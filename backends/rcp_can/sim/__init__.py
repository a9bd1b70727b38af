"""Simulated drives on a bus, for the demo, for tests, and for anybody's bench without a gateway."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from rcp_can.profiles import profile
from rcp_can.sim.plant import Plant
from rcp_can.sim.twin import Bench, Twin

__all__ = ["Bench", "Plant", "Twin", "make_twin"]


def make_twin(name: str, node: int, plant: Plant | None = None, **options: Any) -> Twin:
    """Make the twin of a profile by its name; options are the profile's and the twin's own."""
    module, _, attribute = profile(name).twin.partition(":")
    return getattr(import_module(module), attribute)(node, plant, **options)
