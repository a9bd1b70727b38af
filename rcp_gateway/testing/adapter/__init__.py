"""The adapter suite: clients of an adapter see what they may see, and no more."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import AsyncGenerator, Mapping
from contextlib import asynccontextmanager
from typing import Any, ClassVar

import msgspec
import pytest

from rcp_gateway.client_kinds import AdapterKind
from rcp_gateway.testing._serve import OPERATOR, Served, serve
from rcp_gateway.testing._suite import BOUND, Suite, eventually, proves
from rcp_kernel.config.file import decode_table, parse
from rcp_kernel.errors import ConfigError
from rcp_kernel.model import Resource
from rcp_kernel.spi import BackendKind, BaseBackend, Host
from rcp_protocol.timeouts import timeout

__all__ = ["AdapterGateway", "AdapterSuite"]

_OUTSIDER = "outsider-of-the-test-kit"
_CONFIG = f"""
anonymous = false

[transports]
http = false
ws = false
sse = false

[transports.asgi]
port = 0

[[backends]]
use = "robot"
name = "robot"
tenant = "t"

[roles.outsider]
deny = [{{ operations = ["discover"], paths = ["/sensor/secret"] }}]

[[keys]]
name = "operator"
role = "operator"
key = "{OPERATOR}"

[[keys]]
name = "outsider"
role = ["operator", "outsider"]
key = "{_OUTSIDER}"
"""


class _NoOptions(msgspec.Struct):
    """The robot has nothing to configure."""


class _Robot(BaseBackend):
    """Has one public value, and one that is hidden from one principal."""

    def __init__(self, host: Host) -> None:
        host.declare(
            Resource(name="sensor/level", description="A level.", value=float, live=True),
            Resource(name="sensor/secret", description="A secret.", value=str, live=True),
        )
        host.publish("sensor/level", 42.5)
        host.publish("sensor/secret", "classified")


@asynccontextmanager
async def _open_robot(_config: _NoOptions, host: Host) -> AsyncGenerator[_Robot]:
    yield _Robot(host)


class AdapterGateway:
    """A gateway with the adapter under test."""

    def __init__(self, served: Served) -> None:
        self.served = served

    @property
    def url(self) -> str:
        """The URL of the gateway's listener."""
        return next(f["url"] for f in self.served.server.status.transports if "url" in f)

    def withdraw_keys(self) -> None:
        """Revoke all keys, as a reload of the configuration does."""
        kernel = self.served.server.gateway
        kernel.reconfigure(msgspec.structs.replace(kernel.settings.config, keys=()))


class AdapterSuite(Suite):
    """The tests of an adapter.

    Give `kind` (and `options`), and how a client of it looks at the tree::

        class TestText(AdapterSuite):
            kind = rcp_text.TEXT

            async def look(self, url: str, token: str) -> str:
                async with httpx.AsyncClient(headers={"Authorization": f"Bearer {token}"}) as http:
                    return (await http.get(f"{url}/text")).text
    """

    kind: ClassVar[AdapterKind]
    """The adapter under test."""
    options: ClassVar[Mapping[str, Any]] = {}
    """Its table `[plugins.<name>]`."""

    async def look(self, url: str, token: str) -> str:
        """Return all that the adapter shows a client with this key, a refusal too, as text.

        A gateway listens at `url`; its robot has `sensor/level` with the value 42.5.
        """
        raise NotImplementedError

    @asynccontextmanager
    async def opened(self) -> AsyncGenerator[AdapterGateway]:
        """Run a gateway with the adapter."""
        table = {self.kind.name: dict(self.options)}
        config = msgspec.structs.replace(parse(_CONFIG, "test"), plugins=table)
        robot = BackendKind("robot", _NoOptions, _open_robot)
        async with serve(config, robot, adapters=(self.kind,)) as served:
            async with timeout(BOUND):  # a busy machine opens to clients before
                await served.supervisor.settled.wait()
            yield AdapterGateway(served)

    @pytest.fixture
    async def gateway(self) -> AsyncGenerator[AdapterGateway]:
        """A gateway with the adapter, for one test."""
        async with self.opened() as opened:
            yield opened

    @proves("adapter.shows")
    async def test_a_client_is_shown_what_it_may_read(self, gateway: AdapterGateway) -> None:
        """Check that the values of the tree are shown."""
        shown = await self.look(gateway.url, OPERATOR)
        assert "level" in shown
        assert "secret" in shown

    @proves("adapter.rights")
    async def test_what_is_hidden_from_a_client_is_nowhere(self, gateway: AdapterGateway) -> None:
        """Check that neither its path nor its value is shown, to the second caller either."""
        await self.look(gateway.url, OPERATOR)  # no reply may be reused for another caller
        shown = await self.look(gateway.url, _OUTSIDER)
        assert "level" in shown
        assert "secret" not in shown
        assert "classified" not in shown

    @proves("adapter.rights")
    async def test_a_wrong_key_is_shown_nothing(self, gateway: AdapterGateway) -> None:
        """See that it is refused."""
        shown = await self.look(gateway.url, "no-key-of-anybody")
        assert "level" not in shown
        assert "42.5" not in shown

    @proves("adapter.rights")
    async def test_a_key_that_is_withdrawn_shows_nothing_more(
        self, gateway: AdapterGateway
    ) -> None:
        """See that a reload of the configuration counts at once."""
        assert "level" in await self.look(gateway.url, OPERATOR)
        gateway.withdraw_keys()
        assert "42.5" not in await self.look(gateway.url, OPERATOR)

    @proves("adapter.config")
    def test_an_unknown_key_in_its_table_is_refused_by_name(self) -> None:
        """See that its configuration type is strict."""
        with pytest.raises(ConfigError, match="no_such_key"):
            decode_table({**self.options, "no_such_key": 1}, self.kind.config, "test: ")

    @proves("adapter.life")
    async def test_it_opens_twice_and_leaves_nothing_behind(self) -> None:
        """See that its mounts are withdrawn and its tasks end."""
        for _ in range(2):
            async with self.opened() as gateway:
                await self.look(gateway.url, OPERATOR)
                client_api = gateway.served.server.client_api
            assert not any(mount.name == self.kind.name for mount in client_api.mounts)
        before = asyncio.all_tasks()
        async with self.opened() as gateway:
            await self.look(gateway.url, OPERATOR)

        async def gone() -> bool:
            gc.collect()
            return not asyncio.all_tasks() - before

        await eventually(gone, "every task has ended")

    def test_no_test_of_the_suite_is_changed_without_a_reason(self) -> None:
        """See that nothing was overridden or taken out but under xfail with a reason."""
        assert self.altered(AdapterSuite) == []
