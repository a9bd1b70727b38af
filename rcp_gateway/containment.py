"""Containment of plugins that raise `SystemExit` or `KeyboardInterrupt`.

Both pass every `except Exception`, and asyncio lets them escape the event loop. They are therefore
converted to ordinary errors where plugins are called; if one still leaves the loop (from a plugin's
own task or timer), whoever runs the loop has to enter it again, as `rcpd` does.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, Callable, Generator
from contextlib import asynccontextmanager, contextmanager
from inspect import iscoroutinefunction
from typing import Any

from rcp_kernel.spi import Backend

__all__ = [
    "ContainedBackend",
    "PluginExit",
    "call_contained",
    "contained",
]


class PluginExit(RuntimeError):
    """A plugin tried to end the process."""


_ORDINARY = (Exception, asyncio.CancelledError, GeneratorExit)


def _plugin_exit(error: BaseException) -> PluginExit:
    what = f"{type(error).__name__}({', '.join(map(str, error.args))})"
    return PluginExit(f"the plugin raised {what}; the gateway contained it and goes on")


@contextmanager
def contained() -> Generator[None]:
    """Convert exceptions that would end the process to ordinary errors.

    :raises PluginExit: it would have.
    """
    try:
        yield
    except _ORDINARY:
        raise
    except BaseException as error:
        raise _plugin_exit(error) from error


def call_contained(function: Callable[..., Any], *args: Any, **named: Any) -> Any:
    """Call a function as in `contained`, which costs 5,000 instructions.

    :raises PluginExit: the call would have ended the process.
    """
    try:
        return function(*args, **named)
    except _ORDINARY:
        raise
    except BaseException as error:
        raise _plugin_exit(error) from error


class ContainedBackend(Backend):
    """A plugin's backend as the kernel calls it: every method of `Backend`, contained."""

    def __init__(self, backend: Backend) -> None:
        self.inner = backend
        """The plugin's own object."""
        self.on_loss = backend.on_loss
        # A backend that does not derive from `Backend` has the defaults of what it lacks.
        self.has_gateways = getattr(backend, "has_gateways", Backend.has_gateways)
        for name, contain in _CONTAIN.items():
            if hasattr(backend, name):
                setattr(self, name, contain(backend, name))

    def __getattr__(self, name: str) -> Any:
        """Return other attributes of the backend, which its own tests and adapters may use."""
        return getattr(self.inner, name)


def _contain_method(backend: Backend, name: str) -> Callable[..., Any]:
    def call(*args: Any, **named: Any) -> Any:
        return call_contained(getattr(backend, name), *args, **named)

    return call


def _contain_coroutine(backend: Backend, name: str) -> Callable[..., Any]:
    async def call(*args: Any, **named: Any) -> Any:
        try:  # on the path of every request: without the cost of a context manager
            return await getattr(backend, name)(*args, **named)
        except _ORDINARY:
            raise
        except BaseException as error:
            raise _plugin_exit(error) from error

    return call


def _contain_context(backend: Backend, name: str) -> Callable[..., Any]:
    @asynccontextmanager
    async def enter(*args: Any, **named: Any) -> AsyncGenerator[object]:
        with contained():
            async with getattr(backend, name)(*args, **named) as entered:
                yield entered

    return enter


def _containment(name: str, method: object) -> Callable[[Backend, str], Callable[..., Any]]:
    if name == "watch":
        return _contain_context
    return _contain_coroutine if iscoroutinefunction(method) else _contain_method


_CONTAIN = {
    name: _containment(name, method)
    for name, method in vars(Backend).items()
    if callable(method) and not name.startswith("_")
}
"""By name of a method of `Backend`, what contains its calls."""
