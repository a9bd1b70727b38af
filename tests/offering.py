"""What is installed, as far as a gateway can see: other plugins than those of the environment."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.metadata import EntryPoint, EntryPoints, entry_points

import pytest

from rcp_gateway import plugins

__all__ = ["offer", "withhold"]


def offer(monkeypatch: pytest.MonkeyPatch, points: Iterable[EntryPoint]) -> None:
    """Have these entry points, and no others."""
    monkeypatch.setattr(plugins, "entry_points", EntryPoints(points).select)


def withhold(monkeypatch: pytest.MonkeyPatch, group: str, name: str) -> None:
    """Have all that are installed but one."""
    known = [one for each in plugins.GROUPS.values() for one in entry_points(group=each)]
    offer(monkeypatch, [one for one in known if (one.group, one.name) != (group, name)])
