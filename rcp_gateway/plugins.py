"""Loading of the plugins that the configuration names; invalid plugins are refused by name.

Entry-point groups are `rcp.transports`, `rcp.plugins`, `rcp.backends` and `rcp.features`; an entry
point's name is the name used in the configuration. A plugin that cannot be imported is
`unavailable`, with the command that fixes it, and does not stop the gateway. A feature does:
commands that it would have refused must not pass because it is broken.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Iterable, Mapping
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from typing import Any

import msgspec
import pluggy

from rcp_gateway import hookspecs
from rcp_gateway.client_kinds import AdapterKind, TransportKind
from rcp_kernel.config.features import BUILTIN
from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.errors import ConfigError, PluginError, StartupError
from rcp_kernel.features import FeatureKind
from rcp_kernel.spi import BackendKind
from rcp_protocol.similarity import closest

__all__ = [
    "GROUPS",
    "AnyKind",
    "Missing",
    "Plugins",
    "collect",
    "import_remedy",
    "install_remedy",
    "installed",
    "missing_module",
    "wanted_module",
]

GROUPS = {
    "transports": "rcp.transports",
    "plugins": "rcp.plugins",
    "backends": "rcp.backends",
    "features": "rcp.features",
}
AnyKind = BackendKind | TransportKind | AdapterKind | FeatureKind
_OWN = "rcp-gateway"
"""The distribution of the built-in features."""


class Missing(msgspec.Struct, frozen=True):
    """A configured plugin that cannot be imported."""

    group: str
    name: str
    reason: str
    remedy: str


def installed(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of a group by name.

    :raises PluginError: two distributions offer the same name.
    """
    return _by_name(group, entry_points(group=GROUPS[group]))


def _by_name(group: str, points: Iterable[EntryPoint]) -> dict[str, EntryPoint]:
    found: dict[str, EntryPoint] = {}
    for point in points:
        other = found.get(point.name)
        if other is not None and other.value != point.value:
            raise PluginError(
                f"{group} '{point.name}' is offered by {_source(other)} and by {_source(point)}: "
                "uninstall one of them"
            )
        found[point.name] = point
    return found


def missing_module(kind: AnyKind) -> str | None:
    """Return the first required module that is not installed; None if all are."""
    return _first_missing(kind.needs)


def wanted_module(kind: AnyKind) -> str | None:
    """Return the first module that is not installed and without which the kind does less."""
    return _first_missing(kind.wants) if isinstance(kind, (BackendKind, AdapterKind)) else None


def _first_missing(modules: Iterable[str]) -> str | None:
    return next((name for name in modules if not _is_installed(name)), None)


def _is_installed(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # its package is not installed either
        return False


def import_remedy(error: BaseException, point: EntryPoint) -> str:
    """Return what to do about a plugin whose module raises when it is imported."""
    name = (error.name or "") if isinstance(error, ImportError) else ""
    package = name.partition(".")[0]
    is_code = package == point.value.partition(".")[0] or package.startswith("rcp_")
    # A library that is not installed, or in a version that does not fit.
    if package and (not is_code or find_spec(package) is None):
        return install_remedy(point)
    return f"fix its module {point.value}, or remove '{point.name}' from the configuration"


def install_remedy(point: EntryPoint, kind: AnyKind | None = None) -> str:
    """Return the command that installs the missing requirement of a plugin.

    An extra named like the plugin contains its libraries, unless its kind says otherwise.
    """
    if isinstance(kind, BackendKind) and kind.remedy is not None:
        return kind.remedy
    if point.dist is None:
        return "install the distribution that offers it again"
    extras = point.dist.metadata.get_all("Provides-Extra") or ()
    extra = point.name.replace("_", "-")  # as metadata spells it
    if extra in extras:
        return f"pip install '{point.dist.name}[{extra}]'"
    return f"pip install {point.dist.name}"


def _source(point: EntryPoint) -> str:
    return f"{point.dist.name if point.dist else 'unknown'} ({point.value})"


class Plugins:
    """The plugins that a configuration names, loaded; hooks are called once, here."""

    def __init__(self, config: GatewayConfig) -> None:
        self.config = config
        self.missing: list[Missing] = []
        self.backends: dict[str, BackendKind] = {}
        self.transports: dict[str, TransportKind] = {}
        self.adapters: dict[str, AdapterKind] = {}
        self.features: dict[str, FeatureKind] = {}
        self._manager = pluggy.PluginManager(hookspecs.PROJECT)
        self._manager.add_hookspecs(hookspecs)
        found = entry_points()  # once: it reads the metadata of all distributions
        self.points = {one: _by_name(one, found.select(group=GROUPS[one])) for one in GROUPS}
        """The entry points of each group by name."""
        self._load("backends", {backend.use for backend in config.backends})
        self._load("transports", set(config.transports))
        self._load("plugins", set(config.plugins))
        self._load_features(config)
        collect(self.backends, self._offers("rcp_backends"), "backend")
        collect(self.transports, self._offers("rcp_transports"), "transport")
        collect(self.adapters, self._offers("rcp_adapters"), "adapter")
        collect(self.features, self._offers("rcp_features"), "feature")
        self._check_needs("backends", self.backends)
        for group, kinds in (
            ("transports", self.transports),
            ("plugins", self.adapters),
            ("features", self.features),
        ):
            for name in self._check_needs(group, kinds):
                del kinds[name]
        self._check_features()

    def _load_features(self, config: GatewayConfig) -> None:
        """Load the features; a built-in one need not be installed unless it is used."""
        wanted = set(config.active_features)
        lost = (wanted & set(BUILTIN)) - set(self.points["features"])
        for name in sorted(lost):
            self.missing.append(Missing("features", name, "not installed", f"pip install {_OWN}"))
        self._load("features", wanted - lost)

    def _check_features(self) -> None:
        """Check that every feature used by the configuration is available.

        :raises PluginError: one is not.
        """
        used = self.config.used_features
        lost = {one.name: one for one in self.missing if one.group == "features"}
        for name in self.config.active_features:
            if name in lost and name in used:
                one = lost[name]
                raise PluginError(
                    f"the configuration uses the feature '{name}', which cannot be loaded: "
                    f"{one.reason}; try: {one.remedy}"
                )
            if name not in self.features and name not in lost:
                raise PluginError(
                    f"the entry point '{name}' of rcp.features offers no feature '{name}'; its "
                    "`rcp_features` must return a FeatureKind of this name"
                )
        self.missing = [one for one in self.missing if one.group != "features"]

    def _offers(self, hook: str) -> list[list[Any]]:
        """Call a hook of each plugin; one whose hook raises is skipped and recorded as missing."""
        found: list[list[Any]] = []
        for name, module in self._manager.list_name_plugin():
            offer = getattr(module, hook, None)
            if offer is None or not hasattr(offer, "rcp_impl"):
                continue
            try:
                found.append(list(offer()))
            except StartupError:
                raise
            except (Exception, SystemExit, KeyboardInterrupt) as error:
                group, _, own = name.partition(".")
                remedy = f"fix its `{hook}`, or remove '{own}' from the configuration"
                self.missing.append(Missing(group, own, repr(error), remedy))
        return found

    def _load(self, group: str, wanted: Iterable[str]) -> None:
        points = self.points[group]
        for name in sorted(wanted):
            point = points.get(name)
            if point is None:
                near = closest(name, points)
                advice = f"did you mean '{near}'?" if near else f"installed: {', '.join(points)}"
                raise ConfigError(f"no installed plugin offers {group} '{name}'; {advice}")
            try:
                module = importlib.import_module(point.value)
            except (Exception, SystemExit, KeyboardInterrupt) as error:
                # Whatever its module does, it does not stop the gateway.
                reason = str(error) if isinstance(error, ImportError) else repr(error)
                self.missing.append(Missing(group, name, reason, import_remedy(error, point)))
                continue
            register(self._manager, module, f"{group}.{name}")

    def _check_needs(
        self,
        group: str,
        kinds: Mapping[str, AnyKind],
    ) -> list[str]:
        """Record the kinds that lack a library as missing, and return their names."""
        points, found = self.points[group], list[str]()
        for name, kind in kinds.items():
            module = missing_module(kind)
            if module is not None and (point := points.get(name)) is not None:
                reason = f"No module named '{module}'"
                self.missing.append(Missing(group, name, reason, install_remedy(point, kind)))
                found.append(name)
        return found

    def is_missing(self, group: str, name: str) -> Missing | None:
        """Return why a named plugin is not there, or None if it is."""
        return next((m for m in self.missing if (m.group, m.name) == (group, name)), None)


def register(manager: pluggy.PluginManager, module: Any, name: str) -> None:
    """Register a module whose hooks are valid.

    :raises PluginError: it has an async hook, an unknown hook, or none at all.
    """
    known = {key for key, value in vars(hookspecs).items() if hasattr(value, "rcp_spec")}
    own: dict[str, Any] = dict(module.__dict__)
    marked = {key for key, value in own.items() if hasattr(value, "rcp_impl")}
    for hook in sorted(marked | {k for k in own if k.startswith("rcp_") and k in known}):
        if hook not in known:
            near = closest(hook, known)
            advice = f"; did you mean `{near}`?" if near else ""
            raise PluginError(f"plugin {name}: unknown hook `{hook}`{advice}")
        if inspect.iscoroutinefunction(getattr(module, hook)):
            raise PluginError(f"plugin {name}: the hook `{hook}` must not be async")
    if not marked:
        raise PluginError(f"plugin {name}: {module.__name__} has no function marked @hookimpl")
    manager.register(module, name=name)


def collect(into: dict[str, Any], found: Iterable[Iterable[Any]], what: str) -> None:
    """Add the records of several plugins by name.

    :raises PluginError: two of them have one name.
    """
    for record in [record for several in found for record in several]:
        if record.name in into:
            raise PluginError(f"two plugins offer the {what} '{record.name}'")
        into[record.name] = record
