"""OpenAPI 3.1 of these calls and of every resource that the caller sees, with its own schemas."""

from __future__ import annotations

from typing import Any

from rcp_http.openapi_calls import ERROR, REFUSED, REPLY, calls
from rcp_kernel.clients.session import Session
from rcp_kernel.door import Door
from rcp_kernel.operations.discovery import Query

__all__ = ["Described"]

Node = dict[str, Any]
_PAGE = 1000
_CONTEXT = "/rcp/v1/context"


class Described:
    """Describes what a session sees; the last description is kept until the tree changes."""

    def __init__(self, door: Door) -> None:
        self._door = door
        self._known: tuple[Any, Node] | None = None

    def part(self, session: Session) -> Node:
        """Return `paths` and `components` of the OpenAPI document."""
        key = (self._door.generation(session), session.rights)
        if self._known is None or self._known[0] != key:
            self._known = key, self._make(session)
        return self._known[1]

    def _make(self, session: Session) -> Node:
        schemas: Node = {"Reply": REPLY, "Error": ERROR}
        paths: Node = calls()
        cursor: str | None = None
        while True:
            page = self._door.discover(session, "/**", Query(limit=_PAGE, cursor=cursor))
            for resource in page["resources"]:
                _describe(resource, paths, schemas)
            cursor = page.get("cursor")
            if cursor is None:
                return {"paths": paths, "components": {"schemas": schemas}}


def _describe(resource: Node, paths: Node, schemas: Node) -> None:
    refs = {
        name: _component(resource["schema_ids"][name], schema, schemas)
        for name, schema in resource["schemas"].items()
    }
    item: Node = {}
    operations = resource["operations"]
    if "read" in operations:
        item["get"] = _operation(resource, "read", refs.get("value"))
    if "write" in operations:
        item["put"] = _operation(resource, "write", refs.get("value")) | {
            "requestBody": _body(refs.get("value"), resource["examples"])
        }
    if "execute" in operations:
        item["post"] = _operation(resource, "execute", refs.get("output"))
        if "input" in refs:
            item["post"]["requestBody"] = _body(refs["input"], resource["examples"])
        item["post"]["responses"]["202"] = {
            "description": "Accepted, and not at its end yet; `Location` names the command.",
            "content": _content({"$ref": "#/components/schemas/Reply"}),
        }
    if item:
        paths[_CONTEXT + resource["path"]] = item


def _operation(resource: Node, name: str, schema: Node | None) -> Node:
    body = {"$ref": "#/components/schemas/Reply"}
    whole: Node = body if schema is None else {"allOf": [body, {"properties": {"body": schema}}]}
    return {
        "operationId": f"{name}_{resource['path'].strip('/').replace('/', '_')}",
        "summary": resource["description"],
        "tags": [resource["kind"]],
        "responses": {
            "200": {"description": "The final reply.", "content": _content(whole)},
            "default": {
                "description": REFUSED,
                "content": _content({"$ref": "#/components/schemas/Reply"}),
            },
        },
    }


def _content(schema: Node) -> Node:
    return {"application/json": {"schema": schema}}


def _body(schema: Node | None, examples: list[Any]) -> Node:
    content: Node = {"schema": schema or {}}
    if examples:
        content["examples"] = {f"e{i}": {"value": value} for i, value in enumerate(examples, 1)}
    return {"required": True, "content": {"application/json": content}}


def _component(id_: str, schema: Node, schemas: Node) -> Node:
    """Put a schema and its definitions among the components; return the reference to it."""
    if id_ not in schemas:
        place = f"#/components/schemas/{id_}."
        for name, inner in schema.get("$defs", {}).items():
            schemas[f"{id_}.{name}"] = _moved(inner, place)
        whole = {key: item for key, item in schema.items() if key not in ("$defs", "$id")}
        schemas[id_] = _moved(whole, place)
    return {"$ref": f"#/components/schemas/{id_}"}


def _moved(node: Any, place: str) -> Any:
    if isinstance(node, list):
        return [_moved(item, place) for item in node]  # pyright: ignore[reportUnknownVariableType]
    if not isinstance(node, dict):
        return node
    return {
        key: place + item.removeprefix("#/$defs/") if key == "$ref" else _moved(item, place)
        for key, item in node.items()  # pyright: ignore[reportUnknownVariableType]
    }
