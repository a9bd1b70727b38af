"""The values of a backend: typed when sent, checked when received, true on the device."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial
from typing import Any

from rcp_gateway.testing._client import Message
from rcp_gateway.testing._schemas import beyond, legal, same
from rcp_gateway.testing.backend._base import BackendTests, Robot, kind_of_resource, offers
from rcp_kernel.errors import RcpError
from rcp_kernel.model import Kind, Operation, Resource
from rcp_kernel.values import value_type

__all__ = ["ValueTests"]

_LASTING = 60.0  # s
_MAY_BE_EMPTY = (Kind.EVENT, Kind.ACTUATOR)  # nothing has happened yet, or been commanded


def _lasting(resource: Resource) -> dict[str, float]:
    """Let no dead-man act in between, on however slow a machine."""
    return {} if resource.valid_for is None else {"valid_for": _LASTING}


def _ignore(feedback: Any = None, *, fraction: float | None = None) -> None:
    """Ignore feedback."""


class ValueTests(BackendTests):
    """Tests of reads and writes."""

    async def test_what_can_be_read_arrives_typed_within_a_second(self, robot: Robot) -> None:
        for resource in robot.having(Operation.READ):
            reply = await robot.ask("read", resource.name, deadline=1.0)
            if reply["status"] != "completed" and kind_of_resource(resource) in _MAY_BE_EMPTY:
                assert reply["error"]["code"] == "adapter_unavailable", reply
                continue
            assert reply["status"] == "completed", reply
            value_type(resource.value).convert(reply["body"], resource.name)
        assert robot.faults == 0, robot.last_error

    async def test_nothing_but_typed_errors_escapes(self, robot: Robot) -> None:
        for resource in [*robot.resources.values()]:
            for call in self._calls(robot, resource):
                task = asyncio.ensure_future(call())
                await asyncio.wait([task], timeout=0.2)
                task.cancel()
                done, _ = await asyncio.wait([task], timeout=self.cancel_within)
                assert done, f"{resource.name} does not let itself be cancelled"
                error = None if task.cancelled() else task.exception()
                assert error is None or isinstance(error, RcpError), (resource.name, error)

    def _calls(self, robot: Robot, resource: Resource) -> list[Callable[[], Any]]:
        backend, name = robot.backend, resource.name
        calls: list[Callable[[], Any]] = []
        if offers(resource, Operation.READ):
            calls.append(partial(backend.read, name))
        if offers(resource, Operation.WRITE):
            type_ = value_type(resource.value)
            calls += [partial(backend.write, name, type_.convert(v)) for v in legal(type_.schema)]
        if offers(resource, Operation.EXECUTE):
            type_ = value_type(resource.input)
            inputs = [None] if resource.input is None else legal(type_.schema)
            calls += [partial(backend.execute, name, type_.convert(v), _ignore) for v in inputs]
        return calls

    async def test_a_write_changes_the_device(self, robot: Robot) -> None:
        for resource in robot.having(Operation.WRITE):
            name, seen = resource.name, list[Any]()
            for value in self.values(name)[:3]:
                reply = await robot.ask("write", name, body=value, **_lasting(resource))
                assert reply["status"] == "completed", reply
                truth = await self.typed_truth(resource)
                assert same(truth, reply["body"]), f"{name}: the device has {truth!r}"
                seen.append(truth)
            assert any(not same(a, seen[0]) for a in seen[1:]), f"{name} never changed: {seen!r}"

    async def test_a_write_is_what_is_read_after_it(self, robot: Robot) -> None:
        for resource in robot.having(Operation.WRITE):
            if resource not in robot.having(Operation.READ):
                continue
            written = await robot.ask("write", resource.name, body=self.values(resource.name)[0])
            read = await robot.ask("read", resource.name)
            assert read["status"] == written["status"] == "completed", (read, written)
            assert same(read["body"], written["body"]), (resource.name, read, written)

    async def test_what_is_out_of_range_is_refused_and_changes_nothing(self, robot: Robot) -> None:
        for resource in robot.having(Operation.WRITE):
            value = self.values(resource.name)[0]
            await robot.ask("write", resource.name, body=value, **_lasting(resource))
            before = await self.typed_truth(resource)
            for value in beyond(value_type(resource.value).schema):
                reply = await robot.ask("write", resource.name, body=value)
                assert reply["error"]["code"] == "out_of_range", (resource.name, value, reply)
            reply = await robot.ask("write", resource.name, body={"no": ["such", "value"]})
            assert reply["error"]["code"] == "invalid_value", (resource.name, reply)
            after = await self.typed_truth(resource)
            assert same(before, after), f"{resource.name} went from {before!r} to {after!r}"

    async def test_what_is_written_as_one_is_in_force_as_a_whole(self, robot: Robot) -> None:
        for group in self.groups():
            for values in self._settings(group):
                reply = await self._write_together(robot, values)
                assert reply["status"] == "completed", reply
                for resource, item in zip(group, reply["body"], strict=True):
                    truth = await self.typed_truth(resource)
                    assert same(truth, item["body"]), f"{resource.name}: the device has {truth!r}"

    async def test_one_that_the_device_refuses_keeps_the_others_from_it(self, robot: Robot) -> None:
        for group in self.groups():
            still, other = self._settings(group)
            reply = await self._write_together(robot, still)
            assert reply["status"] == "completed", reply
            before = [await self.typed_truth(resource) for resource in group]
            for refused in (group[1], group[0]):
                async with self.refusing(refused.name):
                    reply = await self._write_together(robot, other)
                assert reply["status"] in ("failed", "rejected"), reply
                after = [await self.typed_truth(resource) for resource in group]
                assert same(before, after), f"{refused.name} refused: {before!r} to {after!r}"
            reply = await self._write_together(robot, other)
            assert reply["status"] == "completed", reply

    def _settings(self, group: list[Resource]) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return two settings of a group: one that lasts without being repeated, and another."""
        first, second = dict[str, Any](), dict[str, Any]()
        for resource in group:
            values = self.values(resource.name)
            has_rest = resource.safe is not None
            first[resource.name] = self.safe(resource) if has_rest else values[0]
            second[resource.name] = self.unsafe(resource) if has_rest else values[1]
        return first, second

    async def _write_together(self, robot: Robot, values: dict[str, Any]) -> Message:
        limited = any(robot.resources[name].safe is not None for name in values)
        # No dead-man may act in between, on however slow a machine.
        lasting: dict[str, Any] = {"valid_for": _LASTING} if limited else {}
        body = {robot.path(name): value for name, value in values.items()}
        return await robot.client.request("write", body=body, **lasting)
