"""Health: the report, readiness and the Prometheus exposition say what is."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from prometheus_client.parser import text_string_to_metric_families
from structlog.testing import capture_logs

from configuration import backend, key
from kernel.world import CONFIG, World, world_of
from rcp_gateway.backend_status import BackendStatus
from rcp_kernel.config.file import BackendConfig
from steps import finished

pytestmark = pytest.mark.anyio


async def test_the_report_counts_what_there_is(world: World) -> None:
    client = world.client()
    await client.ask(type="subscribe", path="/sensor/level")
    world.robot.release.set()
    await client.ask(type="execute", path="/action/go", body=1)
    await client.ask(type="execute", path="/action/go", body=13)
    report = (await client.ask(type="status"))["body"]
    assert report["state"] == "ok"
    assert (report["sessions"], report["subscriptions"]) == (1, 1)
    assert (report["commands"]["completed"], report["commands"]["failed"]) == (1, 1)
    assert report["process"]["rss"] > 0
    backend = report["backends"][0]
    assert (backend["name"], backend["tenant"], backend["state"]) == ("robot", "alpha", "ready")
    world.robot.host.report("weak signal")
    assert (await client.ask(type="status"))["body"]["state"] == "degraded"
    world.robot.host.report("no signal", down=True)
    report = (await client.ask(type="status"))["body"]
    assert report["state"] == "down"
    assert any("no signal" in str(record["facts"]) for record in report["warnings"])


async def test_a_watched_status_comes_at_its_rate(world: World) -> None:
    client = world.client()
    id_ = client.send(type="subscribe", path="/system/status", body={"rate": 10})
    first, second = await client.update(id_), await client.update(id_)
    assert second["body"]["uptime"] > first["body"]["uptime"]


async def test_a_warning_is_an_event(world: World) -> None:
    client = world.client("admin-admin-admin")
    await client.ask(type="subscribe", id="log", path="/system/log")
    world.robot.host.report("weak signal")
    update = await client.update("log")
    assert (update["body"]["level"], update["body"]["facts"]["detail"]) == (
        "warning",
        "weak signal",
    )


async def test_every_metric_of_the_contract_is_there_and_counts(world: World) -> None:
    client = world.client()
    world.robot.host.publish("sensor/level", 1.0)
    await client.ask(type="subscribe", path="/sensor/level")
    await client.ask(type="read", path="/sensor/level")
    await client.ask(type="read", path="/sensor/nothing")
    session = world.client().connection.session
    text = finished(world.server.client_api.metrics(session)).decode()
    families = {family.name: family for family in text_string_to_metric_families(text)}
    for name in (
        "rcp_build_info", "rcp_uptime_seconds", "rcp_backend_up", "rcp_requests",
        "rcp_request_seconds", "rcp_samples", "rcp_updates", "rcp_dropped", "rcp_sessions",
        "rcp_subscriptions", "rcp_commands", "rcp_command_seconds", "rcp_queue_depth",
        "rcp_event_loop_lag_seconds", "rcp_resource_age_seconds", "process_resident_memory_bytes",
    ):  # fmt: skip
        assert name in families, name
    requests = {
        (s.labels["type"], s.labels["code"]): s.value
        for s in families["rcp_requests"].samples
        if s.name == "rcp_requests_total"
    }
    assert requests["read", "ok"] == 1
    assert requests["read", "unknown_path"] == 1
    up = families["rcp_backend_up"].samples[0]
    assert (up.labels, up.value) == ({"backend": "robot", "tenant": "alpha"}, 1.0)
    count = [s.value for s in families["rcp_request_seconds"].samples if s.name.endswith("_count")]
    assert count == [3.0]
    ages = families["rcp_resource_age_seconds"].samples
    assert [s.labels["path"] for s in ages] == ["/tenant/alpha/sensor/level"]


async def test_a_watched_status_shows_only_the_tenants_one_acts_in() -> None:
    text = CONFIG + (
        backend("secret", "beta")
        + key("a", "alpha-only-alpha-only", role="operator", tenants=["alpha"])
    )
    async with world_of(text) as world:
        client = world.client("alpha-only-alpha-only")
        id_ = client.send(type="subscribe", path="/system/status")
        report = (await client.update(id_))["body"]
        assert [backend["name"] for backend in report["backends"]] == ["robot"]
        commands = client.send(type="subscribe", path="/system/commands")
        assert (await client.update(commands))["body"] == []


def test_the_first_fault_is_logged_on_a_machine_that_has_just_booted(
    boot: Callable[[], None],
) -> None:
    status = BackendStatus(BackendConfig(use="sim", name="robot", tenant="alpha"))
    boot()
    with capture_logs() as logs:
        for _ in range(3):
            status.fault("not a number")
    assert [(one["event"], one["faults"]) for one in logs] == [("backend_fault", 1)]
