"""The configuration of `[features.triggers]`."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Mapping
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.config.identity import Granting, check_grants
from rcp_kernel.config.role import BUILTIN_ROLES
from rcp_kernel.errors import ConfigError
from rcp_triggers.spec import NAME, Conditions, Spec

__all__ = [
    "Mail",
    "Ntfy",
    "Rule",
    "RunAs",
    "Target",
    "TriggersConfig",
    "Webhook",
    "check",
    "secret_of",
]

_Name = Annotated[str, Meta(pattern=NAME, max_length=64)]
_Url = Annotated[str, Meta(pattern="^https?://[^/@]+(/.*)?$", max_length=2048)]
_Timeout = Annotated[float, Meta(gt=0, le=120)]
_SHORTEST = 24  # bytes of a secret: Standard Webhooks
_Address = Annotated[str, Meta(pattern="^[^@\\s,<>]+@[^@\\s,<>]+$", max_length=254)]


class _Target(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="kind"
):
    """Where notifications go."""

    tenants: tuple[str, ...] = ("*",)
    """The tenants whose triggers may use it."""
    timeout: _Timeout = 10.0
    """Longest time of one attempt, in s."""
    ca: str | None = None
    """PEM file of certificates to trust besides those of the system."""


class Webhook(_Target, frozen=True, kw_only=True, tag="webhook"):
    """An HTTP receiver of signed messages, by Standard Webhooks."""

    url: _Url
    secret: str
    """The HMAC key, in base64, with or without `whsec_`."""
    headers: dict[str, str] = {}


class Ntfy(_Target, frozen=True, kw_only=True, tag="ntfy"):
    """A topic of an ntfy server."""

    url: Annotated[str, Meta(pattern="^https?://[^/@]+/[A-Za-z0-9_-]{1,64}$")]
    """Server and topic: `https://ntfy.sh/my-topic`."""
    token: str | None = None


class Mail(_Target, frozen=True, kw_only=True, tag="smtp"):
    """E-mail by an SMTP server."""

    host: Annotated[str, Meta(min_length=1)]
    port: Annotated[int, Meta(ge=1, le=65_535)] = 587
    tls: Literal["starttls", "tls", "none"] = "starttls"
    user: str | None = None
    password: str | None = None
    sender: _Address
    to: Annotated[tuple[_Address, ...], Meta(min_length=1, max_length=100)]


Target = Webhook | Ntfy | Mail


class RunAs(Granting, frozen=True):
    """The roles with which the command of a configured trigger is run."""


class Rule(Spec, frozen=True, kw_only=True):
    """A trigger of the configuration."""

    run_as: RunAs | None = None


class TriggersConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Targets, triggers, and limits."""

    targets: dict[_Name, Target] = {}
    rules: dict[_Name, Rule] = {}
    most: Annotated[int, Meta(ge=0, le=10_000)] = 50
    """Triggers that one principal may make at run time."""
    per_minute: Annotated[float, Meta(gt=0, le=600)] = 10.0
    """Firings of one trigger for one robot; more are suppressed, and told."""
    keep: Annotated[float, Meta(ge=60, le=2_592_000)] = 86_400.0
    """How long the delivery of a notification is tried, in s."""
    queue: Annotated[int, Meta(ge=1, le=1_000_000)] = 10_000
    """Notifications that may wait for one target; the oldest are dropped."""


def check(table: TriggersConfig, gateway: GatewayConfig) -> None:
    """Check targets and triggers against the rest of the configuration.

    :raises ConfigError: something does not fit.
    """
    for name, target in table.targets.items():
        where = f"[features.triggers.targets.{name}]"
        for tenant in target.tenants:
            if tenant != "*" and tenant not in gateway.tenant_names:
                raise ConfigError(f"{where}: there is no tenant '{tenant}'")
        if isinstance(target, Webhook):
            try:
                secret_of(target)
            except ValueError as error:
                raise ConfigError(f"{where}: {error}") from None
    for name, rule in table.rules.items():
        where = f"[features.triggers.rules.{name}]"
        try:
            tenant = Conditions(rule).robots.tenant
            _check_rule(rule, tenant, table.targets, gateway)
        except ConfigError as error:
            raise ConfigError(f"{where}: {error}") from None


def _check_rule(
    rule: Rule, tenant: str, targets: Mapping[str, Target], gateway: GatewayConfig
) -> None:
    if tenant != "*" and tenant not in gateway.tenant_names:
        raise ConfigError(f"robot: there is no tenant '{tenant}'")
    for name in rule.notify:
        target = targets.get(name)
        if target is None:
            known = ", ".join(targets) or "none"
            raise ConfigError(f"notify: there is no target '{name}'; known: {known}")
        if "*" not in target.tenants and tenant not in target.tenants:
            raise ConfigError(f"notify: the target '{name}' is not for all of its tenants")
    if rule.incident and not _has_black_box(gateway):
        raise ConfigError(
            "incident: there is no black box to write; add [features.recorder.black_box]"
        )
    if rule.execute is not None and rule.run_as is None:
        raise ConfigError('execute needs a role: run_as = { role = "operator" }')
    if rule.run_as is not None:
        if rule.execute is None:
            raise ConfigError("run_as is for `execute`")
        if not rule.run_as.roles and rule.run_as.role is None:
            raise ConfigError("run_as needs a `role`, or `roles` by tenant")
        roles = {**BUILTIN_ROLES, **gateway.roles}
        check_grants(rule.run_as.grants, "run_as", gateway.tenant_names, roles)


def _has_black_box(gateway: GatewayConfig) -> bool:
    table = gateway.active_features.get("recorder")
    return table is not None and "black_box" in table


def secret_of(target: Webhook) -> bytes:
    """Return the key of a webhook.

    :raises ValueError: it is not in base64, or too short.
    """
    try:
        key = base64.b64decode(target.secret.removeprefix("whsec_"), validate=True)
    except binascii.Error:
        key = b""
    if len(key) < _SHORTEST:
        raise ValueError(
            f"secret must be base64 of {_SHORTEST} random bytes or more, as `openssl rand -base64 "
            "32` prints it"
        )
    return key
