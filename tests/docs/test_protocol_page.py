"""The fields, options, codes and metrics that the protocol's page tells are those of the code."""

from __future__ import annotations

import asyncio
from typing import Any, get_args

import msgspec
import pytest

from docs.pages import DOCS, keys, rows, section
from kernel.world import features_of
from rcp_approvals import ApprovalRequest
from rcp_gateway.gateway import Gateway
from rcp_gateway.log import Recent
from rcp_gateway.system import EstopRequest
from rcp_kernel.access.acl import Rights
from rcp_kernel.clock import SYSTEM_CLOCK
from rcp_kernel.config.file import GatewayConfig
from rcp_kernel.errors import BY_CODE
from rcp_kernel.model import BRANCHES, Policy, operation_names
from rcp_kernel.sessions.hello import Hello
from rcp_kernel.wire import Reply, Request, RequestType, Status
from rcp_leases import LeaseRequest
from rcp_requests.discovery import Query
from rcp_requests.read_options import ReadOptions
from rcp_store.store import Store
from rcp_streams.options import Options, Qos
from steps import finished

PAGE = DOCS / "protocol.md"


def fields(type_: Any) -> set[str]:
    return {f.encode_name for f in msgspec.structs.fields(type_)}


@pytest.mark.parametrize(
    ("heading", "type_"),
    [
        ("Read", ReadOptions),
        ("Options", Options),
        ("Quality of service", Qos),
        ("Discover", Query),
        ("E-stop", EstopRequest),
        ("Leases", LeaseRequest),
        ("Approvals", ApprovalRequest),
    ],
)
def test_a_table_has_every_field_of_its_type(heading: str, type_: Any) -> None:
    assert set(keys(section(PAGE, heading))) == fields(type_)


def test_the_request_table_is_the_envelope() -> None:
    documented = set(keys(section(PAGE, "Request")))
    assert documented == fields(Request) - {"x-", "~encoding"} | {"x-…"}


def test_every_request_type_is_told() -> None:
    row = next(row for row in rows(section(PAGE, "Request")) if row[0] == "`type`")
    assert row[1].replace("`", "").split() == list(get_args(RequestType))


def test_the_reply_table_is_the_envelope() -> None:
    assert set(keys(section(PAGE, "Reply"))) == fields(Reply) - {"x-"}


def test_every_status_is_told() -> None:
    row = next(row for row in rows(section(PAGE, "Reply")) if row[0] == "`status`")
    assert all(f"`{status}`" in row[1] for status in get_args(Status))


def test_hello_tells_its_fields() -> None:
    request = section(PAGE, "Sessions").split("The reply's body:")[0]
    assert set(keys(request)) == fields(Hello)


def test_the_error_table_is_that_of_the_code() -> None:
    cells = rows(section(PAGE, "Errors"))
    documented = {c[0].strip("`"): (int(c[1]), c[2], c[3] == "yes") for c in cells}
    assert len(documented) == len(cells)
    assert documented == {code: (e.http, e.status, e.retryable) for code, e in BY_CODE.items()}


def test_the_branches_are_told_with_their_operations() -> None:
    for row in rows(section(PAGE, "Paths")):
        operations = BRANCHES[row[0].strip("`")]  # pyright: ignore[reportArgumentType]
        assert {w for w in operation_names(operations) if w in row[2]} == set(
            operation_names(operations)
        )
    assert keys(section(PAGE, "Paths")) == [str(kind) for kind in BRANCHES]


def test_every_policy_is_told() -> None:
    assert set(keys(section(PAGE, "Execute and cancel"))) == set(get_args(Policy))


async def test_the_system_branch_and_the_metrics_are_told() -> None:
    loop = asyncio.get_running_loop()
    config = GatewayConfig()
    features = features_of(config)
    gateway = Gateway(
        config, loop, store=Store(), recent=Recent(), clock=SYSTEM_CLOCK, features=features
    )
    documented = {row[0].strip("`"): row[1] for row in rows(section(PAGE, "System branch"))}
    assert documented == {
        path: ", ".join(sorted(operation_names(entry.operations), key=_told_order))
        for path, entry in gateway.registry.entries.items()
    }
    text = finished(gateway.exposition.write(Rights((), {})))
    families = {m.split("# TYPE ")[1].split()[0] for m in _types(text)}
    assert set(keys(section(PAGE, "Health and metrics"))) - families == set()
    assert {name for name in families if name.startswith("rcp_")} == {
        name for name in keys(section(PAGE, "Health and metrics")) if name.startswith("rcp_")
    }


def _told_order(operation: str) -> int:
    return ["read", "write", "subscribe", "execute"].index(operation)


def _types(text: bytes) -> list[str]:
    return [line for line in text.decode().splitlines() if line.startswith("# TYPE ")]
