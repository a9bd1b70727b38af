"""Runs a checked plan: each step is an ordinary request of the plan's sender.

A step therefore passes all the usual checks, with the rights at that time, and the commands it
starts have their own entries in the history and the audit log.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

from rcp_conditions import Condition
from rcp_kernel.clock import iso, now
from rcp_kernel.errors import (
    BY_CODE,
    DeadlineExceeded,
    EstopActive,
    InternalError,
    PreconditionFailed,
    RcpError,
)
from rcp_kernel.features import ActionHost
from rcp_kernel.sessions.session import Session
from rcp_kernel.wire import Request, error_body
from rcp_plans.limit import paced_timeout
from rcp_plans.looking import looked_at, refuse_excess
from rcp_plans.model import Group, Operate, Parallel, Retry, Wait
from rcp_plans.node import Checked, Node, every
from rcp_plans.pace import Pace
from rcp_plans.progress import ProgressReport
from rcp_plans.requests import StepRequests

__all__ = ["Engine"]

_LOOK = 0.1  # s between two evaluations of a condition
_UNKNOWN = 2.0  # s that the value of a condition may be unknown
_TOGETHER = 8  # steps of a `parallel` that start in one turn of the event loop


class Engine:
    """One run of one plan."""

    def __init__(
        self,
        session: Session,
        checked: Checked,
        command: str,
        telling: ProgressReport,
        host: ActionHost,
    ) -> None:
        self._host = host
        self._values = host.conditions
        self._loop = host.loop
        self._session = session
        self._checked = checked
        self._telling = telling
        nodes = list(every(checked.nodes))
        known = {node.id: node for node in nodes}
        self._sending = StepRequests(host, session, known, command)
        self._part = f"plan {command}"
        self._asked: set[str] = set()
        self._turns, self._owner = host.turns, session.principal.identity
        self._pace = Pace(self._turns, self._owner)
        self._conditions = [c for node in nodes for c in (node.when, node.until) if c is not None]

    async def run(self, token: str | None) -> None:
        """Run the steps in order; `token` identifies the approval of the whole plan.

        :raises RcpError: a step failed, and so did its fallback, if any.
        """
        self._sending.token = token
        if self._conditions:
            self._values.use(self._part, self._conditions)
        try:
            await self._sequence(self._checked.nodes)
        finally:
            if self._conditions:
                self._values.use(self._part, ())

    async def _sequence(self, nodes: Sequence[Node]) -> None:
        for node in nodes:
            await self._step(node)

    async def _step(self, node: Node) -> None:
        try:
            if node.when is not None and not await self._holds(node, node.when):
                self._skip(node)
                return
            await self._run_with_retries(node)
        except asyncio.CancelledError:
            if not node.ended:
                self._cancelled(node)
            raise
        except RcpError as error:
            self._telling.change(node, "failed", error=error_body(error), message=error.message)
            # An e-stop always ends the plan.
            if not node.fallback or isinstance(error, EstopActive):
                raise _of_step(node, error) from None
            await self._sequence(node.fallback)
            self._telling.change(node, "recovered")
        else:
            with self._turns.spending():
                self._telling.change(node, "completed")

    def _cancelled(self, node: Node) -> None:
        """Report an operation that was cut off; waits and groups are covered by the plan's end."""
        if isinstance(node.step, Operate):
            self._telling.change(node, "cancelled")
        else:
            self._telling.quietly(node, "cancelled")

    def _skip(self, node: Node) -> None:
        for one in every(node.children):
            self._telling.quietly(one, "skipped")
        self._telling.change(node, "skipped", message=f"`{node.step.when}` does not hold")

    # -- tries and deadlines -------------------------------------------------------------------

    async def _run_with_retries(self, node: Node) -> None:
        loop = self._loop
        limit = node.step.deadline
        end = None if limit is None else loop.time() + limit
        retry = node.step.retry
        for left in range(0 if retry is None else retry.times, -1, -1):
            try:
                await self._run_once(node, None if end is None else end - loop.time())
            except RcpError as error:
                over = end is not None and loop.time() + (retry.delay if retry else 0.0) >= end
                if not left or over or not _may_retry(retry, error):
                    raise
                assert retry is not None
                self._telling.change(
                    node, "running", message=f"{error.message}; {left} retries left"
                )
                await asyncio.sleep(retry.delay)
                self._reset_node(node)
            else:
                return

    async def _run_once(self, node: Node, left: float | None) -> None:
        node.state.tries += 1
        node.state.started = node.state.started or iso(now())
        with self._turns.spending():
            self._telling.change(node, "running")
        step = node.step
        if left is not None and left <= 0:
            raise _late(node)
        if isinstance(step, Operate):
            await self._operate(node, step, left)
            return
        work = self._wait(node) if isinstance(step, Wait) else self._group(node)
        try:
            async with paced_timeout(self._turns, self._owner, left):
                await work
        except TimeoutError as error:
            if isinstance(error, RcpError):  # raised by the step itself
                raise
            raise _late(node) from None

    def _reset_node(self, node: Node) -> None:
        for one in every(node.children):
            one.raw = None
            self._telling.quietly(one, "pending")

    # -- operations ------------------------------------------------------------------------------

    async def _operate(self, node: Node, step: Operate, left: float | None) -> None:
        state = node.state
        state.error = state.message = state.command = None

        def progress(feedback: Any, fraction: float | None) -> None:
            state.feedback, state.progress = feedback, fraction
            self._telling.change(node, "running")

        try:
            node.raw, state.message = await self._sending.send(node, step, left, progress)
        finally:
            state.feedback = state.progress = None
        try:
            await self._turns.wait(self._owner)  # many may end together
        finally:
            with self._turns.spending():
                self._telling.result(node)

    async def _group(self, node: Node) -> None:
        if isinstance(node.step, Parallel):
            await self._parallel(node, node.step)
        else:
            await self._sequence(node.children)

    async def _parallel(self, node: Node, step: Parallel) -> None:
        gate = asyncio.Semaphore(step.limit or len(node.children))
        tasks: dict[str, asyncio.Task[None]] = {}
        try:
            for number, child in enumerate(node.children, 1):
                before = [tasks[id_] for id_ in dict.fromkeys(child.step.after)]
                tasks[child.id] = asyncio.create_task(
                    self._branch(child, before, gate), name=f"{self._part} step {child.id}"
                )
                if not number % _TOGETHER:
                    await self._turns.place(self._owner)
            await self._until(step, node.children, tasks)
        finally:
            for task in tasks.values():
                task.cancel()
            # Wait for the cancelled steps: the next step must not begin before they have ended.
            await asyncio.gather(*tasks.values(), return_exceptions=True)

    async def _branch(
        self, child: Node, before: list[asyncio.Task[None]], gate: asyncio.Semaphore
    ) -> None:
        try:
            if before:
                await asyncio.wait(before)
            if any(task.cancelled() or task.exception() is not None for task in before):
                error = PreconditionFailed("a step that it depends on did not complete")
                self._telling.change(
                    child, "failed", error=error_body(error), message=error.message
                )
                raise _of_step(child, error)
            async with gate:
                # Hundreds may begin at once, over all plans.
                await self._turns.wait(self._owner)
                await self._step(child)
        except asyncio.CancelledError:
            if not child.ended:
                self._cancelled(child)
            raise

    @staticmethod
    async def _until(
        step: Parallel, children: list[Node], tasks: dict[str, asyncio.Task[None]]
    ) -> None:
        """Wait until all steps have completed, or as many as required.

        :raises RcpError: the error of the first step that failed.
        """
        running = set(tasks.values())
        failed: BaseException | None = None
        while running:
            done, running = await asyncio.wait(running, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                failed = failed or (None if task.cancelled() else task.exception())
            stopped = isinstance(failed, EstopActive)
            if failed is not None and (step.need == "all" or stopped):
                raise failed
            ended = (child.state.state for child in children)
            if step.need == "any" and any(s in ("completed", "recovered") for s in ended):
                return
        if failed is not None:
            raise failed

    # -- conditions ----------------------------------------------------------------------------

    async def _wait(self, node: Node) -> None:
        assert node.until is not None
        await self._pace.wait()
        while not self._look(node, node.until):
            await self._pause()

    async def _holds(self, node: Node, when: Condition) -> bool:
        """Return whether a condition holds now.

        :raises PreconditionFailed: it cannot be evaluated.
        """
        await self._pace.wait()
        until = self._loop.time() + _UNKNOWN
        while (found := self._look(node, when)) is None:
            if self._loop.time() > until:
                raise PreconditionFailed(
                    f"cannot evaluate `{when.text}`",
                    remedy="Check the values that it uses: they are stale or have not arrived.",
                )
            await self._pause()
        return found

    async def _pause(self) -> None:
        # Not an event: some conditions depend on nothing but the time.
        await self._pace.wait(_LOOK)

    def _look(self, node: Node, condition: Condition) -> bool | None:
        """Evaluate a condition once; None if a value is missing.

        :raises PreconditionFailed: its values are too large to evaluate it.
        """
        paths = looked_at(self._values, self._session, node, condition)  # rights may be revoked
        with self._pace.spending():
            found = self._values.holds(condition, node)
            if found is None:
                refuse_excess(self._values, node, condition)
        if found is None:
            self._ask_for(paths)
        return found

    def _ask_for(self, paths: list[str]) -> None:
        """Read values that no robot has published yet: some are not published without a request."""
        for path in paths:
            entry = self._host.registry.entries.get(path)
            if entry is not None and entry.latest is None and path not in self._asked:
                self._asked.add(path)
                request = Request(type="read", path=path)
                self._host.send(self._session, request, lambda _reply: None)


def _may_retry(retry: Retry | None, error: RcpError) -> bool:
    if retry is None or isinstance(error, EstopActive):
        return False
    return error.code in retry.on if retry.on else error.retryable


def _late(node: Node) -> DeadlineExceeded:
    what = "did not become true" if isinstance(node.step, Wait) else "did not end"
    return DeadlineExceeded(
        f"it {what} within {node.step.deadline:g} s",
        remedy="Check the state of the robot, then send the plan again with a longer `deadline`.",
    )


def _of_step(node: Node, error: RcpError) -> RcpError:
    """Name the step in which an error occurred; the innermost one stays."""
    if "step" in (error.details or {}) and isinstance(node.step, Group):
        return error
    kind = BY_CODE.get(error.code, InternalError)
    found = kind(
        f"step '{node.id}' failed: {error.message}",
        path=error.path or node.path,
        origin=error.origin,
        remedy=error.remedy,
        retry_after=error.retry_after,
        details={**(error.details or {}), "step": node.id},
    )
    found.retryable = error.retryable
    found.trace_id = error.trace_id
    return found
