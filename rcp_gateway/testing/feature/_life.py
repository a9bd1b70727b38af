"""Requirements of every feature: it starts, shows resources by right, and cleans up."""

from __future__ import annotations

import asyncio
import gc
from typing import Any

import pytest

from rcp_gateway.testing._client import Message
from rcp_gateway.testing._suite import eventually, proves
from rcp_gateway.testing.feature._rig import FeatureGateway, FeatureRig, error_code
from rcp_kernel.errors import ConfigError
from rcp_kernel.features import SystemResource
from rcp_kernel.model import Operation

__all__ = ["LifeTests"]


def _resources(gateway: FeatureGateway, name: str) -> list[SystemResource]:
    return gateway.served.server.gateway.features.resources_of(name)


class LifeTests(FeatureRig):
    """Tests of opening, closing and views."""

    @proves("feature.life")
    async def test_it_opens_twice_in_a_row_and_leaves_no_task_behind(self) -> None:
        async with self.opened():
            pass
        gc.collect()
        before = asyncio.all_tasks()
        async with self.opened():
            pass

        async def gone() -> bool:
            gc.collect()
            return not asyncio.all_tasks() - before

        await eventually(gone, "every task has ended")

    @proves("feature.config")
    async def test_an_unknown_key_in_its_table_is_refused_by_name(
        self, gateway: FeatureGateway
    ) -> None:
        if self.kind.table is not None:
            pytest.skip("its keys are in other tables")
        with pytest.raises(ConfigError, match="no_such_key"):
            self.features(gateway.config, {**self.options, "no_such_key": 1})

    @proves("feature.shows")
    async def test_each_resource_is_read_and_subscribed_to_with_the_type_it_declares(
        self, gateway: FeatureGateway
    ) -> None:
        for own in _resources(gateway, self.kind.name):
            entry = gateway.served.server.gateway.registry.entries[own.path]
            if entry.operations & Operation.READ:
                reply = await gateway.admin.request("read", own.path)
                assert reply["status"] == "completed", reply
                entry.value_type.convert(reply["body"])
            if entry.operations & Operation.SUBSCRIBE and own.view is not None:
                id_ = await gateway.admin.subscribe(own.path)
                update = await gateway.admin.update(id_)
                entry.value_type.convert(update["body"])

    @proves("feature.rights")
    async def test_nothing_of_it_is_seen_without_a_right(self, gateway: FeatureGateway) -> None:
        for own in _resources(gateway, self.kind.name):
            for type_ in ("read", "subscribe", "execute"):
                reply = await gateway.viewer.request(type_, own.path, body={})
                assert error_code(reply) in ("unknown_path", "forbidden"), reply

    @proves("feature.services")
    async def test_a_dry_run_of_each_example_changes_nothing_it_shows(
        self, gateway: FeatureGateway
    ) -> None:
        for own in _resources(gateway, self.kind.name):
            if own.execute is None:
                continue
            before = await self._shown(gateway, own)
            for example in own.resource.examples:
                reply = await gateway.admin.request("execute", own.path, body=example, dry_run=True)
                assert error_code(reply) != "internal", reply
            assert await self._shown(gateway, own) == before

    @proves("feature.services")
    async def test_input_that_does_not_fit_is_refused(self, gateway: FeatureGateway) -> None:
        for own in _resources(gateway, self.kind.name):
            if own.execute is not None and own.resource.input is not None:
                body = {"no_such_field": object.__name__}
                reply: Message = await gateway.admin.request("execute", own.path, body=body)
                assert error_code(reply) in ("invalid_value", "bad_request"), reply

    async def _shown(self, gateway: FeatureGateway, own: SystemResource) -> Any:
        if own.view is None:
            return None
        return (await gateway.admin.request("read", own.path))["body"]
