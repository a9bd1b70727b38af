"""Containment of plugins that raise `SystemExit` or `KeyboardInterrupt`.

Both pass every `except Exception`, and asyncio lets them escape the event loop. They are therefore
converted to ordinary errors where plugins are called; if one still leaves the loop (from a plugin's
own task or timer), whoever runs the loop has to enter it again, as `rcpd` does.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

__all__ = ["ORDINARY", "PluginExit", "call_contained", "contained", "plugin_exit"]


class PluginExit(RuntimeError):
    """A plugin tried to end the process."""


ORDINARY = (Exception, asyncio.CancelledError, GeneratorExit)
"""What neither ends the process nor leaves the event loop."""


def plugin_exit(error: BaseException) -> PluginExit:
    """Return the error in place of one that would end the process."""
    what = f"{type(error).__name__}({', '.join(map(str, error.args))})"
    return PluginExit(f"the plugin raised {what}; the gateway contained it and goes on")


@contextmanager
def contained() -> Generator[None]:
    """Turn whatever would end the process into an ordinary error.

    :raises PluginExit: it would have.
    """
    try:
        yield
    except ORDINARY:
        raise
    except BaseException as error:
        raise plugin_exit(error) from error


def call_contained(function: Callable[..., object], *args: Any) -> None:
    """Call a function as in `contained`, which costs 5,000 instructions.

    :raises PluginExit: the call would have ended the process.
    """
    try:
        function(*args)
    except ORDINARY:
        raise
    except BaseException as error:
        raise plugin_exit(error) from error
