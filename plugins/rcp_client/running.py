"""`rcpctl execute`: follow a command to its end, and let Ctrl-C stop the robot first."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

from rcp_client import show
from rcp_client.client import Client
from rcp_client.command import CommandHandle, Feedback
from rcp_client.output import Output, compact
from rcp_client.value import meant
from rcp_kernel.errors import Cancelled, RcpError

__all__ = ["execute"]

_INTERRUPTED = 130


async def execute(client: Client, out: Output, args: dict[str, Any]) -> int:
    """Start a command, show its feedback, and say how it ended."""
    path, text = args["path"], args["input"]
    value = None if text is None else await meant(client, path, text)
    if args["dry_run"]:
        envelope = {"type": "execute", "path": path, "body": value, "dry_run": True}
        show.reply(out, await client.request(envelope))
        return 0
    wanted = args["feedback"]
    shown = not out.json if wanted is None else wanted

    def heard(feedback: Feedback) -> None:
        if not shown or not args["wait"]:
            return
        if out.json:
            out.document({"path": path, **_facts(feedback)})
        elif feedback.status != "accepted":
            share = "" if feedback.progress is None else f"{feedback.progress:4.0%}"
            body = "" if feedback.body is None else compact(feedback.body)
            out.line(f"{out.paint(feedback.status)} {share} {out.dim(body)}".rstrip())

    handle = await client.start(
        path, value, deadline=args["deadline"], idempotency_key=args["key"], on_feedback=heard
    )
    if not args["wait"] and not handle.done:
        _accepted(out, handle)
        return 0
    if shown and not out.json and handle.id is not None:
        out.line(f"{out.paint('accepted')} {handle.id}")
    with _stopping(out, client, handle) as stop:
        try:
            reply = await stop.unless_left(handle)
        except Cancelled as error:
            if not stop.asked:
                raise
            out.error(error)
            return _INTERRUPTED
        if reply is None:
            return _INTERRUPTED
    show.reply(out, reply)
    return _INTERRUPTED if stop.asked else 0


def _facts(feedback: Feedback) -> dict[str, Any]:
    names = ("status", "progress", "body", "message", "timestamp")
    return {name: item for name in names if (item := getattr(feedback, name)) is not None}


def _accepted(out: Output, handle: CommandHandle) -> None:
    if out.json:
        out.document({"path": handle.path, "command": handle.id, "status": handle.status})
    else:
        out.line(f"{out.paint(handle.status)} {handle.id}")


class _Stop:
    """What Ctrl-C has asked for so far."""

    def __init__(self, out: Output, client: Client, handle: CommandHandle) -> None:
        self.asked = False
        self._left = asyncio.Event()
        self._out = out
        self._client = client
        self._handle = handle
        self._tasks: set[asyncio.Task[None]] = set()

    def ask(self) -> None:
        """Cancel the command the first time, leave the second."""
        if self.asked:
            self._left.set()
            return
        self.asked = True
        self._out.aside(
            f"\nrcpctl: cancelling {self._handle.id}; Ctrl-C again leaves without waiting"
        )
        task = asyncio.get_running_loop().create_task(self._cancel())
        self._tasks.add(task)

    async def _cancel(self) -> None:
        try:
            await self._handle.cancel()
        except RcpError as error:
            self._out.error(error)

    async def unless_left(self, handle: CommandHandle) -> Any:
        """Return the final reply, or None if Ctrl-C came twice."""
        ending = asyncio.ensure_future(handle.reply())
        leaving = asyncio.ensure_future(self._left.wait())
        await asyncio.wait((ending, leaving), return_when=asyncio.FIRST_COMPLETED)
        leaving.cancel()
        if ending.done():
            return ending.result()
        ending.cancel()
        self._out.aside(f"rcpctl: left; `rcpctl commands` shows what becomes of {handle.id}")
        return None


@contextmanager
def _stopping(out: Output, client: Client, handle: CommandHandle) -> Generator[_Stop]:
    stop = _Stop(out, client, handle)
    loop = asyncio.get_running_loop()
    try:
        loop.add_signal_handler(signal.SIGINT, stop.ask)
    except NotImplementedError:  # Windows: Ctrl-C ends the client, and the command with it
        yield stop
        return
    try:
        yield stop
    finally:
        loop.remove_signal_handler(signal.SIGINT)
