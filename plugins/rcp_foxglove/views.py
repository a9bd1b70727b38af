"""What a session may see, as channels, services and parameters: read once for equal rights."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping
from hashlib import blake2b
from itertools import chain, count
from typing import NamedTuple
from weakref import WeakKeyDictionary

from rcp_foxglove.config import FoxgloveConfig
from rcp_foxglove.offers import (
    Channel,
    Facts,
    ParameterOffer,
    Service,
    Target,
    channel_of,
    service_of,
)
from rcp_gateway.api import Query, Rights, Session, SharedWork
from rcp_gateway.client_api import ClientApi
from rcp_kernel.model import NativeType, Pattern, tenant_of

__all__ = ["ESTOP", "Replay", "View", "Views"]

_PAGE = 10  # resources read per step
_KEPT = 100_000  # numbers of channels and services, also of those that are gone
ESTOP = "/system/estop"
_MARKS = {"number": "float64"}
_PARTS = {"state": "subscribe", "control": "execute"}
"""What is done with the parts of a replay."""


class Replay(NamedTuple):
    """A recording that is replayed."""

    state: str
    """Path of where it is."""
    control: str | None
    """Path of the service that changes it, for those who may."""


class View:
    """One generation of the tree as one set of rights shows it in one tenant."""

    def __init__(self, generation: int) -> None:
        self.generation = generation
        self.channels: dict[int, Channel] = {}
        self.services: dict[int, Service] = {}
        self.targets: dict[str, Target] = {}
        """By topic; what has a ROS name is there by its path too."""
        self.parameters: dict[str, ParameterOffer] = {}
        self.assets: list[str] = []
        """Services that return files of a robot's description."""
        self.publishers: dict[str, str] = {}
        """The backend of each topic."""
        self.replays: dict[str, dict[str, str]] = {}
        """Paths of each replay, by what they are for."""

    @property
    def replay(self) -> Replay | None:
        """The replay, if there is exactly one: a viewer has one time."""
        if len(self.replays) != 1:
            return None
        (paths,) = self.replays.values()
        return Replay(paths["state"], paths.get("control")) if "state" in paths else None


class Views:
    """The views of all clients."""

    def __init__(self, config: FoxgloveConfig, client_api: ClientApi) -> None:
        self._config = config
        self._client_api = client_api
        self._views: WeakKeyDictionary[Rights, dict[str | None, View]] = WeakKeyDictionary()
        self._reading = SharedWork[View](client_api.loop)
        self._numbers: dict[bytes, int] = {}
        """By what they stand for, the ones used last at the end."""
        self._next = count(1)

    def is_current(self, session: Session, view: View) -> bool:
        """Return whether a session still has a view."""
        return self._current(session) is view

    def _current(self, session: Session) -> View | None:
        known = self._views.get(session.rights, {}).get(session.tenant)
        if known is None or known.generation != self._client_api.generation(session):
            return None
        return known

    async def view(self, session: Session) -> View:
        """Return the present view of a session."""
        known = self._current(session)
        if known is not None:
            return known
        turns, owner = self._client_api.turns, session.principal.identity
        key = (self._client_api.generation(session), session.rights, session.tenant)
        return await self._reading.result(key, lambda: turns.finish(owner, self._read(session)))

    def _number(self, facts: tuple[str, ...]) -> int:
        key = blake2b("\0".join(facts).encode(), digest_size=16).digest()
        number = self._numbers.pop(key, None) or next(self._next)
        self._numbers[key] = number
        if len(self._numbers) > _KEPT:  # whoever comes back later has another one
            del self._numbers[next(iter(self._numbers))]
        return number

    def _read(self, session: Session) -> Generator[None, None, View]:
        rights, tenant = session.rights, session.tenant
        view = View(self._client_api.generation(session))
        names = _Names(tenant, ros=self._config.ros_names)
        query: Query | None = Query(limit=_PAGE)
        actuators: list[Facts] = []  # last: a topic with a sensor too is the sensor's
        while query is not None:
            page = yield from self._client_api.discover(session, "/**", query)
            for one in page["resources"]:
                if not self._shows(one["path"]):
                    continue
                if one["kind"] == "actuator":
                    actuators.append(one)
                    continue
                natives = self._client_api.native_types(session, one["path"])
                self._add(view, names, one, natives)
                yield
            cursor = page.get("cursor")
            query = None if cursor is None else Query(limit=_PAGE, cursor=cursor)
            yield
        for one in actuators:
            natives = self._client_api.native_types(session, one["path"])
            self._add(view, names, one, natives)
            yield
        self._views.setdefault(rights, {})[tenant] = view
        return view

    def _shows(self, path: str) -> bool:
        if path.startswith("/system/"):
            return path == ESTOP
        tenant = tenant_of(path)
        return any(
            text == "/**" or Pattern(text, tenant).matches(path) for text in self._config.show
        )

    def _add(
        self, view: View, names: _Names, one: Facts, natives: Mapping[str, NativeType]
    ) -> None:
        kind, operations = one["kind"], one["operations"]
        part = one.get("meta", {}).get("replay")
        may = isinstance(part, str) and _PARTS.get(part) in operations
        if may and names.tenant in (None, tenant_of(one["path"])):
            place = one["path"].replace(f"/{kind}/", "/", 1)
            view.replays.setdefault(place, {})[part] = one["path"]
        if "execute" in operations:
            self._add_service(view, names, one, natives)
        elif kind == "param":
            self._add_parameter(view, names, one)
        elif one["path"] != ESTOP:
            topic, native = names.topic(one, natives.get("value"))
            if "subscribe" in operations:
                shown = native if kind in ("sensor", "event") else None
                channel = channel_of(one, topic, shown, self._number)
                view.channels[channel.id] = channel
                view.publishers[topic] = one["backend"]
            if "write" in operations:
                target = _target(one, topic, natives.get("value"))
                ros = one.get("meta", {}).get("topic")
                for name in {ros, topic, names.own(one["path"]), one["path"]} - {None}:
                    view.targets.setdefault(name, target)

    def _add_service(
        self, view: View, names: _Names, one: Facts, natives: Mapping[str, NativeType]
    ) -> None:
        name = names.unique(one.get("meta", {}).get("service"), one["path"])
        service = service_of(one, name, natives, self._number)
        view.services[service.id] = service
        if one["path"].endswith("/assets/fetch"):
            view.assets.append(one["path"])

    def _add_parameter(self, view: View, names: _Names, one: Facts) -> None:
        if "read" not in one["operations"]:
            return
        meta = one.get("meta", {})
        node, parameter = meta.get("node"), meta.get("parameter")
        ros = f"{node}.{parameter}" if node and parameter else None
        name = names.unique(ros, one["path"])
        schema = one["schemas"]["value"]
        mark = _MARKS.get(schema.get("type", ""))
        if schema.get("contentEncoding") == "base64":
            mark = "byte_array"
        elif schema.get("type") == "array" and schema.get("items", {}).get("type") == "number":
            mark = "float64_array"
        writable = "write" in one["operations"]
        view.parameters[name] = ParameterOffer(name, one["path"], mark, writable)


def _target(one: Facts, topic: str, native: NativeType | None) -> Target:
    return Target(
        topic=topic,
        path=one["path"],
        backend=one["backend"],
        native=native,
        deadman="safe" in one,
        valid_for=one.get("valid_for"),
    )


class _Names:
    """The names of one view: each is given once."""

    def __init__(self, tenant: str | None, *, ros: bool) -> None:
        self.tenant = tenant
        self._start = None if tenant is None else f"/tenant/{tenant}/"
        self._ros = ros
        self._taken: set[str] = set()
        self._serialised: set[tuple[str, str]] = set()

    def own(self, path: str) -> str:
        """Return the name of a path: without its tenant, if the session has one tenant."""
        start = self._start
        return path if start is None or not path.startswith(start) else path[len(start) - 1 :]

    def unique(self, ros: str | None, path: str) -> str:
        """Return the name in ROS if there is one that is free, else the path."""
        for name in chain(self._wished(ros), (self.own(path),)):
            if name not in self._taken:
                self._taken.add(name)
                return name
        return path

    def _wished(self, ros: str | None) -> Iterator[str]:
        if ros and self._ros:
            yield ros

    def topic(self, one: Facts, native: NativeType | None) -> tuple[str, NativeType | None]:
        """Return the topic of a resource, and its serialised type unless another topic has that.

        Several paths may come from one topic: its whole message is sent once.
        """
        ros = one.get("meta", {}).get("topic")
        topic = self.unique(ros, one["path"])
        if native is None or ros is None:
            return topic, native
        key = (ros, native.name)
        if key in self._serialised:
            return topic, None
        self._serialised.add(key)
        return topic, native
