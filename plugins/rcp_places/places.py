"""The places: listed, found by name, and edited by people."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from typing import Any

import structlog
from msgspec import ValidationError, convert, structs, to_builtins

from rcp_kernel.errors import Forbidden, InvalidValue, PreconditionFailed, QueueFull, UnknownPath
from rcp_kernel.features import FeatureHost
from rcp_kernel.model import Operation
from rcp_kernel.sessions.session import Session
from rcp_places.config import PlacesConfig
from rcp_places.messages import EARTH, EVERYONE, Edit, Place, Position, Shape, check_shape
from rcp_protocol.similarity import nearest

__all__ = ["PATH", "Places"]

log = structlog.get_logger("rcp.places")
PATH = "/system/places"
_READ = int(Operation.READ)
_NEAREST = 5
_SHAPE = tuple(field.name for field in structs.fields(Shape))


class Places:
    """The places of a gateway."""

    def __init__(self, config: PlacesConfig, host: FeatureHost) -> None:
        self._host = host
        self._kept = host.store("places")
        self._added: dict[tuple[str, str], Place] = {}
        self.configure(config)

    def configure(self, config: PlacesConfig) -> None:
        """Apply another configuration."""
        self._most = config.most
        self._given = {
            (one.tenant, name): Place(
                name=name, tenant=one.tenant, **{k: getattr(one, k) for k in _SHAPE}
            )
            for name, one in config.given.items()
        }
        self._host.changed(PATH)

    def restore(self) -> None:
        """Load what people have added in earlier runs."""
        for key, row in self._kept.load().items():
            try:
                place = convert(row, Place)
            except ValidationError as error:
                log.warning("place_unreadable", place=key, error=str(error))
                continue
            self._added[place.tenant, place.name] = place

    def view(self, session: Session) -> Generator[Any]:
        """List the places that a reader may see, by name."""
        yield from (to_builtins(one) for one in self._visible(session))

    def find(self, session: Session, tenant: str, name: str) -> dict[str, Any]:
        """Return where a place is, for a robot of a tenant: `frame`, `position` and `yaw`.

        A tenant's own place goes before one of all.

        :raises InvalidValue: the session sees no place of that name.
        """
        known = {one.name: one for one in self._visible(session) if one.tenant == EVERYONE}
        known |= {one.name: one for one in self._visible(session) if one.tenant == tenant}
        place = known.get(name)
        if place is None:
            near = nearest(name, known, _NEAREST) or sorted(known)[:_NEAREST]
            hint = f" The nearest are: {', '.join(near)}." if near else ""
            raise InvalidValue(
                f"there is no place '{name[:64]}'",
                details={"pointer": "/position/place", "places": near},
                remedy=f"Read {PATH} for the names of places.{hint}",
            )
        return {"frame": place.frame, "position": _middle(place), "yaw": place.yaw}

    def edit(self, session: Session, edit: Edit, *, dry_run: bool) -> Place | None:
        """Set or remove a place.

        :raises RcpError: the session may not change it, or it has no position.
        """
        tenant = self._tenant(session, edit.tenant)
        key = (tenant, edit.name)
        if key in self._given:
            raise PreconditionFailed(
                f"the place '{edit.name}' is in the gateway's configuration",
                path=PATH,
                remedy="Use another name, or change the configuration.",
            )
        place = None if edit.do == "remove" else self._made(session, edit, tenant)
        if place is None and key not in self._added:
            raise UnknownPath(f"there is no place '{edit.name}'", path=PATH)
        own = sum(other == tenant for other, _ in self._added)
        if place is not None and key not in self._added and own >= self._most:
            whose = "all" if tenant == EVERYONE else tenant
            raise QueueFull(
                f"there are already {self._most} places of {whose}",
                path=PATH,
                remedy="Remove one first.",
            )
        if dry_run:
            return place
        if place is None:
            del self._added[key]
        else:
            self._added[key] = place
        self._kept.put("/".join(key), None if place is None else to_builtins(place))
        self._host.note(
            "place", principal=session.principal, session=session, path=PATH,
            tenant=None if tenant == EVERYONE else tenant, do=edit.do, name=edit.name,
        )  # fmt: skip
        self._host.changed(PATH)
        return place

    def _visible(self, session: Session) -> Iterator[Place]:
        if not session.rights.compute_mask(PATH) & _READ:
            return
        held = session.rights.places(PATH, Operation.READ)
        tenants, every = {EVERYONE, *held}, EVERYONE in held
        known = {**self._added, **self._given}
        for key in sorted(known, key=lambda one: (one[1], one[0])):
            if every or key[0] in tenants:
                yield known[key]

    def _tenant(self, session: Session, named: str | None) -> str:
        mine = session.rights.places(PATH, Operation.EXECUTE)  # by the role that it has there
        tenant = named or session.tenant
        if tenant is None:
            raise InvalidValue(
                "a place needs a `tenant`",
                details={"pointer": "/tenant"},
                remedy="Name a tenant, or `*` for a place of all.",
            )
        if EVERYONE not in mine and tenant not in mine:
            raise Forbidden(
                f"you may not change places of {'all' if tenant == EVERYONE else tenant}",
                path=PATH,
                remedy="Ask for a role there that may execute it, or name another `tenant`.",
            )
        return tenant

    def _made(self, session: Session, edit: Edit, tenant: str) -> Place:
        shape = {name: getattr(edit, name) for name in _SHAPE}
        if edit.robot is not None:
            shape |= self._where(session, edit.robot)
        place = Place(name=edit.name, tenant=tenant, by=session.principal.name, **shape)
        check_shape(place)
        if tenant == EVERYONE and place.frame in ("map", "odom", "base_link"):
            raise InvalidValue(
                f"the frame '{place.frame}' is of one robot, and the place is that of all",
                details={"pointer": "/frame"},
                remedy="Give the place in the frame `earth`, or to one tenant.",
            )
        return place

    def _where(self, session: Session, robot: str) -> dict[str, Any]:
        """Return where a robot is now."""
        root, _, rest = robot.strip("/").partition("/")
        if root != "tenant" or not rest:
            raise InvalidValue(
                f"'{robot[:100]}' names no robot",
                details={"pointer": "/robot"},
                remedy="Write /tenant/<tenant>, or /tenant/<tenant>/<robot>, as /system/robots lists it.",
            )
        tenant, *names = rest.split("/")
        path = "/".join(("/tenant", tenant, "sensor", *names, "pose"))
        entry = self._host.robots.entries.get(path)
        if entry is None or not session.rights.permits(entry, Operation.READ):
            raise UnknownPath(f"no robot '{robot[:100]}' with a pose", path=PATH)
        value = None if entry.latest is None or entry.stale else entry.latest.value
        frame, at = getattr(value, "frame_id", None), getattr(value, "position", None)
        if not frame or at is None:
            raise PreconditionFailed(f"{path} has no recent value", path=path)
        return {"frame": frame, "position": Position(x=at.x, y=at.y, z=at.z)}


def _middle(place: Place) -> dict[str, float]:
    """Return the horizontal position; the height of a place is not where a robot is to be."""
    points = (place.position,) if place.position is not None else place.corners
    names = ("latitude", "longitude") if place.frame == EARTH else ("x", "y")
    share = 1 / len(points)  # of each, before they are added: their sum may be too large
    return {name: math.fsum(getattr(one, name) * share for one in points) for name in names}
