"""Every fault of a configuration that the kernel can find, and what is left without them."""

from __future__ import annotations

import re
from collections.abc import Generator
from contextlib import contextmanager, suppress
from datetime import date, time
from pathlib import Path
from typing import Any

import msgspec

from rcp_kernel.config.file import KERNEL_KEYS, TRANSPORTS, BackendConfig, GatewayConfig
from rcp_kernel.config.identity import check_grants, check_identity
from rcp_kernel.config.role import BUILTIN_ROLES, Role, check_roles
from rcp_kernel.config.safety import check_groups
from rcp_kernel.contract.identity import fingerprint
from rcp_kernel.errors import ConfigError
from rcp_protocol.plain import is_list, is_map
from rcp_protocol.similarity import closest
from rcp_toml.includes import included, merge
from rcp_toml.numbers import unusable
from rcp_toml.positions import Place, line_of, positions
from rcp_toml.variables import NamedFile, Secret, files_of, is_dear, secrets_of, substituted
from rcpd.faults import FAULTY, Collector, Fault, place_in
from rcpd.syntax import read_toml

__all__ = ["Finding", "Survey"]

_TOP = GatewayConfig.__struct_fields__
_HEADER = re.compile(
    r"\A(: )?(\[[\w.-]+(\[\d+\])?\]:? )?((key|\[\[certificates\]\]) '[^']*':? |(allow|deny)\[0\] )?"
)
"""What messages of the start begin with, and findings have by themselves."""
_SHOWN = 60  # characters of a value in a message
_DEAR_LENGTH = 5  # characters of a secret that is not in a message by chance


class Finding(msgspec.Struct, frozen=True):
    """A fault as it is reported."""

    line: int
    table: str
    """Without brackets; an element of a list by its `name`. Empty: the top level."""
    key: str | None
    message: str
    file: str | None = None
    """An included file; none: the file itself."""

    def text(self, source: str) -> str:
        """Return it as one line."""
        table = f"[{self.table}] " if self.table else ""
        key = f"{self.key}: " if self.key else ""
        return f"{self.file or source}:{self.line}: {table}{key}{self.message}"


class Survey:
    """The reading of one text: plugins' tables are read by whoever knows their types."""

    def __init__(self, text: str, source: str, *, show_values: bool = True) -> None:
        self._source, self._show_values = source, show_values
        document = read_toml(text)
        self.readable = document.raw is not None
        """Whether more than the form could be read."""
        self.raw: dict[str, Any] = document.raw or {}
        self.collector = Collector(self._shown, _TOP)
        self.secrets = secrets_of(document.text, Path(source).parent)
        """What must not be shown of the file, and of those that it includes."""
        self._broken = bool(document.faults)
        self._lines = positions(document.text) if self.readable else {}
        self.secret_files: list[tuple[Place, NamedFile]] = []
        """The files that `${file:}` names, with the places of the strings that do."""
        self._files: dict[Place, str] = {}
        """The included files of nodes that are not of the file itself."""
        for line, message in document.faults:
            self.collector.add((), message, line=line)
        self._include()
        self._hidden = [one for one in self.secrets if _is_secret(one)]
        self.raw = self._resolved(self.raw, ())
        self.config = self._read()
        """What is left without the faults of the kernel's tables."""
        self._check()

    def _include(self) -> None:
        """Add the included files, each node with its file and line."""
        with self.checking(("include",)):
            for part in included(self.raw, self._source):
                document = read_toml(part.text)
                for line, message in document.faults:
                    self.collector.add((), message, line=line, file=part.source)
                self._broken = self._broken or bool(document.faults)
                if document.raw is None:
                    continue
                self.secrets += secrets_of(document.text, Path(part.source).parent)
                merged = merge(self.raw, document.raw, part.source)
                lines = positions(document.text)
                for place in merged.conflicts:
                    self.collector.add(
                        place,
                        "is set in another file too: remove one of the two",
                        line=line_of(place, lines),
                        file=part.source,
                    )
                for place, line in lines.items():
                    at = merged.place(place)
                    if at not in self._lines:
                        self._lines[at], self._files[at] = line, part.source

    @property
    def findings(self) -> list[Finding]:
        """The faults by line."""
        return self._found(self.collector.faults)

    @property
    def refusals(self) -> list[Finding]:
        """Those for which the gateway does not start, by line."""
        return self._found([one for one in self.collector.faults if not one.partial])

    def _found(self, faults: list[Fault]) -> list[Finding]:
        found = [
            Finding(
                one.line or line_of(one.place, self._lines),
                *self._named(one.place),
                self._without_secrets(one.message),
                one.file or self._file(one.place),
            )
            for one in faults
            if not self._is_consequence(one)
        ]
        return sorted(found, key=lambda one: (one.file or "", one.line))

    def finding(self, place: Place, message: str) -> Finding:
        """Return what is to be told of a place."""
        line = line_of(place, self._lines)
        return Finding(line, *self._named(place), message, self._file(place))

    def is_included(self, place: Place) -> bool:
        """Return whether a node is of an included file."""
        return self._file(place) is not None

    def _file(self, place: Place) -> str | None:
        """Return the included file of a node, or of the nearest one around it that has a line."""
        while place not in self._lines and place:
            place = place[:-1]
        return self._files.get(place)

    def _is_consequence(self, fault: Fault) -> bool:
        """Return whether something is missing only because of another fault."""
        if fault.missing is None:
            return False
        # What is missing may be in a line that could not be read.
        return self._broken or self.faulty((*fault.place, fault.missing))

    @contextmanager
    def checking(self, place: Place, node: Any = None, *, partial: bool = False) -> Generator[None]:
        """Note a `ConfigError` of a block as a fault of this place, or of a key that it names."""
        try:
            yield
        except ConfigError as error:
            message = _HEADER.sub("", str(error))
            self.collector.add(place_in(message, node, place), message, partial=partial)

    def line(self, place: Place) -> int:
        """Return the line of a place."""
        return line_of(place, self._lines)

    def _without_secrets(self, message: str) -> str:
        for secret in self._hidden:
            message = message.replace(secret, "…")
        return message

    def _named(self, place: Place) -> tuple[str, str | None]:
        """Return table and key of a place."""
        words: list[str] = []
        node: Any = self.raw
        table = 0
        for step in place:
            inner = _at(node, step)
            if isinstance(step, str):
                words.append(step if step.replace("-", "").isidentifier() else f'"{step}"')
            else:
                name = inner.get("name") if is_map(inner) else None
                if isinstance(name, str) and not isinstance(name, Secret):
                    words.append(name)
                else:
                    words[-1] += f"[{step}]"
            node = inner
            table = len(words) if is_map(node) else table
        return ".".join(words[:table]), ".".join(words[table:]) or None

    def _shown(self, place: Place, value: Any) -> str:
        key = next((step for step in reversed(place) if isinstance(step, str)), "")
        if value == "":
            given = isinstance(value, Secret)
            return "an empty text" + (", as a variable or file is empty," if given else "")
        if is_dear(key):
            return "the value"
        if isinstance(value, Secret):
            return "a value from the environment"
        if is_map(value):
            return "a table"
        if is_list(value):
            return "a list"
        if isinstance(value, bool):
            return "true" if value else "false"
        if isinstance(value, (date, time)):
            return f"the {'time' if isinstance(value, time) else 'date'} {value.isoformat()}"
        text = repr(value)
        return text if self._show_values and len(text) <= _SHOWN else "the value"

    def _resolved(self, node: Any, place: Place) -> Any:
        """Replace the variables of all strings; one that cannot be, and a number that none is, are taken out."""
        if is_map(node):
            return {key: self._resolved(item, (*place, key)) for key, item in node.items()}
        if is_list(node):
            return [self._resolved(item, (*place, i)) for i, item in enumerate(node)]
        if not isinstance(node, str):
            return self._number(node, place)
        folder = Path(self._file(place) or self._source).parent
        try:
            self.secret_files += ((place, one) for one in files_of(node, folder))
            return substituted(node, folder)
        except ConfigError as error:
            self.collector.add(place, str(error))
            return FAULTY

    def _number(self, node: Any, place: Place) -> Any:
        """Return a value that is no text, unless it is a number that no key can have."""
        why = unusable(node)
        if why is None:
            return node
        self.collector.add(place, f"{self._shown(place, node)} {why}")
        return FAULTY

    def _read(self) -> GatewayConfig:
        rest = {k: v for k, v in self.raw.items() if k not in ("backends", "transports", "plugins")}
        if rest.get("anonymous") is False:
            rest["anonymous"] = {"role": None}
        known = ("backends", "transports", "plugins")
        left = self.collector.read(rest, GatewayConfig, (), known)
        if left is FAULTY:
            left = {}
        left["backends"] = self._backends()
        left["plugins"] = self._tables("plugins", {})
        left["transports"] = self._tables("transports", {name: {} for name in TRANSPORTS})
        return msgspec.convert(left, GatewayConfig, strict=True)

    def _backends(self) -> list[dict[str, Any]]:
        tables = self.raw.get("backends", [])
        if not is_list(tables):
            self.collector.add(
                ("backends",), "write [[backends]] with double brackets, one table for each robot"
            )
            return []
        found: list[dict[str, Any]] = []
        kept: list[int] = []
        for index, table in enumerate(tables):
            place = ("backends", index)
            if not is_map(table):
                self.collector.add(place, "write [[backends]] and its keys below it")
                continue
            spelt = self._respelt(table, place)
            own = {key: item for key, item in spelt.items() if key in KERNEL_KEYS}
            own.setdefault("name", own.get("use", "-"))
            left = self.collector.read(own, BackendConfig, place)
            if left is FAULTY and isinstance(own.get("use"), str):  # the plugin's keys are read on
                left = {"use": own["use"], "name": f"-{index}", "tenant": "-"}
            if left is not FAULTY:
                options = {key: item for key, item in spelt.items() if key not in KERNEL_KEYS}
                found.append({**left, "options": options})
                kept.append(index)
        self.collector.keep(("backends",), kept)
        return found

    def _respelt(self, table: dict[str, Any], place: Place) -> dict[str, Any]:
        """Note misspelt keys that a backend cannot do without, and read them as they were meant."""
        for key in ("use", "tenant"):
            near = None if key in table else closest(key, table)
            if near is not None and near not in KERNEL_KEYS:
                self.collector.add((*place, near), f"unknown key; did you mean `{key}`?")
                table = {key if name == near else name: item for name, item in table.items()}
        return table

    def _tables(self, group: str, found: dict[str, Any]) -> dict[str, Any]:
        tables = self.raw.get(group, {})
        if not is_map(tables):
            self.collector.add((group,), f"contains only tables: write [{group}.<name>]")
            return found
        for name, table in tables.items():
            if table is False and group == "transports":
                found.pop(name, None)
            elif is_map(table):
                found[name] = table
            else:
                off = f", or `{name} = false` to take it out" if group == "transports" else ""
                self.collector.add((group, name), f"write [{group}.{name}]{off}")
        return found

    def _check(self) -> None:
        self._check_backends()
        self._check_identities()
        names = [backend.name for backend in self.config.backends]
        for name, scopes in self.config.safety.groups.items():
            place = ("safety", "groups", name)
            with self._plain(place):
                check_groups({name: scopes}, names, self._tenants, "")
        for name, role in self.config.roles.items():
            self._check_role(name, role)
        for name in sorted(self.config.used_features):
            if self.config.features.get(name) is False:
                self.collector.add(
                    ("features", name),
                    "false, but the configuration uses this feature: remove this line, or what "
                    "uses it",
                )

    @contextmanager
    def _plain(self, place: Place) -> Generator[None]:
        """Note a `ConfigError` of a block as a fault of exactly this place."""
        try:
            yield
        except ConfigError as error:
            self.collector.add(place, _HEADER.sub("", str(error)))

    def _check_role(self, name: str, role: Role) -> None:
        alone = [("allow", i, Role(allow=(rule,))) for i, rule in enumerate(role.allow)]
        alone += [("deny", i, Role(deny=(rule,))) for i, rule in enumerate(role.deny)]
        for kind, index, one in alone:
            place = self.collector.original(("roles", name, kind, index))
            with self.checking(place, _follow(self.raw, place)):
                check_roles({name: one}, "")
        for index, path in enumerate(role.approve):
            place = self.collector.original(("roles", name, "approve", index))
            with self._plain(place):
                check_roles({name: Role(approve=(path,))}, "")

    def _check_backends(self) -> None:
        seen: set[str] = set()
        for index, backend in enumerate(self.config.backends):
            place = self.collector.original(("backends", index))
            if backend.name in seen:
                self.collector.add(
                    (*place, "name"),
                    f"two [[backends]] have the name '{backend.name}': give each a unique `name`",
                )
            seen.add(backend.name)

    @property
    def _tenants(self) -> list[str]:
        """The tenants that the file names, those of tables with faults too."""
        backends, tables = self.raw.get("backends"), self.raw.get("tenants")
        named = [one.get("tenant") for one in backends if is_map(one)] if is_list(backends) else []
        found = [*(tables if is_map(tables) else ()), *named]
        return list(dict.fromkeys(one for one in found if isinstance(one, str)))

    def _check_identities(self) -> None:
        tables = self.raw.get("roles")
        held = dict.fromkeys(tables, Role()) if is_map(tables) else {}
        roles = {**BUILTIN_ROLES, **held}
        names: dict[str, str] = {}
        for index, key in enumerate(self.config.keys):
            place = self.collector.original(("keys", index))
            if not self.faulty(place):
                with self.checking(place, _follow(self.raw, place)):
                    check_identity((key,), (), "")
            with self._grant(place):
                check_grants(key.grants, f"key '{key.name}'", self._tenants, roles)
            if key.key is None and key.sha256 is None:
                continue
            digest = key.sha256 or fingerprint(key.key or "")
            if digest in names:
                self.collector.add(
                    (*place, "sha256" if key.sha256 else "key"),
                    f"key '{names[digest]}' has the same secret: give each key its own",
                    partial=True,
                )
            names.setdefault(digest, key.name)
        for index, one in enumerate(self.config.certificates):
            place = self.collector.original(("certificates", index))
            if not self.faulty(place):
                with self.checking(place, _follow(self.raw, place)):
                    check_identity((), (one,), "")
            with self._grant(place):
                check_grants(one.grants, f"certificate '{one.name}'", self._tenants, roles)
        with self._grant(("anonymous",)):
            check_grants(self.config.anonymous.grants, "anonymous", self._tenants, roles)

    def faulty(self, place: Place) -> bool:
        """Return whether a fault was found at a node or in it."""
        return any(one.place[: len(place)] == place for one in self.collector.faults)

    @contextmanager
    def _grant(self, place: Place) -> Generator[None]:
        """Note an unknown role or tenant at the key that names it."""
        try:
            yield
        except ConfigError as error:
            message = str(error)
            node: Any = _follow(self.raw, place)
            keys = ("roles", "tenants") if "tenant '" in message else ("roles", "role")
            key = next((key for key in keys if is_map(node) and key in node), None)
            self.collector.add((*place, key) if key else place, message)


def _is_secret(value: str) -> bool:
    """Return whether a value must not be in a message; the path of a key's file may."""
    is_path = False
    with suppress(OSError, RuntimeError):  # where one may not look, the `~` of an unknown user
        is_path = "/" in value and Path(value).expanduser().parent.is_dir()
    return len(value) >= _DEAR_LENGTH and not is_path


def _at(node: Any, step: str | int) -> Any:
    if is_map(node):
        return node.get(str(step))
    return node[step] if is_list(node) and isinstance(step, int) and step < len(node) else None


def _follow(node: Any, place: Place) -> Any:
    for step in place:
        node = _at(node, step)
    return node
