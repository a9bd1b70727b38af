"""The gRPC binding admits calls as the others do, and never sends tokens in the clear to others."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import grpc
import grpc.aio
import pytest
from a2a.types import a2a_pb2_grpc
from a2a.types.a2a_pb2 import GetTaskRequest, Message, Part, Role, SendMessageRequest, TaskState

from plugins.a2a.agent import agent, caller
from rcp_a2a.config import A2aConfig, GrpcConfig, check
from rcp_kernel.errors import ConfigError
from transports.robot import BOUND, KEY, Site

pytestmark = pytest.mark.anyio


@asynccontextmanager
async def stub(site: Site) -> AsyncGenerator[Any]:
    """Call the port that the card names."""
    async with caller(site) as client:
        card = (await client.get("/.well-known/agent-card.json")).json()
    (binding,) = [i for i in card["supportedInterfaces"] if i["protocolBinding"] == "GRPC"]
    async with grpc.aio.insecure_channel(binding["url"]) as channel:
        yield a2a_pb2_grpc.A2AServiceStub(channel)


def message(text: str, **fields: Any) -> SendMessageRequest:
    part = Part(text=text)
    made = Message(message_id=text, role=Role.ROLE_USER, parts=[part])
    return SendMessageRequest(message=made, **fields)


def key(given: str) -> tuple[tuple[str, str], ...]:
    return (("authorization", f"Bearer {given}"),)


async def test_calls_are_admitted_as_over_http() -> None:
    async with agent("[plugins.a2a.grpc]\nport = 0") as site, stub(site) as calls:
        done = await calls.SendMessage(
            message("execute /service/add 1", tenant="alpha"), metadata=key(KEY), timeout=BOUND
        )
        assert done.task.status.state == TaskState.TASK_STATE_COMPLETED
        for metadata, request, code in (
            (key("wrong-key-of-nobody"), message("a"), grpc.StatusCode.UNAUTHENTICATED),
            ((("authorization", "Basic a"),), message("a"), grpc.StatusCode.INVALID_ARGUMENT),
            (
                key("key-of-tenant-beta"),
                message("a", tenant="alpha"),
                grpc.StatusCode.PERMISSION_DENIED,
            ),
            (
                key("key-of-tenant-beta"),
                message(f'{{"a": {[0] * 2000}}}'),
                grpc.StatusCode.RESOURCE_EXHAUSTED,
            ),
        ):
            with pytest.raises(grpc.aio.AioRpcError) as refused:
                await calls.SendMessage(request, metadata=metadata, timeout=BOUND)
            assert refused.value.code() is code, refused.value
        with pytest.raises(grpc.aio.AioRpcError) as hidden:
            await calls.GetTask(
                GetTaskRequest(id=done.task.id), metadata=key("key-of-tenant-beta"), timeout=BOUND
            )
        assert hidden.value.code() is grpc.StatusCode.NOT_FOUND
        assert len(site.robot.ran) == 1


async def test_a_stop_over_grpc_stops_and_waits_for_no_quota() -> None:
    more = "[quotas.principal]\nrequests = 0.01\nburst = 1\n"
    async with agent("[plugins.a2a.grpc]\nport = 0", more) as site, stub(site) as calls:
        for number in range(3):
            stopped = await calls.SendMessage(
                message(f'execute /system/estop {{"reason": "{number}"}}', tenant="alpha"),
                metadata=key(KEY),
                timeout=BOUND,
            )
            assert stopped.task.status.state == TaskState.TASK_STATE_COMPLETED


@pytest.mark.parametrize(
    "table",
    [{"host": "0.0.0.0"}, {"host": "robots.example"}, {"certificate": "a.pem"}, {"key": "a.pem"}],
)
def test_tokens_are_not_sent_in_the_clear(table: dict[str, Any]) -> None:
    with pytest.raises(ConfigError):
        check(A2aConfig(grpc=GrpcConfig(**table)))
    check(A2aConfig(grpc=GrpcConfig(host="localhost")))
    check(A2aConfig(grpc=GrpcConfig(host="0.0.0.0", certificate="a.pem", key="b.pem")))
