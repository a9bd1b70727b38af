"""The wire requirements as data: the guarantees of the protocol, and the tests that prove them."""

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
    """What a transport must support for the requirement to apply to it."""
    gap: str | None = None
    """Why the gateway does not keep the promise yet."""


def _load() -> dict[str, Requirement]:
    text = files("rcp_gateway.testing.wire").joinpath("requirements.toml").read_text("utf-8")
    groups = msgspec.convert(tomllib.loads(text), dict[str, dict[str, Requirement]])
    return {f"{g}.{key}": found for g, group in groups.items() for key, found in group.items()}


REQUIREMENTS: dict[str, Requirement] = _load()
"""Every requirement by its id, `<theme>.<promise>`."""
