"""One running task: the replies of its plan's command as status updates and artifacts."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import msgspec
import structlog
from a2a.server.events.event_queue import EventQueue
from a2a.types.a2a_pb2 import Task, TaskState
from msgspec import Raw

from rcp_a2a.callers import Caller
from rcp_a2a.messages import TaskRequest, plain_reply
from rcp_a2a.questions import (
    LINES,
    Question,
    decision_of,
    is_plan,
    mended,
    question_of,
    with_schemas,
)
from rcp_a2a.reports import Reports, is_progress, step_of
from rcp_a2a.stops import PLANS
from rcp_a2a.waiting import Pending, WaitingTasks
from rcp_gateway.api import Query, QueuedRequest, Session, at_once
from rcp_gateway.client_api import ClientApi
from rcp_kernel.errors import Forbidden, RcpError, UnknownPath
from rcp_kernel.features.approval import APPROVALS, NoApprovals
from rcp_kernel.wire import Reply, Request
from rcp_protocol.timeouts import timeout
from rcp_web.untrusted import TextMarker, robot_said

__all__ = ["Run"]

log = structlog.get_logger("rcp.a2a")
_PACE = 0.2  # s between updates with progress only
_FINAL = {
    "completed": TaskState.TASK_STATE_COMPLETED,
    "failed": TaskState.TASK_STATE_FAILED,
    "rejected": TaskState.TASK_STATE_REJECTED,
    "cancelled": TaskState.TASK_STATE_CANCELED,
}


class Run:
    """A plan being executed."""

    def __init__(
        self,
        client_api: ClientApi,
        task: Task,
        patience: float,
        forget: Callable[[str], object],
        waiting: WaitingTasks,
    ) -> None:
        self._client_api = client_api
        self._patience = patience
        self._forget = forget
        self._waiting = waiting
        self.task = task
        self.question: Question | None = None
        """The pending question to the client."""
        self._plan: TaskRequest
        self._session: Session
        self._caller: Caller
        self._key = ""
        self._unfollow: Callable[[], None] | None = None
        self._lapse: asyncio.TimerHandle | None = None
        self.command: str | None = None
        self.cancelled = False
        """Whether the client cancelled the task."""
        self.ended = asyncio.Event()
        self._replies: deque[Reply] = deque()
        self._arrived = asyncio.Event()
        self._known = asyncio.Event()
        """Whether the gateway has replied: a robot may move before it does."""
        self._urgent = asyncio.Event()
        """Whether there is more to report than progress."""
        self._reports = Reports(task)

    # -- the gateway's side --------------------------------------------------------------------

    def start(
        self, caller: Caller, plan: TaskRequest, key: str, approval: str | None = None
    ) -> None:
        """Submit the plan to the gateway, which checks and starts it, once for each key."""
        self._plan = self._reports.plan = plan
        self._session = caller.session
        self._caller, self._key = caller, key
        request = QueuedRequest(
            since=caller.since,
            type="execute",
            path=PLANS,
            id=f"a2a-{self.task.id}",
            dry_run=plan.dry_run,
            deadline=plan.deadline,
            # A stop waits for no store, and is always sent again.
            idempotency_key=None if plan.dry_run or caller.stops else key,
            approval=approval,
            custom=plan.custom,
            body=Raw(msgspec.json.encode(plan.body)),
        )
        self._client_api.submit(caller.session, request, self._take)

    def resume(self, caller: Caller, pending: Pending) -> None:
        """Take up the question of an earlier run of the gateway."""
        self._plan, self.question = pending.plan, pending.question
        self._reports.plan = pending.plan
        self._session, self._caller = caller.session, caller
        self._expect_answer()

    def answer(self, caller: Caller, answer: TaskRequest, key: str) -> str | None:
        """Continue with a client's answer; return an explanation if it is not usable."""
        question = self.question
        assert question is not None
        if question.approval is not None and not is_plan(answer):
            return self._decide(caller, question.approval, answer, key)
        lines = self._client_api.service(LINES) or (lambda _text: [])
        plan = mended(self._plan, question, answer, lines)
        if plan is None:
            return "The answer is neither a plan nor the missing parameters. " + question.text
        self._resume()
        self.start(caller, plan, key)
        return None

    def _decide(self, caller: Caller, approval: str, answer: TaskRequest, key: str) -> str | None:
        decision = decision_of(answer)
        if decision is None:
            return "Answer with the decision `approve` or `reject`, or with another plan."
        try:
            approvals = self._client_api.service(APPROVALS) or NoApprovals()
            approvals.answer(caller.session, approval, decision, _reason(answer))
        except Forbidden as error:
            if decision == "reject":
                return error.message
            # Somebody else decides; if they have approved, the plan proceeds.
        except UnknownPath:
            if decision == "reject":
                return (
                    "The request for approval has ended, and nothing was started: cancel the task."
                )
            # It has expired, or the gateway was restarted: the plan requests a new one.
            self._resume()
            self.start(caller, self._plan, key)
            return None
        except RcpError as error:
            return error.message
        self._resume()
        self.start(caller, self._plan, key, None if decision == "reject" else approval)
        return None

    def _resume(self) -> None:
        self.question = None
        self._waiting.forget(self.task.id)
        if self._unfollow is not None:
            self._unfollow()
            self._unfollow = None
        if self._lapse is not None:
            self._lapse.cancel()
            self._lapse = None

    def _take(self, reply: Reply) -> None:
        self.command = reply.command or self.command
        self._known.set()
        last = self._replies[-1] if self._replies else None
        if (
            last is not None
            and is_progress(last)
            and is_progress(reply)
            and step_of(last) == step_of(reply)
        ):
            self._replies.pop()  # newer progress replaces older for a slow client
        self._replies.append(reply)
        self._arrived.set()
        if not is_progress(reply):
            self._urgent.set()

    async def cancel(self, caller: Caller) -> None:
        """Cancel the plan's running steps; returns once the robots have confirmed it."""
        self.cancelled = True
        if self.question is not None:
            self._resume()
            await self._end(TaskState.TASK_STATE_CANCELED, "Cancelled before anything was started.")
            return
        await self._known.wait()
        if self.command is not None and not self.ended.is_set():
            request = Request(type="cancel", path=PLANS, command=self.command)
            await self._client_api.request(caller.session, request)
        await self.ended.wait()

    # -- the client's side ---------------------------------------------------------------------

    def listen(self, queue: EventQueue) -> None:
        """Send updates to a queue from now on."""
        self._reports.listen(queue)

    async def attend(self) -> None:
        """Send updates until the plan has ended or there is a question to the client."""
        final = False
        while not final:
            await self._arrived.wait()
            self._arrived.clear()
            passing = False
            while self._replies:
                await self._client_api.turns.wait(self._session.principal.identity)
                reply = self._replies.popleft()
                await self._report_step(reply)
                final = final or reply.final
                passing = is_progress(reply)
            if passing and not final:
                self._urgent.clear()
                with suppress(TimeoutError):
                    async with timeout(_PACE):
                        await self._urgent.wait()

    async def _report_step(self, reply: Reply) -> None:
        facts = plain_reply(reply)
        if reply.final:
            await self._conclude(facts)
        elif reply.status == "in_progress" and isinstance(facts.get("body"), dict):
            await self._reports.step(facts)
        else:
            await self._reports.working(facts)

    async def _conclude(self, facts: dict[str, Any]) -> None:
        status: str = facts["status"]
        question = question_of(facts) if status == "rejected" and not self.cancelled else None
        if question is not None and not self._plan.dry_run:
            question = with_schemas(question, self._schema)
            await self.ask(question, question.text)
            return
        state = _FINAL[status]
        text = facts.get("message") or f"The plan has {status}."
        if robot_said(facts.get("error") or {}):
            text = TextMarker().text(text)
        if status == "completed" and not facts.get("dry_run"):
            text = "The plan completed."
        if status == "cancelled" and not self.cancelled and self._client_api.closing:
            state, text = TaskState.TASK_STATE_FAILED, "The gateway stopped during the task."
        if facts.get("dry_run"):
            await self._reports.artifact("check", facts.get("body"))
        elif status == "completed" and not self._reports.has_steps and "body" in facts:
            await self._reports.artifact("result", facts["body"])
        await self._end(state, text, facts.get("error"))

    def _schema(self, path: str) -> Any:
        """Return the input schema of a path, as its caller may see it."""
        page = at_once(self._client_api.discover(self._session, path, Query(limit=1)))
        schemas = page["resources"][0]["schemas"] if page["resources"] else {}
        return schemas.get("input") or schemas.get("value")

    async def ask(self, question: Question, text: str) -> None:
        """Ask the client, whose answer may take a while."""
        self.question = question
        self._expect_answer()
        self._waiting.keep(self.task.id, self._plan, question)
        state = TaskState.TASK_STATE_INPUT_REQUIRED
        if question.approval is not None and self._needs_another(question.approval):
            state = TaskState.TASK_STATE_AUTH_REQUIRED
        await self._reports.state(state, text, question.plain)

    def _expect_answer(self) -> None:
        loop = asyncio.get_running_loop()
        self._lapse = loop.call_later(self._patience, self._lapsed)

    def _needs_another(self, approval: str) -> bool:
        """Return whether somebody else has to approve; then the plan goes on once they have."""
        session = self._session
        if session.rights.may_approve_own(session.tenant):
            return False
        approvals = self._client_api.service(APPROVALS) or NoApprovals()
        self._unfollow = approvals.follow(approval, self._decided)
        return True

    def _decided(self) -> None:
        """Continue: the plan learns what was decided."""
        if self.question is None:  # its own client has decided
            return
        approval = self.question.approval
        self._resume()
        self.start(self._caller, self._plan, self._key, approval)
        self._late = asyncio.ensure_future(self._attend_alone())

    async def _attend_alone(self) -> None:
        """Send updates of a plan that goes on without a message of its client."""
        try:
            await self.attend()
        finally:
            if self.question is None:
                self._forget(self.task.id)
                self.ended.set()

    async def ask_again(self, text: str) -> None:
        """Tell a client that its answer is not usable."""
        question = self.question
        assert question is not None
        self._resume()
        await self.ask(question, text)

    def _lapsed(self) -> None:
        self._resume()
        text = f"No answer within {self._patience:g} s."
        self._late = asyncio.ensure_future(self._end(TaskState.TASK_STATE_FAILED, text))

    async def _end(self, state: TaskState, text: str, data: Any = None) -> None:
        await self._reports.state(state, text, data)
        self._forget(self.task.id)
        self.ended.set()


def _reason(answer: TaskRequest) -> str | None:
    reason: Any = answer.body.get("reason") if isinstance(answer.body, dict) else None
    return reason[:500] if isinstance(reason, str) else None
