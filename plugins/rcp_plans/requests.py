"""Sends an operation of a plan as a request of the plan's sender."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from msgspec import Raw

from rcp_kernel.errors import BY_CODE, InternalError, RcpError
from rcp_kernel.features import ActionHost
from rcp_kernel.sessions.session import Session
from rcp_kernel.spi import caller
from rcp_kernel.values import Encoding, dump, to_plain
from rcp_kernel.wire import NO_BODY, Body, Reply, Request
from rcp_plans.model import Execute, Operate, Read, Write
from rcp_plans.node import Filling, Node
from rcp_plans.places import check_place
from rcp_plans.progress import LONGEST
from rcp_protocol.structure import LONG
from rcp_protocol.trace import TRACEPARENT

__all__ = ["StepRequests"]

_PATIENCE = 60.0  # s that rate limits may delay a step without a deadline
_ENDED = "its plan ended"
_END = 10.0  # s for a stopped command's final status; the gateway gives a robot less
Told = Callable[[Any, float | None], None]


class StepRequests:
    """Sends the operations of one plan."""

    def __init__(
        self,
        host: ActionHost,
        session: Session,
        known: dict[str, Node],
        command: str,
    ) -> None:
        self._host = host
        self._turns, self._owner = host.turns, session.principal.identity
        self._loop = host.loop
        self._session = session
        self._known = known
        self._plan = command
        now = caller()
        trace = None if now is None else now.trace
        self._trace = {} if trace is None else {TRACEPARENT: trace.parent}
        """Of the plan, so that its steps are below it."""
        self.token: str | None = None
        """Identifies the approval of the whole plan."""

    async def send(
        self, node: Node, step: Operate, left: float | None, on_progress: Told
    ) -> tuple[Any, str | None]:
        """Send an operation within `left` seconds; return its result and message.

        :raises RcpError: the error in the reply.
        """
        loop = self._loop
        end = loop.time() + (_PATIENCE if left is None else left)
        while True:
            limit = None if left is None else max(end - loop.time(), 0.001)
            request = await self._request(node, step, limit)
            # A plan that ends while a long body waits for its turn must not write it later.
            if len(bytes(request.body)) > LONG:
                steps = self._host.prepare(self._session, request)
                request = await self._turns.finish(self._owner, steps)
            reply = await self._ask(node, request, on_progress)
            if reply.error is None:
                node.state.truncated, node.state.cursor = reply.truncated, reply.cursor
                if isinstance(step, Read):  # writes and commands are recorded anyway
                    return await self._looked(request, reply), reply.message
                return _plain(reply.body), reply.message
            error = _error_of(reply.error)
            pause = error.retry_after or 0.0
            if error.code != "rate_limited" or loop.time() + pause >= end:
                raise error
            await asyncio.sleep(pause)

    async def _looked(self, request: Request, reply: Reply) -> Any:
        """Record the reply of a read; return its value, unconverted if it is too long to report."""
        await self._host.record_read(self._session, request, reply)
        body = reply.body
        if isinstance(body, Body) and "*" not in (reply.path or request.path or ""):
            return body if len(body.encoded(Encoding.JSON)) > LONGEST else _plain(body)
        return _plain(body)

    async def _request(self, node: Node, step: Operate, limit: float | None) -> Request:
        value = step.value
        if node.refers:
            value = await self._turns.finish(self._owner, Filling(self._known).fill(value))
        check_place(self._host, self._session, node, value)
        return Request(
            type=step.do,
            path=node.path,
            deadline=limit,
            valid_for=step.valid_for if isinstance(step, Write) else None,
            body=NO_BODY if value is None else Raw(dump(value, Encoding.JSON)),
            custom={"x-plan": self._plan, "x-step": node.id, **self._trace},
            approval=self.token,
        )

    async def _ask(self, node: Node, request: Request, on_progress: Told) -> Reply:
        final: asyncio.Future[Reply] = self._loop.create_future()
        unwanted = False

        def answer(reply: Reply) -> None:
            if reply.command is not None and node.state.command is None:
                node.state.command = reply.command
                self._host.disown(self._session, reply.command)
            if final.done():
                return
            if reply.final:
                final.set_result(reply)
            elif unwanted and (late := self._host.started_by(request)) is not None:
                self._loop.call_soon(self._host.cancel, late, _ENDED)  # before its work begins
            elif reply.status == "in_progress":
                on_progress(_plain(reply.body), reply.progress)

        with self._turns.spending():
            self._host.send(self._session, request, answer)
        try:
            return await asyncio.shield(final)
        except asyncio.CancelledError:
            unwanted = True  # an action of a feature waits for its turn: it may begin later
            await self._stop(node, request, final)
            raise

    async def _stop(self, node: Node, request: Request, final: asyncio.Future[Reply]) -> None:
        """Stop the command of a step and wait until it has ended."""
        state, command = node.state, self._host.started_by(request)
        if command is None:
            if isinstance(node.step, (Write, Execute)):
                state.message = "it was running when the plan ended; check the robot"
            return
        self._host.cancel(command, _ENDED)
        done, _ = await asyncio.wait([final], timeout=_END)
        if not done:
            state.message = "the robot did not confirm that it stopped"
        elif (reply := final.result()).error is not None:
            state.error, state.message = reply.error, reply.message


def _plain(body: Any) -> Any:
    if body is NO_BODY:
        return None
    return to_plain(body.value if isinstance(body, Body) else body)


def _error_of(body: dict[str, Any]) -> RcpError:
    kind = BY_CODE.get(body["code"], InternalError)
    error = kind(
        body["message"],
        path=body.get("path"),
        origin=body.get("origin"),
        remedy=body.get("remedy"),
        retry_after=body.get("retry_after"),
        details=body.get("details"),
    )
    error.retryable = body["retryable"]  # false once the robot may have acted
    error.trace_id = body.get("trace_id")
    return error
