"""Named places in steps that need approval: what is approved is where they are, not their names."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rcp_kernel.errors import PreconditionFailed
from rcp_kernel.features import ActionHost, ServiceKey
from rcp_kernel.model import tenant_of
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_plans.node import Node
from rcp_protocol.plain import is_map
from rcp_streams.frames import FRAMES

__all__ = ["PLACES", "check_place", "place_in"]

PLACES: ServiceKey[Callable[[Session, str, str], dict[str, Any]]] = ServiceKey("places.find")
"""Service of the feature that has the places."""


def place_in(host: ActionHost, session: Session, entry: Entry, value: Any) -> dict[str, Any] | None:
    """Return where the place is that a goal names; None: it names none, or is no goal in a frame.

    :raises InvalidValue: there is no such place.
    """
    frames = host.service(FRAMES)
    if frames is None or entry.tenant is None or not frames.takes(entry):
        return None
    return _find(host, session, entry.tenant, value)


def _find(host: ActionHost, session: Session, tenant: str, value: Any) -> dict[str, Any] | None:
    find, name = host.service(PLACES), _name(value)
    return None if find is None or name is None else find(session, tenant, name)


def check_place(host: ActionHost, session: Session, node: Node, value: Any) -> None:
    """Refuse a goal at a place that was moved since the plan was approved.

    :raises PreconditionFailed: it was.
    """
    if node.place is None or node.path is None:
        return
    if _find(host, session, tenant_of(node.path) or "", value) != node.place:
        raise PreconditionFailed(
            f"the place '{_name(value)}' is not where it was when the plan was approved",
            path=node.path,
            remedy="Send the plan again without `approval`, to have the new place approved.",
            details={"approved": node.place},
        )


def _name(value: Any) -> str | None:
    position = value.get("position") if is_map(value) else None
    name = position.get("place") if is_map(position) else None
    return name if isinstance(name, str) else None
