"""Every method of the contract of a backend is contained, those to come too."""

from __future__ import annotations

from inspect import isawaitable, signature
from typing import Any

import pytest

from rcp_gateway.containment import ContainedBackend, PluginExit
from rcp_kernel.errors import UnsupportedOperation
from rcp_kernel.spi import Backend, BaseBackend

pytestmark = pytest.mark.anyio
METHODS = [
    name for name, method in vars(Backend).items() if callable(method) and not name.startswith("_")
]


class Lone:
    """A backend that does not derive from `Backend`, and lacks most of it."""

    on_loss = "continue"
    label = "lone"

    async def read(self, name: str) -> Any:
        """Return its name."""
        return name


def ends(*_: Any, **__: Any) -> Any:
    """End the process."""
    raise SystemExit(3)


@pytest.mark.parametrize("name", METHODS)
async def test_no_method_of_a_backend_ends_the_process(name: str) -> None:
    backend = BaseBackend()
    setattr(backend, name, ends)
    method: Any = getattr(ContainedBackend(backend), name)
    arguments = [None] * (len(signature(getattr(Backend, name)).parameters) - 1)
    with pytest.raises(PluginExit, match=r"SystemExit\(3\)"):
        await called(method, name, *arguments)


async def called(method: Any, name: str, *arguments: Any) -> None:
    if name == "watch":
        async with method(*arguments):
            return
    result = method(*arguments)
    if isawaitable(result):
        await result


async def test_what_a_backend_lacks_is_as_in_the_contract() -> None:
    lone: Any = Lone()
    backend = ContainedBackend(lone)
    assert (backend.on_loss, backend.has_gateways, backend.label) == ("continue", False, "lone")
    assert await backend.read("sensor/a") == "sensor/a"
    assert backend.motion(None) is None
    with pytest.raises(UnsupportedOperation, match="cannot be written"):
        await backend.write("actuator/a", 1.0)


def test_a_method_that_is_replaced_later_is_called() -> None:
    backend = BaseBackend()
    contained = ContainedBackend(backend)
    vars(backend)["watchdogs"] = lambda: ["new"]
    assert contained.watchdogs() == ["new"]
