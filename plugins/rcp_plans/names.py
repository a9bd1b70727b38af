"""Actions of symbolic plans that no table defines, resolved by robot names, names and schemas."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from itertools import islice
from typing import Any

from rcp_kernel.errors import InvalidValue, UnknownPath
from rcp_kernel.model import Kind
from rcp_kernel.sessions.session import Session
from rcp_kernel.tree.entry import Entry
from rcp_kernel.tree.registry import Registry
from rcp_plans.lines import word
from rcp_plans.symbolic import Action
from rcp_protocol.plain import is_map
from rcp_protocol.similarity import nearest
from rcp_scheduling.turns import Work

__all__ = ["NameScope"]

_CALLED = (Kind.ACTION, Kind.SERVICE)
_STEP = 32  # resources checked per step
_COMPARED = 400  # names compared with a misspelt one
_SEARCHES = 5  # misspelt names per plan for which similar names are searched
_DEEP = 8  # nesting of objects over which arguments are distributed


class NameScope:
    """Finds actions by the names that planners use, among those visible to a session."""

    def __init__(self, registry: Registry, session: Session) -> None:
        self._entries = registry.entries
        self._mask = session.rights.mask
        self._tenant = session.tenant
        self._called: dict[str, list[Entry]] = {}
        """Executable resources by the names under which a plan may refer to their robot."""
        self._robots: dict[str, None] = {}
        self._searches = 0

    def prepare(self) -> Work:
        """Collect the executable resources, in steps."""
        entries = iter(list(self._entries.values()))
        while some := list(islice(entries, _STEP)):
            for entry in some:
                if entry.tenant is None or entry.kind not in _CALLED or not self._mask(entry.path):
                    continue
                for name in _names(entry):
                    self._robots[name] = None
                    self._called.setdefault(_plain(name), []).append(entry)
            yield

    def __call__(self, action: Action, objects: dict[str, Any]) -> tuple[str, Any]:
        """Return path and value of an action, whose first argument is the robot.

        :raises UnknownPath: there is no such robot or action.
        :raises InvalidValue: the arguments do not fit the schema.
        """
        entry = self._find(action)
        given = deque(action.arguments[1:])
        value = _assign(entry.input_type.schema, given, objects)
        if given:
            raise InvalidValue(
                f"({action.name} …) has {len(given)} more arguments than {entry.path} accepts",
                path=entry.path,
                remedy="List the required fields in order, or define the action in "
                "`[plans.actions]`.",
            )
        return entry.path, value

    def _find(self, action: Action) -> Entry:
        robot = action.arguments[0] if action.arguments else ""
        of_robot = self._called.get(_plain(robot))
        if of_robot is None:
            raise self._unknown(f"({action.name} …) names no known robot", robot, self._robots)
        found = [e for e in of_robot if _plain(_last(e)) == _plain(action.name)]
        if not found:
            raise self._unknown(
                f"'{robot[:64]}' has no action or service '{action.name[:64]}'",
                action.name,
                dict.fromkeys(map(_last, of_robot)),
            )
        # The own tenant takes precedence, then the robot with its own name.
        return min(found, key=lambda e: (e.tenant != self._tenant, e.robot is None, e.path))

    def _unknown(self, text: str, name: str, known: Iterable[str]) -> UnknownPath:
        self._searches += 1
        compared = islice(sorted(known), _COMPARED) if self._searches <= _SEARCHES else ()
        near = nearest(_plain(name), compared)
        advice = f"Did you mean {', '.join(near)}? " if near else ""
        return UnknownPath(
            text,
            remedy=f"{advice}Use an action that `discover` lists, or define this one in "
            "`[plans.actions]`.",
            details={"near": near} if near else None,
        )


def _names(entry: Entry) -> list[str]:
    """Return the names by which a plan may refer to the robot of an entry."""
    if entry.robot is not None:
        return [entry.robot]
    return [entry.owner.name, entry.tenant or ""]


def _plain(name: str) -> str:
    return name.lower().replace("-", "_")


def _last(entry: Entry) -> str:
    return entry.name.rpartition("/")[2]


def _assign(schema: dict[str, Any], given: deque[str], objects: dict[str, Any]) -> Any:
    """Build a value of a schema from arguments, in the order of its required fields."""
    defs = schema.get("$defs", {})
    if not given:
        return None
    node = _object_of(schema, defs)
    if node is None:
        return _single(_node(schema, defs), given.popleft(), objects)
    whole = objects.get(given[0]) if len(given) == 1 else None
    if is_map(whole) and whole.keys() <= node["properties"].keys():
        given.popleft()
        return whole
    return _fields(node, defs, given, objects, _DEEP)


def _fields(
    node: dict[str, Any],
    defs: dict[str, Any],
    given: deque[str],
    objects: dict[str, Any],
    deep: int,
) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for name in node.get("required") or node["properties"]:
        if not given:
            break
        field = node["properties"][name]
        inner = _object_of(field, defs)
        if inner is None or given[0] in objects or not deep:
            out[name] = _single(_node(field, defs), given.popleft(), objects)
        else:
            out[name] = _fields(inner, defs, given, objects, deep - 1)
    return out


def _single(node: dict[str, Any], text: str, objects: dict[str, Any]) -> Any:
    if text in objects:
        return objects[text]
    return text if node.get("type") == "string" or "enum" in node else word(text)


def _node(schema: dict[str, Any], defs: dict[str, Any]) -> dict[str, Any]:
    """Resolve references, and drop the null option."""
    options = [o for o in schema.get("anyOf", ()) if o.get("type") != "null"]
    if len(options) == 1:
        return _node(options[0], defs)
    reference: str = schema.get("$ref", "")
    return defs.get(reference.rpartition("/")[2], {}) if reference else schema


def _object_of(schema: dict[str, Any], defs: dict[str, Any]) -> dict[str, Any] | None:
    node = _node(schema, defs)
    return node if node.get("properties") else None
