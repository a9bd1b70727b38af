"""`[[envelopes]]`: limits of commands, by path and role."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated

import msgspec
from msgspec import Meta

from rcp_conditions import ConditionTooCostly, condition
from rcp_geometry import Corner, Polygon
from rcp_kernel.config.role import Role
from rcp_kernel.errors import ConfigError, InvalidPath
from rcp_kernel.model import BRANCHES, Kind, Operation, Pattern, kind_of
from rcp_protocol.similarity import closest

__all__ = [
    "Bound",
    "EnvelopeConfig",
    "Fence",
    "MotionLimitsConfig",
    "check_envelopes",
    "patterns",
]

_COMMANDED = [
    kind.value
    for kind, offered in BRANCHES.items()
    if offered & (Operation.WRITE | Operation.EXECUTE)
]
_Corners = Annotated[tuple[Corner, ...], Meta(max_length=256)]


class Bound(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The allowed values of one field."""

    min: float | None = None
    """Minimum, in the field's unit."""
    max: float | None = None
    """Maximum, in the field's unit."""
    allow: tuple[bool | int | float | str, ...] = ()
    """The only allowed values, instead of `min` and `max`."""
    optional: bool = False
    """Whether the field may be omitted, so that the robot chooses."""


class Fence(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Areas in a plane; their boundaries belong to them."""

    inside: dict[str, _Corners] = {}
    """Areas by name: the point must be in one of them."""
    outside: dict[str, _Corners] = {}
    """Areas by name: the point must be in none of them."""
    point: tuple[str, str] = ("position.x", "position.y")
    """The two fields that contain the position."""
    of: str | None = None
    """The sensor with the robot's position (`sensor/pose`); by default the command's own fields."""
    max_age: Annotated[float, Meta(gt=0)] = 1.0
    """Age in s beyond which the sensor's value counts as unknown."""


class EnvelopeConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Limits of commands for some paths and roles."""

    name: Annotated[str, Meta(min_length=1, max_length=100)]
    """Shown to clients."""
    paths: Annotated[tuple[str, ...], Meta(min_length=1)]
    """Patterns; without `/tenant/` they apply in every tenant."""
    roles: tuple[str, ...] = ()
    """Applies to principals with one of these roles in the tenant. Empty: to everyone."""
    bounds: dict[str, Bound] = {}
    """Bounds by field."""
    rate: dict[str, Annotated[float, Meta(gt=0)]] = {}
    """Maximum change per second, by field."""
    fence: Fence | None = None
    when: str | None = None
    """A condition on the robot's state, in CEL."""
    modes: tuple[str, ...] = ()
    """Allowed values of `sensor/mode`."""
    reason: Annotated[str, Meta(max_length=500)] | None = None
    """Shown to clients."""


class MotionLimitsConfig(msgspec.Struct, frozen=True, kw_only=True):
    """All `[[envelopes]]` tables."""

    envelopes: tuple[EnvelopeConfig, ...] = ()


def patterns(paths: Iterable[str]) -> list[Pattern]:
    """Parse the patterns of a table; one without a tenant applies in all tenants.

    :raises InvalidPath: a pattern is invalid, or matches no branch that accepts commands.
    """
    return [_pattern(text) for text in paths]


def _pattern(text: str) -> Pattern:
    if not text.startswith("/"):
        raise InvalidPath(f"{text!r} does not begin with '/'")
    steps = text[1:].split("/")
    if steps[0] == "tenant":
        steps = steps[2:]
    branch = steps[0] if steps else ""
    if branch not in (*_COMMANDED, "*", "**"):
        near = closest(branch, _COMMANDED)
        advice = f"did you mean '{near}'?" if near else f"use one of {', '.join(_COMMANDED)}"
        raise InvalidPath(f"{text!r} matches no branch that takes commands; {advice}")
    return Pattern(text if text.startswith("/tenant/") else f"/tenant/*{text}")


def check_envelopes(
    tables: Sequence[EnvelopeConfig], roles: Mapping[str, Role], tenants: Sequence[str]
) -> None:
    """Check what decoding cannot.

    :raises ConfigError: names the table and the key.
    """
    names = [table.name for table in tables]
    for table in tables:
        where = f"[[envelopes]] '{table.name}'"
        if names.count(table.name) > 1:
            raise ConfigError(f"{where}: duplicate `name`")
        _check_reach(table, where, roles, tenants)
        _check_limits(table, where)


def _check_limits(table: EnvelopeConfig, where: str) -> None:
    if not (table.bounds or table.rate or table.fence or table.when or table.modes):
        raise ConfigError(
            f"{where} limits nothing: add `bounds`, `rate`, `fence`, `when` or `modes`"
        )
    for field, bound in table.bounds.items():
        _check_bound(bound, f"{where}: bounds.{_quoted(field)}")
    for field, most in table.rate.items():
        _check_finite(most, f"{where}: rate.{_quoted(field)}")
    if table.fence is not None:
        _check_fence(table.fence, f"{where}: fence")
    if table.when is not None:
        try:
            condition(table.when)
        except ConditionTooCostly as error:
            raise ConfigError(f"{where}: when: {error}. {error.remedy}") from None
        except ConfigError as error:
            raise ConfigError(f"{where}: when: {error}") from None


def _check_reach(
    table: EnvelopeConfig, where: str, roles: Mapping[str, Role], tenants: Sequence[str]
) -> None:
    for path in table.paths:
        try:
            _pattern(path)
        except InvalidPath as error:
            raise ConfigError(f"{where}: paths: {error.message}") from None
        tenant = path.split("/")[2] if path.startswith("/tenant/") else "*"
        if tenant not in ("*", "**", *tenants):
            raise ConfigError(f"{where}: paths: {path!r} refers to the unknown tenant '{tenant}'")
    for role in table.roles:
        if role not in roles:
            near = closest(role, roles)
            known = f"did you mean '{near}'?" if near else f"known roles: {', '.join(roles)}"
            raise ConfigError(f"{where}: roles: unknown role '{role}'; {known}")


def _check_bound(bound: Bound, where: str) -> None:
    if bound.allow:
        if bound.min is not None or bound.max is not None:
            raise ConfigError(f"{where} has both `allow` and `min` or `max`: use one or the other")
        return
    if bound.min is None and bound.max is None:
        raise ConfigError(f"{where} has no bound: add `min`, `max` or `allow`")
    for limit in (bound.min, bound.max):
        if limit is not None:
            _check_finite(limit, where)
    if bound.min is not None and bound.max is not None and bound.min > bound.max:
        raise ConfigError(f"{where}: `min` {bound.min:g} is greater than `max` {bound.max:g}")


def _check_finite(number: float, where: str) -> None:
    if not math.isfinite(number):
        raise ConfigError(f"{where}: {number} is not a finite number")


def _check_fence(fence: Fence, where: str) -> None:
    if not fence.inside and not fence.outside:
        raise ConfigError(f"{where} has no area: add `inside` or `outside`")
    for side, areas in (("inside", fence.inside), ("outside", fence.outside)):
        for name, corners in areas.items():
            try:
                Polygon(corners)
            except ValueError as error:
                raise ConfigError(f"{where}.{side}.{_quoted(name)} {error}") from None
    for field in fence.point:
        if "*" in field.split("."):
            raise ConfigError(f"{where}.point: '{field}' matches several fields; name one")
    both = fence.inside.keys() & fence.outside.keys()
    if both:
        raise ConfigError(f"{where} has '{min(both)}' in both `inside` and `outside`")
    if fence.of is not None:
        try:
            good = kind_of(fence.of) is Kind.SENSOR
        except InvalidPath:
            good = False
        if not good:
            raise ConfigError(f"{where}.of = '{fence.of}' is not a sensor: write 'sensor/<name>'")
    _check_finite(fence.max_age, f"{where}.max_age")


def _quoted(key: str) -> str:
    return key if key.isidentifier() else f'"{key}"'
