"""`rcpctl execute`: follow a command to its end; the first Ctrl-C cancels it."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

from rcp_client.client import Client
from rcp_client.command import CommandHandle, Feedback
from rcp_client.console import show
from rcp_client.console.output import Output, compact, exit_code
from rcp_client.console.progress import ProgressLine
from rcp_client.console.value import meant
from rcp_client.messages import Reply
from rcp_protocol.errors import RcpError

__all__ = ["execute", "follow"]

_INTERRUPTED = 130


async def execute(client: Client, out: Output, args: dict[str, Any]) -> int:
    """Start a command, show its feedback and its outcome."""
    path, text = args["path"], args["input"]
    value = None if text is None else await meant(client, path, text)
    if args["dry_run"]:
        envelope = {"type": "execute", "path": path, "body": value, "dry_run": True}
        show.reply(out, await client.request(envelope))
        return 0
    return await follow(client, out, args, value)


async def follow(
    client: Client,
    out: Output,
    args: dict[str, Any],
    value: Any,
    feedback_line: Callable[[Output, Feedback], str] | None = None,
    ended: Callable[[Output, Reply], None] = show.reply,
    failed: Callable[[Output, RcpError], None] | None = None,
) -> int:
    """Start a command and follow it to its end; the functions define how it is displayed."""
    run = _Run(client, out, args, value)
    run.feedback_line, run.ended, run.failed = feedback_line or _line, ended, failed
    with _interrupts(run):
        return await run.until_the_end()


class _Run:
    """One command, and the Ctrl-Cs received so far."""

    def __init__(
        self,
        client: Client,
        out: Output,
        args: dict[str, Any],
        value: Any,
    ) -> None:
        self._client = client
        self.feedback_line: Callable[[Output, Feedback], str] = _line
        self.ended: Callable[[Output, Reply], None] = show.reply
        self.failed: Callable[[Output, RcpError], None] | None = None
        self._out = out
        self._args = args
        self._value = value
        wanted: bool | None = args["feedback"]
        self._shows = args["wait"] and (not out.json if wanted is None else wanted)
        self._progress = ProgressLine(out) if wanted is None and out.terminal else None
        """The line that is written anew; with --feedback every step has its own."""
        self._handle: CommandHandle | None = None
        self.interrupted_once = False
        """Whether Ctrl-C was pressed."""
        self._left = asyncio.Event()
        self._cancelling: asyncio.Task[None] | None = None

    async def until_the_end(self) -> int:
        """Follow the command until it ends or the second Ctrl-C; return the exit status."""
        following = asyncio.ensure_future(self._follow())
        leaving = asyncio.ensure_future(self._left.wait())
        await asyncio.wait((following, leaving), return_when=asyncio.FIRST_COMPLETED)
        leaving.cancel()
        self._clear()
        if not following.done():
            following.cancel()
            named = self._handle.id if self._handle else "it"
            self._out.aside(
                f"rcpctl: stopped waiting; `rcpctl commands` shows the status of {named}"
            )
            return _INTERRUPTED
        try:
            reply = following.result()
        except RcpError as error:
            if self.failed is not None:
                self.failed(self._out, error)
            self._out.error(error)
            return _INTERRUPTED if self.interrupted_once else exit_code(error)
        if reply is not None:
            self.ended(self._out, reply)
        return _INTERRUPTED if self.interrupted_once else 0

    async def _follow(self) -> Reply | None:
        args = self._args
        handle = self._handle = await self._client.start(
            args["path"],
            self._value,
            deadline=args["deadline"],
            idempotency_key=args["key"],
            approval=args["approval"],
            on_feedback=self._heard,
        )
        if self.interrupted_once:
            self._cancel()
        if not args["wait"] and not handle.done and not self.interrupted_once:
            self._accepted(handle)
            return None
        return await handle.reply()

    def _accepted(self, handle: CommandHandle) -> None:
        if self._out.json:
            facts = {"path": handle.path, "command": handle.id, "status": handle.status}
            self._out.document(facts)
        else:
            self._out.line(f"{self._out.paint(handle.status)} {handle.id}")

    def _clear(self) -> None:
        if self._progress is not None:
            self._progress.clear()

    def _heard(self, feedback: Feedback) -> None:
        if not self._shows:
            return
        out = self._out
        if out.json:
            out.document({"path": self._args["path"], **_facts(feedback)})
        elif self._progress is not None and self.feedback_line is _line:
            self._progress.show(feedback)
        elif feedback.status == "in_progress":
            out.line(self.feedback_line(out, feedback).rstrip())
        else:
            out.line(f"{out.paint(feedback.status)} {out.dim(feedback.command or '')}".rstrip())

    def interrupted(self) -> None:
        """Cancel the command on the first Ctrl-C, stop waiting on the second."""
        if self.interrupted_once:
            self._left.set()
            return
        self.interrupted_once = True
        self._clear()
        self._out.aside("\nrcpctl: cancelling; press Ctrl-C again to stop waiting")
        if self._handle is not None:
            self._cancel()

    def _cancel(self) -> None:
        async def cancel(handle: CommandHandle) -> None:
            try:
                await handle.cancel()
            except RcpError as error:
                self._out.error(error)

        if self._handle is not None and not self._handle.done:
            self._cancelling = asyncio.get_running_loop().create_task(cancel(self._handle))


def _line(out: Output, feedback: Feedback) -> str:
    share = "" if feedback.progress is None else f"{feedback.progress:4.0%} "
    body = "" if feedback.body is None else compact(feedback.body)
    return f"{out.paint(feedback.status)} {share}{out.dim(body)}"


def _facts(feedback: Feedback) -> dict[str, Any]:
    names = ("command", "status", "progress", "body", "message", "timestamp")
    return {name: item for name in names if (item := getattr(feedback, name)) is not None}


@contextmanager
def _interrupts(run: _Run) -> Generator[None]:
    """Pass Ctrl-C to the run, from before the command is sent until after its end."""
    loop = asyncio.get_running_loop()
    try:
        loop.add_signal_handler(signal.SIGINT, run.interrupted)
    except NotImplementedError:  # Windows: Ctrl-C ends the client immediately
        yield
        return
    try:
        yield
    finally:
        loop.remove_signal_handler(signal.SIGINT)
        if run.interrupted_once:
            # It is already exiting: another Ctrl-C changes nothing.
            signal.signal(signal.SIGINT, signal.SIG_IGN)
