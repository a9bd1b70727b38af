"""`[plans]`: how large plans may be, and what the names of symbolic ones mean."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from rcp_kernel.errors import ConfigError, InvalidPath
from rcp_kernel.model import parse_path

__all__ = ["ARGUMENT", "ActionTable", "PlansConfig", "PlansTable", "check_plans"]

ARGUMENT = re.compile(r"\{(\d+)((?:\.\w+)*)\}")
"""`{1}`, or `{1.x}` for a field of an object."""


class ActionTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What one action of symbolic plans means; `{0}`, `{1}`… stand for its arguments."""

    path: Annotated[str, Meta(pattern="^/", max_length=512)]
    do: Literal["execute", "write", "read"] = "execute"
    value: Any = None
    """A text that is `{1}` as a whole becomes the argument: an object of the table, a number, a
    text. `{1.x}` is a field of an object."""
    deadline: Annotated[float, Meta(gt=0, le=86_400)] | None = None
    """Seconds for each such step."""


class PlansConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Bounds of plans, and the table of symbolic ones."""

    steps: Annotated[int, Meta(ge=1, le=10_000)] = 200
    """In one plan, those within others and in fallbacks included."""
    depth: Annotated[int, Meta(ge=1, le=16)] = 8
    """Steps within steps."""
    size: Annotated[int, Meta(ge=1024)] = 262_144
    """Bytes of a plan."""
    running: Annotated[int, Meta(ge=1)] = 32
    """Plans of one tenant at once."""
    actions: dict[str, ActionTable] = {}
    objects: dict[str, Any] = {}
    """Values by the names that symbolic plans use for them."""


class PlansTable(msgspec.Struct, frozen=True, kw_only=True):
    """The table under its name, so that what is wrong with it is told with its place."""

    plans: PlansConfig = PlansConfig()


def check_plans(config: PlansConfig) -> None:
    """Refuse actions that could never be carried out.

    :raises ConfigError: with the table.
    """
    for name, table in config.actions.items():
        where = f"[plans.actions.{name}]"
        if any(match[2] for match in ARGUMENT.finditer(table.path)):
            raise ConfigError(
                f"{where} path = {table.path!r}: a path cannot contain a field of an object"
            )
        try:
            parse_path(ARGUMENT.sub("x", table.path), "t")
        except InvalidPath as error:
            raise ConfigError(
                f"{where} path = {table.path!r} is not a path: {error.remedy} An argument is "
                f"{{0}}, {{1}}…"
            ) from None
        if table.do == "write" and table.value is None:
            raise ConfigError(f"{where} is a write and has no `value`")
