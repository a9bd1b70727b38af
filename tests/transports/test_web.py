"""Controllers served by Litestar: exact paths, methods that are told, errors that are envelopes."""

from __future__ import annotations

import json
from typing import Any

import pytest
from litestar import Controller, delete, get
from litestar.di import NamedDependency, Provide
from litestar.params import FromPath
from litestar.types import ASGIApp

from rcp_kernel.errors import Forbidden
from rcp_web.application import Application, WebRequest, response, scope_of
from rcp_web.calls import call, parameters_of, query

pytestmark = pytest.mark.anyio
LIMIT = query("limit", {"type": "integer"}, "Items per page.")


class Things(Controller):
    path = "/rcp/things"

    @get(**call("List things.", LIMIT, responses={"200": {"description": "Things."}}))
    async def several(
        self, names: NamedDependency[tuple[str, ...]], request: WebRequest
    ) -> ASGIApp:
        told = {"names": names, "root": scope_of(request)["root_path"]}
        return response(200, json.dumps(told).encode())

    @get("/{id:str}", **call("Return a thing.", responses={}))
    async def one(self, id: FromPath[str]) -> ASGIApp:  # noqa: A002
        if id == "secret":
            raise Forbidden("not for you")
        if id == "broken":
            raise KeyError(id)
        return response(200, id.encode(), b"text/plain")

    @delete("/{id:str}", status_code=200, **call("Delete a thing.", responses={}))
    async def drop(self, id: FromPath[str]) -> ASGIApp:  # noqa: A002
        return response(204)


@pytest.fixture
def app() -> Application:
    def names(request: WebRequest) -> tuple[str, ...]:
        return parameters_of(request)

    return Application(
        [Things],
        dependencies={"names": Provide(names, sync_to_thread=False)},
        remedy="See the list.",
        described=True,
    )


async def ask(
    app: Application, path: str, method: str = "GET", root: str = ""
) -> tuple[int, dict[str, str], Any]:
    sent: list[Any] = []

    async def receive() -> Any:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(message: Any) -> None:
        sent.append(message)

    scope = {
        "type": "http",
        "method": method,
        "path": path,
        "raw_path": path.encode(),
        "query_string": b"",
        "headers": [],
        "root_path": root,
    }
    before = dict(scope)
    await app(scope, receive, send)
    assert scope == before
    head, *rest = sent
    headers = {key.decode(): value.decode() for key, value in head["headers"]}
    data = b"".join(message["body"] for message in rest)
    found = json.loads(data) if data and "json" in headers["content-type"] else data
    return head["status"], headers, found


@pytest.mark.parametrize(
    "path", ["/rcp/things/", "/rcp//things", "/rcp/things//a", "/rcp/things/a/", "/"]
)
async def test_a_path_is_served_as_it_is_routed_or_not_at_all(app: Application, path: str) -> None:
    status, _, told = await ask(app, path)
    assert (status, told["error"]["code"]) == (404, "unknown_path")
    assert told["error"]["remedy"] == "See the list."


async def test_what_precedes_the_path_is_not_taken_off_twice(app: Application) -> None:
    status, _, told = await ask(app, "/rcp/things", root="/rcp")
    assert (status, told["root"]) == (200, "/rcp")


async def test_a_method_that_is_not_supported_names_those_that_are(app: Application) -> None:
    status, headers, told = await ask(app, "/rcp/things/a", "PUT")
    assert (status, headers["allow"]) == (405, "GET, DELETE, HEAD, OPTIONS")
    assert told["error"]["details"] == {"allowed": ["GET", "DELETE", "HEAD", "OPTIONS"]}
    assert told["error"]["message"] == "/rcp/things/a does not support PUT"


async def test_options_names_them_too_without_a_body(app: Application) -> None:
    answer = await ask(app, "/rcp/things", "OPTIONS")
    assert answer == (204, {"allow": "GET, HEAD, OPTIONS"}, b"")
    _, headers, _ = await ask(app, "/rcp/things/a", "OPTIONS")
    assert headers["allow"] == "GET, DELETE, HEAD, OPTIONS"
    assert (await ask(app, "/rcp/nothing", "OPTIONS"))[0] == 404


async def test_head_is_a_get_whose_body_the_listener_leaves_out(app: Application) -> None:
    assert await ask(app, "/rcp/things/a", "HEAD") == await ask(app, "/rcp/things/a")


async def test_errors_are_envelopes_and_what_nobody_expected_is_internal(app: Application) -> None:
    status, _, told = await ask(app, "/rcp/things/secret")
    assert (status, told["error"]["message"]) == (403, "not for you")
    status, _, told = await ask(app, "/rcp/things/broken")
    assert (status, told["error"]["code"]) == (500, "internal")


async def test_parameters_are_declared_once_for_the_check_and_the_document(
    app: Application,
) -> None:
    _, _, told = await ask(app, "/rcp/things")
    assert told["names"] == ["limit"]
    found = app.paths()
    assert found.keys() == {"/rcp/things", "/rcp/things/{id}"}
    assert found["/rcp/things"]["get"]["parameters"] == [LIMIT]
    assert found["/rcp/things"]["get"]["summary"] == "List things."
    assert found["/rcp/things/{id}"].keys() == {"get", "delete"}
