"""Validation of `[roles.<name>]`."""

from __future__ import annotations

from rcp_conditions import ConditionTooCostly, condition
from rcp_kernel.config.role import Role, Rule
from rcp_kernel.errors import ConfigError, InvalidPath
from rcp_kernel.model import Pattern

__all__ = ["check_pattern", "check_roles"]


def check_roles(roles: dict[str, Role], source: str) -> None:
    """Refuse rules for no path, and conditions that are none.

    :raises ConfigError: with the file, the role and the rule.
    """
    for name, role in roles.items():
        for kind, rules in (("allow", role.allow), ("deny", role.deny)):
            for place, rule in enumerate(rules):
                _check(rule, f"{source}: [roles.{name}] {kind}[{place}]", deny=kind == "deny")
        for path in role.approve:
            where = f"{source}: [roles.{name}] approve"
            check_pattern(path, where)
            if path.startswith("/system/"):
                raise ConfigError(
                    f"{where} names {path}: operations of the gateway itself need no approval; "
                    "name "
                    "paths of robots (a plan is approved for its steps on those paths)"
                )


def _check(rule: Rule, where: str, *, deny: bool) -> None:
    for path in rule.paths:
        check_pattern(path, where)
    if rule.when is None:
        return
    try:
        condition(rule.when)
    except ConditionTooCostly as error:
        raise ConfigError(f"{where} when: {error}. {error.remedy}") from None
    except ConfigError as error:
        raise ConfigError(f"{where} when: {error}") from None
    if deny and "discover" in rule.operations:
        raise ConfigError(
            f"{where} denies `discover` with a `when`: visibility must not change with the "
            "state; remove `when`, or deny other operations (`*` is all except discover)"
        )


def check_pattern(path: str, where: str) -> None:
    """Check a pattern.

    :raises ConfigError: it is not valid.
    """
    try:
        if not path.startswith("/"):
            raise InvalidPath(f"{path!r} does not begin with '/'")
        Pattern(path)
    except InvalidPath as error:
        raise ConfigError(f"{where} has a rule with an invalid path: {error.message}") from None
