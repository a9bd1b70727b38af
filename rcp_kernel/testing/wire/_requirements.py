"""The wire requirements as data: what the contract promises, and which tests prove it."""

from __future__ import annotations

import tomllib
from importlib.resources import files

import msgspec

__all__ = ["REQUIREMENTS", "Requirement"]


class Requirement(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One promise of the contract."""

    section: int
    """Of the contract."""
    text: str
    """The promise in one sentence."""
    needs: frozenset[str] = frozenset()
    """What a transport has to carry for the promise to apply to it."""
    gap: str | None = None
    """Why the gateway does not keep the promise yet."""


def _load() -> dict[str, Requirement]:
    text = files("rcp_kernel.testing.wire").joinpath("requirements.toml").read_text("utf-8")
    groups = msgspec.convert(tomllib.loads(text), dict[str, dict[str, Requirement]])
    return {f"{g}.{key}": found for g, group in groups.items() for key, found in group.items()}


REQUIREMENTS: dict[str, Requirement] = _load()
"""Every requirement by its id, `<theme>.<promise>`."""
