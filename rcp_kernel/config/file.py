"""The TOML configuration file, decoded strictly: errors name file, table and remedy.

Each plugin's table is decoded as the type that the plugin declares, so that no plugin parses.
`${NAME}` in a string is replaced from the environment, for secrets (`variables`); `include` adds files.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from rcp_kernel.config.features import active_features
from rcp_kernel.config.identity import (
    Anonymous,
    CertificateConfig,
    Granting,
    KeyConfig,
    check_grants,
    check_identity,
)
from rcp_kernel.config.limits import Limits
from rcp_kernel.config.role import BUILTIN_ROLES, Role, check_roles
from rcp_kernel.config.safety import Safety, check_groups
from rcp_kernel.errors import ConfigError
from rcp_kernel.model import Operation
from rcp_protocol.plain import is_list, is_map
from rcp_protocol.similarity import closest
from rcp_protocol.validation import fault_of
from rcp_toml.document import document
from rcp_toml.encoding import NotUtf8, decoded
from rcp_toml.includes import included, merge
from rcp_toml.numbers import unusable
from rcp_toml.variables import Secret, Withheld, is_dear, substituted

__all__ = [
    "KERNEL_KEYS",
    "TRANSPORTS",
    "Anonymous",
    "BackendConfig",
    "CertificateConfig",
    "GatewayConfig",
    "Granting",
    "KeyConfig",
    "Limits",
    "LogConfig",
    "StoreConfig",
    "TenantConfig",
    "decode_table",
    "load",
    "parse",
]

_Name = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_.-]+$", max_length=64)]


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base of the tables of the configuration: no unknown keys."""


class TenantConfig(Table, frozen=True):
    """A tenant; one that is named only in `[[backends]]` needs no table."""

    description: str = ""
    quota: dict[str, Any] | None = None
    """Quota of all its principals together: a table that the feature's own type decodes."""


class BackendConfig(Table, frozen=True):
    """One robot (or several) behind one plugin; further keys belong to the plugin."""

    use: str
    """Name of the plugin: `sim`, `ros2`, …"""
    name: _Name
    tenant: _Name
    robot: _Name | None = None
    """Adds the robot's name to its paths: `/tenant/<tenant>/sensor/<robot>/…`."""
    options: dict[str, Any] = {}
    """The keys that the plugin's own type decodes."""


class LogConfig(Table, frozen=True):
    """Logging: a console on a terminal, JSON lines otherwise."""

    level: Literal["debug", "info", "warning", "error"] = "info"
    format: Literal["auto", "console", "json"] = "auto"


class StoreConfig(Table, frozen=True):
    """The location of the store; without a path, everything is in memory only."""

    path: str | None = None


class GatewayConfig(Table, frozen=True):
    """The decoded configuration file."""

    include: tuple[str, ...] = ()
    """Further files, relative to the folder of this one; `*` stands for any part of a name."""
    name: str = "rcp-gateway"
    tenants: dict[_Name, TenantConfig] = {}
    backends: tuple[BackendConfig, ...] = ()
    transports: dict[str, dict[str, Any]] = {}
    plugins: dict[str, dict[str, Any]] = {}
    features: dict[_Name, bool | dict[str, Any]] = {}
    roles: dict[str, Role] = {}
    keys: tuple[KeyConfig, ...] = ()
    certificates: tuple[CertificateConfig, ...] = ()
    jwt: tuple[dict[str, Any], ...] = ()
    """The tables that the feature's own type decodes."""
    hubs: tuple[dict[str, Any], ...] = ()
    """As `jwt`."""
    anonymous: Anonymous = Anonymous()
    envelopes: tuple[dict[str, Any], ...] = ()
    """As `jwt`."""
    limits: Limits = Limits()
    safety: Safety = Safety()
    quotas: dict[str, Any] = {}
    """The table that the feature's own type decodes."""
    plans: dict[str, Any] = {}
    """The table that the feature's own type decodes."""
    log: LogConfig = LogConfig()
    store: StoreConfig = StoreConfig()
    audit: dict[str, Any] = {}
    """Decoded by the type of the feature, like `jwt`."""

    @property
    def active_features(self) -> dict[str, dict[str, Any] | None]:
        """The features to load, by name: those that are built in, and those with a table."""
        return active_features(self.features)

    @property
    def used_features(self) -> frozenset[str]:
        """The features that this configuration requires."""
        used = set(self.features) & set(self.active_features)
        if any(role.approve for role in self.roles.values()):
            used.add("approvals")
        if self.jwt:
            used.add("jwt")
        if self.hubs:
            used.add("hubs")
        if self.audit:
            used.add("audit")
        if self.plans:
            used.add("plans")
        if self.safety.lease_required:
            used.add("leases")
        if self.envelopes:
            used.add("motion_limits")
        owners = (*self.tenants.values(), *self.roles.values())
        if self.quotas or any(owner.quota is not None for owner in owners):
            used.add("quotas")
        return frozenset(used)

    @property
    def closed(self) -> bool:
        """Whether anonymous clients may do nothing: they have no role, or only roles that allow nothing."""
        return not self._allows(self.anonymous)

    @property
    def serves(self) -> bool:
        """Whether the kernel's own tables authenticate any principal with rights."""
        return any(self._allows(given) for given in (*self.keys, *self.certificates))

    def acts(self, roles: Iterable[str]) -> bool:
        """Return whether any of the roles allows writes or executes on a robot."""
        known = {**BUILTIN_ROLES, **self.roles}
        change = Operation.WRITE | Operation.EXECUTE
        rules = [rule for role in roles if role in known for rule in known[role].allow]
        return any(
            rule.mask & change and not all(path.startswith("/system/") for path in rule.paths)
            for rule in rules
        )

    @property
    def effective_roles(self) -> set[str]:
        """The roles that allow anything."""
        return {name for name, role in {**BUILTIN_ROLES, **self.roles}.items() if role.allow}

    def _allows(self, given: Granting) -> bool:
        held = {role for _, roles in given.grants for role in roles}
        return not held.isdisjoint(self.effective_roles)

    @property
    def tenant_names(self) -> list[str]:
        """Every tenant, those named only by a backend included, in order of appearance."""
        return list(dict.fromkeys([*self.tenants, *(b.tenant for b in self.backends)]))


def load(path: Path) -> GatewayConfig:
    """Read a configuration file.

    :raises ConfigError: it does not exist, is not TOML, or is invalid.
    """
    try:
        text = decoded(path.read_bytes())
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from None
    except NotUtf8 as error:
        raise ConfigError(f"{path}: {error}") from None
    return parse(text, str(path))


def parse(text: str, source: str, *, show_values: bool = True) -> GatewayConfig:
    """Read a configuration from text; `source` is named in errors, and values if allowed.

    :raises ConfigError: as `load` does.
    """
    literal = _plain if show_values else Withheld
    raw = _read(text, source, literal)
    try:
        for part in included(raw, source):
            merged = merge(raw, _read(part.text, part.source, literal), part.source)
            if merged.conflicts:
                at = ".".join(map(str, merged.conflicts[0]))
                raise ConfigError(f"{at} of {part.source} is set in another file too")
    except ConfigError as error:
        raise ConfigError(f"{source}: {error}") from None
    backends = raw.get("backends", [])
    if not is_list(backends):
        raise ConfigError(
            f"{source}: write [[backends]] with double brackets, one table for each robot"
        )
    raw["backends"] = [_split(table, i, source) for i, table in enumerate(backends)]
    _default_transports(raw)
    if raw.get("anonymous") is False:
        raw["anonymous"] = {"role": None}
    for group in ("transports", "plugins"):
        tables: Any = raw.get(group, {})
        if not is_map(tables) or not all(is_map(table) for table in tables.values()):
            raise ConfigError(f"{source}: [{group}] contains only tables: write [{group}.<name>]")
    config = decode_table(raw, GatewayConfig, f"{source}: ")
    _check(config, source)
    return config


def _read(text: str, source: str, literal: Callable[[str], str]) -> dict[str, Any]:
    """Read one file, with its variables replaced."""
    try:
        raw = document(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{source}: not TOML: {error}") from None
    return _with_secrets(raw, source, "", literal)


TRANSPORTS = ("http", "ws", "sse", "asgi")
"""The built-in transports, active unless set to false in `[transports]`."""


def _default_transports(raw: dict[str, Any]) -> None:
    """Add the built-in transports, except those set to false in `[transports]`."""
    tables = raw.setdefault("transports", {})
    if is_map(tables):
        for name in TRANSPORTS:
            tables.setdefault(name, {})
        raw["transports"] = {name: t for name, t in tables.items() if t is not False}


KERNEL_KEYS = ("use", "name", "tenant", "robot")
"""Of `[[backends]]`; the other keys are the plugin's."""


def _split(table: Any, place: int, source: str) -> dict[str, Any]:
    if not is_map(table):
        raise ConfigError(f"{source}: [[backends]] number {place + 1} is not a table")
    kept = {key: item for key, item in table.items() if key in KERNEL_KEYS}
    kept.setdefault("name", kept.get("use"))
    kept["options"] = {key: item for key, item in table.items() if key not in KERNEL_KEYS}
    return kept


def _plain(text: str) -> str:
    return text


def _with_secrets(node: Any, source: str, where: str, literal: Callable[[str], str]) -> Any:
    """Replace the variables in all strings; `literal` converts strings without any."""
    if is_map(node):
        return {
            k: _with_secrets(v, source, f"{where}.{k}" if where else k, literal)
            for k, v in node.items()
        }
    if is_list(node):
        return [
            _with_secrets(item, source, f"{where}[{i}]", literal) for i, item in enumerate(node)
        ]
    if not isinstance(node, str):
        if (why := unusable(node)) is not None:
            raise ConfigError(f"{source}: {where} {why}")
        return node

    try:
        text = substituted(node, Path(source).parent)
    except ConfigError as error:
        raise ConfigError(f"{source}: {where} {error}") from None
    return literal(node) if text is node else text


def decode_table(raw: Any, type_: type[Any], where: str) -> Any:
    """Decode a table by its type.

    :raises ConfigError: a key is unknown (with the nearest right one) or a value does not fit.
    """
    try:
        return msgspec.convert(raw, type_, strict=True)
    except msgspec.ValidationError as error:
        raise ConfigError(where + _explain(error, raw, type_)) from None


def _explain(error: msgspec.ValidationError, raw: Any, type_: type[Any]) -> str:
    fault = fault_of(error)
    at = fault.place.removeprefix(".")
    if fault.unknown is None:
        if not at or fault.in_key:
            return str(error)
        if "..." in at:  # below a key that msgspec does not name
            return f"{at}: {fault.what}"
        value = Withheld() if is_dear(at) else _follow(raw, at)
        return f"{at} = {_shown(value)}: {fault.what}"
    allowed = _keys_at(type_, at)
    near = closest(fault.unknown, allowed)
    place = f"[{at}] has" if at else "there is"
    advice = f"; did you mean `{near}`?" if near else ""
    return f"{place} an unknown key `{fault.unknown}`{advice} Allowed: {', '.join(allowed)}."


def _follow(raw: Any, at: str) -> Any:
    for step in re.findall(r"[^.\[\]]+", at):
        if is_map(raw):
            raw = raw.get(step)
        elif is_list(raw) and step.isdigit() and int(step) < len(raw):
            raw = raw[int(step)]
    return raw


def _shown(value: Any) -> str:
    if isinstance(value, Withheld):
        return "…"
    if isinstance(value, Secret):
        return "a value from the environment"
    if is_map(value) or is_list(value):
        return type(value).__name__
    return repr(value) if len(repr(value)) <= 60 else type(value).__name__


def _keys_at(type_: Any, at: str) -> list[str]:
    info: Any = msgspec.inspect.type_info(type_)
    for step in re.findall(r"\.{3}|[^.\[\]]+", at):
        info = _step(info, step)
    while isinstance(info, msgspec.inspect.Metadata):
        info = info.type
    if isinstance(info, msgspec.inspect.UnionType):
        info = next((t for t in info.types if hasattr(t, "fields")), info)
    return sorted(f.encode_name for f in getattr(info, "fields", ()) if f.encode_name != "options")


def _step(info: Any, step: str) -> Any:
    while isinstance(info, msgspec.inspect.Metadata):
        info = info.type
    if isinstance(info, msgspec.inspect.UnionType):
        info = next((t for t in info.types if hasattr(t, "fields")), info)
    if isinstance(info, msgspec.inspect.DictType):
        return info.value_type
    if hasattr(info, "item_type"):
        return info.item_type
    return next((f.type for f in getattr(info, "fields", ()) if f.encode_name == step), info)


def _check(config: GatewayConfig, source: str) -> None:
    names = [backend.name for backend in config.backends]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(
                f"{source}: two [[backends]] have the name '{name}': give each a unique `name`"
            )
    roles = {**BUILTIN_ROLES, **config.roles}
    found = check_identity(config.keys, config.certificates, source)
    for given, where in [*found, (config.anonymous, f"{source}: anonymous")]:
        check_grants(given.grants, where, config.tenant_names, roles)
    check_groups(config.safety.groups, names, config.tenant_names, source)
    check_roles(config.roles, source)
    off = sorted(name for name in config.used_features if config.features.get(name) is False)
    if off:
        raise ConfigError(
            f"{source}: [features] {off[0]} = false, but the configuration uses this feature"
        )
