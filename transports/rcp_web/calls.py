"""Declarations of parameters and responses, for checking queries and for OpenAPI."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

from litestar import Request
from litestar.openapi.spec import Operation

__all__ = ["Node", "call", "parameters_of", "query"]

Node = dict[str, Any]
_OPTION = "parameters"


def query(name: str, schema: Node, text: str, *, required: bool = False) -> Node:
    """Declare a query parameter."""
    found: Node = {"name": name, "in": "query", "schema": schema, "description": text}
    return found | {"required": True} if required else found


def call(summary: str, *parameters: Node, responses: Node, body: Node | None = None) -> Any:
    """Return the keyword arguments of a handler: `@get("/schemas", **call(…))`."""

    @dataclass
    class Declared(Operation):
        """An operation whose parameters this package parses, unknown to Litestar."""

        def __post_init__(self) -> None:
            self.parameters = cast("Any", list(parameters))
            self.responses = responses
            self.deprecated = cast("Any", None)
            self.request_body = cast("Any", body)

    names = tuple(one["name"] for one in parameters if one["in"] == "query")
    return {"summary": summary, "operation_class": Declared, "opt": {_OPTION: names}}


def parameters_of(request: Request[Any, Any, Any]) -> tuple[str, ...]:
    """Return the names of the query parameters declared for a request's handler."""
    return request.route_handler.opt.get(_OPTION, ())
