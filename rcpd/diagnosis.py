"""Every fault of a configuration file, those that only the plugins' types and checks know too."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec

from rcp_gateway.client_kinds import AdapterKind
from rcp_gateway.plugins import (
    GROUPS,
    AnyKind,
    Plugins,
    install_remedy,
    installed,
    missing_module,
    wanted_module,
)
from rcp_gateway.server import Prepared, prepare
from rcp_kernel.access.identities import check_proofs
from rcp_kernel.config.features import BUILTIN
from rcp_kernel.config.file import KERNEL_KEYS, TRANSPORTS, GatewayConfig, parse
from rcp_kernel.errors import ConfigError, StartupError
from rcp_kernel.features import FeatureKind
from rcp_kernel.spi import BackendKind, Exclusive
from rcp_protocol.plain import is_map
from rcp_protocol.similarity import closest
from rcp_toml.positions import Place
from rcpd.faults import FAULTY, place_in
from rcpd.installed import obstacle
from rcpd.reading import text_of
from rcpd.survey import Finding, Survey
from rcpd.suspicions import misplaced_store, suspicions

__all__ = ["Diagnosis", "explained", "summary"]

_NAME = re.compile(r"[^\W\d][\w-]*")


class Diagnosis:
    """What is wrong with a text, and what would be served of it."""

    def __init__(self, text: str, source: str, *, show_values: bool = True) -> None:
        self._text = text
        self._source = source
        self._survey = Survey(text, source, show_values=show_values)
        self._points = {group: installed(group) for group in GROUPS}
        self._lesser: list[Finding] = []
        """What does less, for lack of a library."""
        if self._survey.readable:
            self._examine()

    def prepared(self) -> Prepared | None:
        """Prepare the file as the start does; None if there are faults."""
        if self._survey.findings:
            return None
        try:
            return prepare(parse(self._text, self._source), self._source)
        except StartupError as error:
            self._survey.collector.add((), str(error).removeprefix(f"{self._source}: "))
            return None

    @property
    def findings(self) -> list[Finding]:
        """The faults by line."""
        return self._survey.findings

    def refusal(self, error: StartupError) -> Finding | None:
        """Return the fault for which the start has refused the file, None if none of them is."""
        refusals = self._survey.refusals
        named = (one for one in refusals if _is_named(one, str(error)))
        return next(named, next(iter(refusals), None))

    @property
    def secrets(self) -> list[str]:
        """What must not be shown, also of the files that it includes."""
        return self._survey.secrets

    @property
    def full(self) -> bool:
        """Whether there are more faults than are listed."""
        return self._survey.collector.full

    @property
    def warnings(self) -> list[Finding]:
        """What may be meant, although it is suspicious, or does less for lack of a library."""
        survey = self._survey
        found = [survey.finding(place, text) for place, text in suspicions(survey)]
        found += [*self._unheard(), *self._lesser]
        return sorted(found, key=lambda one: (one.file or "", one.line))

    def _unheard(self) -> list[Finding]:
        # A hub without a listener still serves programs of its own.
        if set(self._survey.config.transports) - (set(TRANSPORTS) - {"asgi"}):
            return []
        text = "nothing listens, so no client can reach this gateway: remove `asgi = false`"
        line = self._survey.line(("transports", "asgi"))
        return [Finding(line, "transports", "asgi", text)]

    def _examine(self) -> None:
        survey = self._survey
        used = [backend.use for backend in survey.config.backends]
        config = msgspec.structs.replace(
            survey.config,
            transports=self._offered("transports", survey.config.transports),
            plugins=self._offered("plugins", survey.config.plugins),
            features=self._offered("features", survey.config.features),
            backends=tuple(
                one
                for index, one in enumerate(survey.config.backends)
                if self._is_offered("backends", used[index], self._use(index))
            ),
        )
        config = self._without_lacking(config)
        try:
            plugins = Plugins(config)
        except StartupError as error:
            survey.collector.add((), str(error))
            return
        self._report_missing(plugins)
        self._report_wanted(plugins)
        self._examine_backends(plugins)
        self._examine_clients("transports", config.transports, plugins.transports, config)
        self._examine_clients("plugins", config.plugins, plugins.adapters, config)
        for name, raw in config.active_features.items():
            if name in plugins.features:
                self._examine_feature(plugins.features[name], raw, config)
        if (misplaced := misplaced_store(config)) is not None:
            survey.collector.add(("store", "path"), misplaced, partial=True)
        for index, one in enumerate(config.certificates):
            with survey.checking(survey.collector.original(("certificates", index))):
                check_proofs(msgspec.structs.replace(config, certificates=(one,)), "")

    def _use(self, index: int) -> Place:
        return (*self._survey.collector.original(("backends", index)), "use")

    def _offered(self, group: str, tables: dict[str, Any]) -> dict[str, Any]:
        return {
            name: table
            for name, table in tables.items()
            if self._is_offered(group, name, (group, name))
        }

    def _is_offered(self, group: str, name: str, place: Place) -> bool:
        """Return whether a plugin is installed, or at least known; note a fault otherwise."""
        points = self._points[group]
        if name in points or (group == "features" and name in BUILTIN):
            return True
        near = closest(name, points)
        advice = f"did you mean '{near}'?" if near else f"installed: {', '.join(sorted(points))}"
        self._survey.collector.add(place, f"no installed plugin offers {group} '{name}'; {advice}")
        return False

    def _without_lacking(self, config: GatewayConfig) -> GatewayConfig:
        """Report the features in use that lack a library; return what is left without them."""
        lacking: dict[str, bool] = {}
        for name in sorted(config.used_features & set(self._points["features"])):
            reason = None
            with suppress(Exception):  # a module that is broken otherwise: the start says how
                reason = obstacle(self._points["features"][name])
            if reason is not None:
                place: Place = ("features", name) if name in config.features else (name,)
                text = f"the feature '{name}' cannot be loaded: {reason}"
                self._survey.collector.add(place, text, partial=True)
                lacking[name] = False
        return msgspec.structs.replace(config, features={**config.features, **lacking})

    def _report_missing(self, plugins: Plugins) -> None:
        for one in plugins.missing:
            if one.group != "backends":
                places: Iterable[Place] = [(one.group, one.name)]
            else:
                config = self._survey.config
                places = [self._use(i) for i, b in enumerate(config.backends) if b.use == one.name]
            text = f"cannot be imported: {one.reason}; try: {one.remedy}"
            for place in places:
                message = f"{one.group} '{one.name}' {text}"
                self._survey.collector.add(place, message, partial=True)

    def _report_wanted(self, plugins: Plugins) -> None:
        """Warn of what is served, but does less without a library that is not installed."""
        survey, found = self._survey, list[tuple[str, AnyKind, Place]]()
        for index, backend in enumerate(survey.config.backends):
            if (kind := plugins.backends.get(backend.use)) is not None:
                found.append(("backends", kind, self._use(index)))
        for name, adapter in plugins.adapters.items():
            found.append(("plugins", adapter, ("plugins", name)))
        for group, kind, place in found:
            point, module = self._points[group].get(kind.name), wanted_module(kind)
            if module is not None and point is not None and missing_module(kind) is None:
                apart = isinstance(kind, BackendKind) and kind.remedy is not None
                remedy = f"pip install {module}" if apart else install_remedy(point)
                text = (
                    f"{group} '{kind.name}' works, but does less without the library '{module}', "
                    f"which is not installed; try: {remedy}"
                )
                self._lesser.append(survey.finding(place, text))

    def _examine_backends(self, plugins: Plugins) -> None:
        collector = self._survey.collector
        held: list[tuple[int, Exclusive]] = []
        for index, backend in enumerate(self._survey.config.backends):
            kind = plugins.backends.get(backend.use)
            if kind is None:
                continue
            place = collector.original(("backends", index))
            left = collector.read(backend.options, kind.config, place, KERNEL_KEYS)
            ready = plugins.is_missing("backends", backend.use) is None
            if left is not FAULTY and kind.check and ready and not self._survey.faulty(place):
                with self._survey.checking(place, backend.options):
                    kind.check(msgspec.convert(left, kind.config, strict=True))
            if left is not FAULTY:
                # Else a default may stand for what is at fault.
                whole = not self._survey.faulty(place)
                table = msgspec.convert(left, kind.config, strict=True)
                self._note_lacking(kind, table, place, backend.options)
                if whole:
                    self._note_shared(kind, table, index, held)

    def _note_lacking(
        self, kind: BackendKind | AdapterKind, table: Any, place: Place, raw: Any
    ) -> None:
        """Note what this machine lacks for a table; the gateway would serve the others."""
        if kind.lacks is None or self._survey.faulty(place):
            return
        if (lacking := kind.lacks(table)) is not None:
            with self._survey.checking(place, raw, partial=True):
                raise ConfigError(lacking)

    def _note_shared(
        self, kind: BackendKind, table: Any, index: int, held: list[tuple[int, Exclusive]]
    ) -> None:
        """Note what another backend has open too."""
        backends, collector = self._survey.config.backends, self._survey.collector
        for one in kind.exclusive(table) if kind.exclusive else ():
            other = next((i for i, have in held if i != index and have.overlaps(one)), None)
            held.append((index, one))
            if other is not None:
                name = backends[other].name
                text = f"'{one.link}' is used by the backend '{name}' already: only one can open it"
                place = collector.original(("backends", index))
                at = place_in(text, backends[index].options, place)
                collector.add(at, text, partial=True)

    def _examine_clients(
        self,
        group: str,
        tables: dict[str, dict[str, Any]],
        kinds: Mapping[str, Any],
        config: GatewayConfig,
    ) -> None:
        for name, raw in tables.items():
            if name not in kinds:
                continue
            kind, place = kinds[name], (group, name)
            left = self._survey.collector.read(raw, kind.config, place)
            check = getattr(kind, "check", None)
            if left is not FAULTY and check is not None and not self._survey.faulty(place):
                with self._survey.checking(place, raw):
                    check(msgspec.convert(left, kind.config, strict=True), config)
            if left is not FAULTY and isinstance(kind, AdapterKind):
                table = msgspec.convert(left, kind.config, strict=True)
                self._note_lacking(kind, table, place, raw)

    def _examine_feature(self, kind: FeatureKind, raw: Any, config: GatewayConfig) -> None:
        collector = self._survey.collector
        place: Place = ()
        if kind.table is None:
            place = ("features", kind.name)
            table = collector.read(raw or {}, kind.config, place)
        elif raw is not None:
            collector.add(
                ("features", kind.name), f"takes no keys; write `{kind.name} = true` or `false`"
            )
            return
        else:
            table = kind.table(config)
            if is_map(table):
                table = collector.read(table, kind.config, ())
        if table is FAULTY or kind.check is None or self._survey.findings:
            return  # it may look at any table of the file
        with self._survey.checking(place, self._survey.raw):
            kind.check(msgspec.convert(table, kind.config, strict=True), config)


def _is_named(fault: Finding, refusal: str) -> bool:
    """Return whether a refusal, which is worded differently, tells of a fault."""
    names = _NAME.findall(fault.key or "")
    return fault.message in refusal or (bool(names) and names[-1] in _NAME.findall(refusal))


def explained(error: StartupError, path: Path) -> str:
    """Return why a file cannot be served: the fault with its line, and how many more there are."""
    text = text_of(path)
    if isinstance(text, Finding):
        return text.text(str(path))
    found = Diagnosis(text, str(path))
    first, count = found.refusal(error), len(found.findings)
    if first is None:
        return summary(str(error), count, path)
    return summary(first.text(str(path)), count - 1, path)


def summary(fault: str, more: int, path: Path | None = None) -> str:
    """Return one fault, and how many more there are."""
    how = f": `rcpd check {path}`" if path else ""
    return f"{fault} ({more} more{how})" if more else fault
