"""Run what `rcpctl` does without waiting for a resolver of names at the end."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Coroutine
from concurrent.futures import Future, ThreadPoolExecutor
from threading import Thread
from typing import Any, TypeVar

__all__ = ["run", "start"]

T = TypeVar("T")


def run(work: Coroutine[Any, Any, T]) -> T:
    """Run `work` in a loop of its own; a name that is still being looked up then is left alone.

    `asyncio.run`, and then the interpreter, would wait for the thread in which `getaddrinfo` asks a
    server of names that does not answer: half a minute, whatever time limit the work had.
    """
    return asyncio.run(_within(work))


async def _within(work: Coroutine[Any, Any, T]) -> T:
    asyncio.get_running_loop().set_default_executor(_Threads())
    return await work


class _Threads(ThreadPoolExecutor):
    """The threads of a loop, of which those that look names up are nobody's to wait for."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Start a call."""
        if fn is not socket.getaddrinfo:
            return super().submit(fn, *args, **kwargs)
        return start(fn, *args, **kwargs)


def start(work: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
    """Start a call in a thread that ends with the program, whether the call has ended or not."""
    future: Future[T] = Future()

    def call() -> None:
        if not future.set_running_or_notify_cancel():
            return
        try:
            future.set_result(work(*args, **kwargs))
        except BaseException as error:
            future.set_exception(error)

    Thread(target=call, daemon=True).start()
    return future
