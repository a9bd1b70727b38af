"""OpenAPI 3.1 of these calls and of every resource that the caller sees, with its own schemas."""

from __future__ import annotations

from typing import Any

import msgspec
from msgspec import Raw

from rcp_gateway.api import Query, Session
from rcp_gateway.client_api import ClientApi
from rcp_http.openapi_calls import ERROR, REPLY, direct
from rcp_http.openapi_responses import COMMAND, READ, refusals, responses
from rcp_kernel.model import Operation
from rcp_web.application import Application

__all__ = ["Described"]

Node = dict[str, Any]
_PAGE = 10  # resources described per step
_CONTEXT = "/rcp/v1/context"
_METHODS = {"get": Operation.READ, "put": Operation.WRITE, "post": Operation.EXECUTE}


def _written(node: Node) -> Raw:
    """Encode a part of the document: the whole would take too long for one loop iteration."""
    return Raw(msgspec.json.encode(node))


def _content(schema: Node) -> Node:
    return {"application/json": {"schema": schema}}


class Described:
    """Describes the resources that a session sees."""

    def __init__(self, client_api: ClientApi, calls: Application) -> None:
        self._client_api = client_api
        self._calls = calls

    async def part(self, session: Session) -> Node:
        """Return `paths` and `components` of the OpenAPI document."""
        turns, owner = self._client_api.turns, session.principal.identity
        schemas: Node = {"Reply": REPLY, "Error": ERROR}
        paths: Node = direct() | self._calls.paths()
        free = self._client_api.rights_of_anyone()
        proved = self._proofs()
        query: Query | None = Query(limit=_PAGE)
        while query is not None:
            page = await turns.finish(owner, self._client_api.discover(session, "/**", query))
            await turns.wait(owner)
            with turns.spending():
                for resource in page["resources"]:
                    allowed = 0 if free is None else free.compute_mask(resource["path"])
                    _describe(resource, paths, schemas, allowed, proved)
            cursor = page.get("cursor")
            query = None if cursor is None else Query(limit=_PAGE, cursor=cursor)
        found = {"schemas": schemas, "responses": {"202": _ACCEPTED} | responses()}
        return {"paths": paths, "components": found}

    def _proofs(self) -> list[Node]:
        proofs = self._client_api.proofs
        proved: list[Node] = [{"bearer": []}] if proofs.bearer else []
        return proved + ([{"certificate": []}] if proofs.certificates else [])


def _describe(resource: Node, paths: Node, schemas: Node, free: int, proved: list[Node]) -> None:
    """Describe one resource; `free` are the operations that need no authentication."""
    refs = {
        name: _component(resource["schema_ids"][name], schema, schemas)
        for name, schema in resource["schemas"].items()
    }
    item: Node = {}
    sent = refs.get("input", refs.get("value"))
    if (own := resource.get("command_schema")) is not None:  # what this caller may send
        sent = _component("command" + resource["path"].replace("/", "."), own, schemas)
    operations = resource["operations"]
    if "read" in operations:
        item["get"] = _operation(resource, "read", refs.get("value"), READ)
        item["get"]["responses"] |= _PARTS
    if "write" in operations:
        item["put"] = _operation(resource, "write", refs.get("value")) | {
            "requestBody": _body(sent, resource["examples"])
        }
    if "execute" in operations:
        item["post"] = _operation(resource, "execute", refs.get("output"))
        if "input" in refs:
            body = _body(sent, resource["examples"])
            body["required"] = not _takes_null(resource["schemas"]["input"])
            item["post"]["requestBody"] = body
        item["post"]["responses"]["202"] = {"$ref": "#/components/responses/202"}
    for method, operation in _METHODS.items():
        if method in item and not free & operation:
            item[method]["security"] = proved
    if item:
        paths[_CONTEXT + resource["path"]] = _written(item)


def _operation(
    resource: Node, name: str, schema: Node | None, statuses: tuple[int, ...] = COMMAND
) -> Node:
    body = {"$ref": "#/components/schemas/Reply"}
    whole: Node = body if schema is None else {"allOf": [body, {"properties": {"body": schema}}]}
    return {
        "operationId": f"{name}_{resource['path'].strip('/').replace('/', '_')}",
        "summary": resource["description"],
        "tags": [resource["kind"]],
        "responses": {"200": {"description": "The final reply.", "content": _content(whole)}}
        | refusals(statuses),
    }


def _takes_null(schema: Node) -> bool:
    """Return whether an input may be omitted: an absent body counts as null."""
    whole = schema
    if "$ref" in schema:
        whole = schema.get("$defs", {}).get(schema["$ref"].rpartition("/")[2], schema)
    kinds = whole.get("type", [])
    if kinds == "null" or "null" in kinds:
        return True
    choices = whole.get("anyOf") or whole.get("oneOf")
    if choices:
        return any(_takes_null(choice) for choice in choices)
    return not whole.keys() & {"type", "enum", "const", "allOf", "$ref"}


def _body(schema: Node | None, examples: list[Any]) -> Node:
    content: Node = {"schema": schema or {}}
    if examples:
        content["examples"] = {f"e{i}": {"value": value} for i, value in enumerate(examples, 1)}
    return {"required": True, "content": {"application/json": content}}


_ACCEPTED: Node = {
    "description": "Accepted and still running; `Location` is the command.",
    "headers": {"Location": {"required": True, "schema": {"type": "string"}}},
    "content": _content({"$ref": "#/components/schemas/Reply"}),
}
_PARTS: Node = {
    "206": {
        "description": "The part of a bytes value requested by `Range`.",
        "content": {"application/octet-stream": {}},
    },
    "304": {"description": "Not changed since the `ETag` in `If-None-Match`."},
}


def _component(id_: str, schema: Node, schemas: Node) -> Node:
    """Add a schema and its definitions to the components; return the reference to it."""
    if id_ not in schemas:
        place = f"#/components/schemas/{id_}."
        for name, inner in schema.get("$defs", {}).items():
            schemas[f"{id_}.{name}"] = _written(_moved(inner, place))
        whole = {key: item for key, item in schema.items() if key not in ("$defs", "$id")}
        schemas[id_] = _written(_moved(whole, place))
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
