"""The declarations of a backend: paths, types with units, and operations."""

from __future__ import annotations

from typing import Any

from rcp_gateway.testing._schemas import numbers_without_unit
from rcp_gateway.testing.backend._base import BackendTests, Robot, offers
from rcp_kernel.model import Kind, Operation, Resource, operation_names
from rcp_kernel.values import ValueType, value_type

__all__ = ["TreeTests"]

_CALLS = {
    Operation.READ: "read",
    Operation.WRITE: "write",
    Operation.EXECUTE: "execute",
    Operation.SUBSCRIBE: "subscribe",
}


def _types(resource: Resource) -> list[tuple[str, ValueType]]:
    declared: list[tuple[str, Any]] = [
        ("value", resource.value),
        ("input", resource.input),
        ("output", resource.output),
        ("feedback", resource.feedback),
    ]
    return [(part, value_type(type_)) for part, type_ in declared if type_ is not None]


class TreeTests(BackendTests):
    """Tests of discovery against the actual behaviour."""

    async def test_its_paths_are_legal_and_its_own(self, robot: Robot) -> None:
        found = await robot.client.request("discover", body={"limit": 1000})
        holds = sum(entry.is_hold for entry in robot.served.supervisor.entries.values())
        assert len(found["body"]["resources"]) == min(1000, len(robot.resources) + holds)
        for name, resource in robot.resources.items():
            assert name == resource.name
            assert name.partition("/")[0] in set(Kind)

    async def test_its_schemas_are_schemas(self, robot: Robot) -> None:
        for name, resource in robot.resources.items():
            for part, type_ in _types(resource):
                schema = type_.schema
                assert schema["$id"].startswith("rcp:schema:"), f"{part} of {name}"
                _check_schema(schema)

    async def test_its_numbers_have_units(self, robot: Robot) -> None:
        bare = [
            f"{name}: {part} {place}"
            for name, resource in robot.resources.items()
            for part, type_ in _types(resource)
            for place in numbers_without_unit(type_.schema)
        ]
        assert not bare, f"say the unit, as quantity('m/s') or quantity('1'), of {bare}"

    async def test_it_refuses_what_it_does_not_offer(self, robot: Robot) -> None:
        for name, resource in robot.resources.items():
            for operation, type_ in _CALLS.items():
                if offers(resource, operation):
                    continue
                reply = await robot.ask(type_, name)
                assert reply["error"]["code"] == "unsupported_operation", (type_, name)
                allowed = reply["error"]["details"]["allowed"]
                assert type_ not in allowed
                assert set(allowed) <= set(operation_names(Operation(31)))

    async def test_it_knows_no_other_paths(self, robot: Robot) -> None:
        for type_ in ("read", "write", "execute"):
            reply = await robot.ask(type_, "sensor/of.nobody")
            assert reply["error"]["code"] == "unknown_path"

    async def test_an_actuator_that_moves_has_a_safe_value(self, robot: Robot) -> None:
        for resource in robot.having(Operation.WRITE, Kind.ACTUATOR):
            assert resource.safe is not None or resource.valid_for is None, resource.name


def _check_schema(schema: dict[str, Any]) -> None:
    """Check a schema against the standard, if the library for that is installed."""
    try:
        import jsonschema
    except ImportError:
        return
    jsonschema.Draft202012Validator.check_schema(schema)
