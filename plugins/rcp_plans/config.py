"""`[plans]`: limits of plans, and the actions and objects of symbolic plans."""

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
    """The meaning of one action of symbolic plans; `{0}`, `{1}`… stand for its arguments."""

    path: Annotated[str, Meta(pattern="^/", max_length=512)]
    do: Literal["execute", "write", "read"] = "execute"
    value: Any = None
    """A string that consists of `{1}` becomes the argument: an object of the table, a number or a
    string. `{1.x}` is a field of an object."""
    deadline: Annotated[float, Meta(gt=0, le=86_400)] | None = None
    """Deadline of each such step, s."""


class PlansConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Limits of plans, and the tables for symbolic plans."""

    steps: Annotated[int, Meta(ge=1, le=10_000)] = 200
    """Maximum number of steps in a plan, including nested steps and fallbacks."""
    depth: Annotated[int, Meta(ge=1, le=16)] = 8
    """Maximum nesting of steps."""
    size: Annotated[int, Meta(ge=1024)] = 262_144
    """Maximum size of a plan, bytes."""
    running: Annotated[int, Meta(ge=1)] = 32
    """Maximum number of running plans per tenant."""
    actions: dict[str, ActionTable] = {}
    objects: dict[str, Any] = {}
    """Values by the names that symbolic plans use."""


class PlansTable(msgspec.Struct, frozen=True, kw_only=True):
    """The table with its name, so that errors report their location."""

    plans: PlansConfig = PlansConfig()


def check_plans(config: PlansConfig) -> None:
    """Check that every action can be executed.

    :raises ConfigError: an action is invalid; names its table.
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
