"""The streams of a backend: they start at once, end without subscribers, and are independent."""

from __future__ import annotations

from rcp_gateway.testing.backend._base import BackendTests, Robot
from rcp_kernel.model import Kind, Operation
from rcp_kernel.values import value_type
from rcp_protocol.timeouts import timeout

__all__ = ["StreamTests"]

_QUIET = 0.3  # s in which nothing may be published any more
_SETTLE = 1.0  # s for a source to stop


class StreamTests(BackendTests):
    """Tests of subscriptions."""

    async def test_a_subscriber_has_a_typed_first_value(self, robot: Robot) -> None:
        for resource in robot.having(Operation.SUBSCRIBE, Kind.SENSOR):
            id_ = await robot.client.subscribe(robot.path(resource.name))
            update = await robot.client.update(id_, self.first_within)
            value_type(resource.value).convert(update["body"], resource.name)
            await robot.client.request("unsubscribe", body={"subscription": id_})
        assert robot.faults == 0, robot.last_error

    async def test_a_param_that_is_written_reaches_its_subscribers(self, robot: Robot) -> None:
        for resource in robot.having(Operation.SUBSCRIBE, Kind.PARAM):
            if resource not in robot.having(Operation.WRITE):
                continue
            id_ = await robot.client.subscribe(robot.path(resource.name), initial=False)
            written = await robot.ask("write", resource.name, body=self.values(resource.name)[0])
            await robot.client.until(
                lambda m, i=id_, w=written: m.get("id") == i and m.get("body") == w["body"]
            )

    async def test_leaving_ends_the_production_of_what_is_not_live(self, robot: Robot) -> None:
        host = robot.served.life.host
        for resource in robot.having(Operation.SUBSCRIBE, Kind.SENSOR):
            if resource.live:
                continue
            id_ = await robot.client.subscribe(robot.path(resource.name))
            await robot.client.update(id_, self.first_within)
            await robot.client.request("unsubscribe", body={"subscription": id_})
            try:
                async with timeout(_SETTLE):
                    while await host.publishes(resource.name, _QUIET):
                        pass
            except TimeoutError:
                raise AssertionError(f"{resource.name} goes on though nobody looks") from None

    async def test_a_stalled_subscriber_delays_no_other(self, robot: Robot) -> None:
        for resource in robot.having(Operation.SUBSCRIBE, Kind.SENSOR)[:3]:
            stalled, client = robot.served.client(), robot.served.client()
            await stalled.subscribe(robot.path(resource.name))
            stalled.pause()
            id_ = await client.subscribe(robot.path(resource.name))
            seq = (await client.update(id_, self.first_within))["seq"]
            if await robot.served.life.host.publishes(resource.name, _QUIET):
                assert (await client.update(id_))["seq"] > seq
            await stalled.close()
            await client.close()
