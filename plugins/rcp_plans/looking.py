"""The values used by conditions of plans: live values, and only those the sender may read."""

from __future__ import annotations

from rcp_conditions import Condition, ConditionTooCostly
from rcp_kernel.access.conditions import Conditions
from rcp_kernel.errors import Forbidden, PreconditionFailed, UnknownPath
from rcp_kernel.model import Operation
from rcp_kernel.sessions.session import Session
from rcp_plans.node import Node

__all__ = ["looked_at", "refuse_excess"]


def looked_at(
    conditions: Conditions, session: Session, node: Node, condition: Condition
) -> list[str]:
    """Return the paths used by a condition of a step.

    :raises UnknownPath: a path does not exist, or is hidden.
    :raises Forbidden: the session may not read one of them.
    """
    return [_path(conditions, session, node, ref) for ref in condition.refs]


def _path(conditions: Conditions, session: Session, node: Node, ref: tuple[str, ...]) -> str:
    found = conditions.resource(ref, node)
    if found is None or not session.rights.mask(found[0].path):
        raise UnknownPath(
            f"the condition refers to {'.'.join(ref)}, which is not a value of "
            f"'{node.robot or node.tenant or 'any robot'}'",
            remedy="Refer to a sensor, actuator or param; set `robot` if there are several robots.",
        )
    entry = found[0]
    if not session.rights.permits(entry, Operation.READ):
        raise Forbidden(f"{session.principal.name} may not read {entry.path}", path=entry.path)
    return entry.path


def refuse_excess(conditions: Conditions, node: Node, condition: Condition) -> None:
    """Refuse a condition whose current values are too large.

    :raises PreconditionFailed: they are.
    """
    why = conditions.excess(condition, node)
    if why is not None:
        raise PreconditionFailed(
            f"the condition `{condition.text}` is too costly: {why}",
            remedy=ConditionTooCostly.remedy,
        )
