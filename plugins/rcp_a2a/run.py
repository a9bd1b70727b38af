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
from a2a.server.tasks import TaskUpdater
from a2a.types.a2a_pb2 import Message, Part, Task, TaskState
from msgspec import Raw

from rcp_a2a.callers import Caller
from rcp_a2a.messages import (
    VALUES,
    TaskRequest,
    count_values,
    data_part,
    plain_reply,
    stamp,
    text_part,
)
from rcp_a2a.questions import (
    LINES,
    Question,
    decision_of,
    is_plan,
    mended,
    question_of,
    with_schemas,
)
from rcp_a2a.stops import PLANS
from rcp_kernel.api import Query, QueuedRequest, Session, at_once
from rcp_kernel.client_api import ClientApi
from rcp_kernel.errors import Forbidden, RcpError, UnknownPath
from rcp_kernel.features.approval import APPROVALS, NoApprovals
from rcp_kernel.wire import Reply, Request

__all__ = ["Run"]

log = structlog.get_logger("rcp.a2a")
_PROGRESS = 256  # values of a step's progress that are included
_PACE = 0.2  # s between updates with progress only
_STEP_ENDED = frozenset(("completed", "recovered", "failed", "skipped", "cancelled"))
_FINAL = {
    "completed": TaskState.TASK_STATE_COMPLETED,
    "failed": TaskState.TASK_STATE_FAILED,
    "rejected": TaskState.TASK_STATE_REJECTED,
    "cancelled": TaskState.TASK_STATE_CANCELED,
}


class Run:
    """A plan being executed."""

    def __init__(
        self, client_api: ClientApi, task: Task, patience: float, forget: Callable[[str], object]
    ) -> None:
        self._client_api = client_api
        self._patience = patience
        self._forget = forget
        self.task = task
        self.question: Question | None = None
        """The pending question to the client."""
        self._plan: TaskRequest
        self._session: Session
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
        self._states: dict[str, str] = {}
        self._room = VALUES
        """Values that the task's artifacts may still contain as data."""
        self._updater: TaskUpdater

    # -- the gateway's side --------------------------------------------------------------------

    def start(
        self, caller: Caller, plan: TaskRequest, key: str, approval: str | None = None
    ) -> None:
        """Submit the plan to the gateway, which checks and starts it, once for each key."""
        self._plan, self._session = plan, caller.session
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
            body=Raw(msgspec.json.encode(plan.body)),
        )
        self._client_api.submit(caller.session, request, self._take)

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
            pass  # it has expired: the plan requests a new one
        except RcpError as error:
            return error.message
        self._resume()
        self.start(caller, self._plan, key, None if decision == "reject" else approval)
        return None

    def _resume(self) -> None:
        self.question = None
        if self._lapse is not None:
            self._lapse.cancel()
            self._lapse = None

    def _take(self, reply: Reply) -> None:
        self.command = reply.command or self.command
        self._known.set()
        last = self._replies[-1] if self._replies else None
        if last is not None and _passing(last) and _passing(reply) and _step(last) == _step(reply):
            self._replies.pop()  # newer progress replaces older for a slow client
        self._replies.append(reply)
        self._arrived.set()
        if not _passing(reply):
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
        self._updater = TaskUpdater(queue, self.task.id, self.task.context_id)

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
                passing = _passing(reply)
            if passing and not final:
                self._urgent.clear()
                with suppress(TimeoutError):
                    async with asyncio.timeout(_PACE):
                        await self._urgent.wait()

    async def _report_step(self, reply: Reply) -> None:
        facts = plain_reply(reply)
        if reply.final:
            await self._conclude(facts)
        elif reply.status == "in_progress" and isinstance(facts.get("body"), dict):
            await self._tell_step(facts)
        else:
            await self._working(facts)

    async def _working(self, facts: dict[str, Any]) -> None:
        metadata = {"command": facts["command"]} if "command" in facts else None
        message = self._message("The plan was checked and starts.")
        await self._status(TaskState.TASK_STATE_WORKING, message, metadata=metadata)

    async def _tell_step(self, facts: dict[str, Any]) -> None:
        step: dict[str, Any] = facts["body"]
        id_, state = str(step.get("step")), str(step.get("state"))
        data = {key: step[key] for key in ("step", "do", "path", "state") if key in step}
        if state in _STEP_ENDED:
            await self._artifact(id_, step)
            data["artifact"] = f"step-{id_}"
        if self._states.get(id_) == state:
            # Progress goes into the metadata only, where the newest replaces the previous.
            if count_values(step, _PROGRESS) > _PROGRESS:
                del step["feedback"]
            metadata = {"step": step, "progress": facts.get("progress")}
            await self._status(TaskState.TASK_STATE_WORKING, metadata=metadata)
            return
        self._states[id_] = state
        await self._status(TaskState.TASK_STATE_WORKING, self._message(_line(id_, step), data))

    async def _artifact(self, id_: str, step: dict[str, Any]) -> None:
        await self._updater.add_artifact(
            [self._data(step)],
            artifact_id=f"step-{id_}",
            name=step.get("path") or step.get("do"),
            metadata={"step": id_, "state": step.get("state")},
            last_chunk=True,
        )

    async def _conclude(self, facts: dict[str, Any]) -> None:
        status: str = facts["status"]
        question = question_of(facts) if status == "rejected" and not self.cancelled else None
        if question is not None and not self._plan.dry_run:
            question = with_schemas(question, self._schema)
            await self.ask(question, question.text)
            return
        state = _FINAL[status]
        text = facts.get("message") or f"The plan has {status}."
        if status == "completed" and not facts.get("dry_run"):
            text = "The plan completed."
        if status == "cancelled" and not self.cancelled and self._client_api.closing:
            state, text = TaskState.TASK_STATE_FAILED, "The gateway stopped during the task."
        if facts.get("dry_run"):
            parts = [self._data(facts.get("body"))]
            await self._updater.add_artifact(parts, "check", "check", last_chunk=True)
        elif status == "completed" and not self._states and "body" in facts:
            parts = [self._data(facts["body"])]
            await self._updater.add_artifact(parts, "result", "result", last_chunk=True)
        await self._end(state, text, facts.get("error"))

    def _schema(self, path: str) -> Any:
        """Return the input schema of a path, as its caller may see it."""
        page = at_once(self._client_api.discover(self._session, path, Query(limit=1)))
        schemas = page["resources"][0]["schemas"] if page["resources"] else {}
        return schemas.get("input") or schemas.get("value")

    async def ask(self, question: Question, text: str) -> None:
        """Ask the client, whose answer may take a while."""
        self.question = question
        loop = asyncio.get_running_loop()
        self._lapse = loop.call_later(self._patience, self._lapsed)
        message = self._message(text, question.plain)
        await self._status(TaskState.TASK_STATE_INPUT_REQUIRED, message)

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
        await self._status(state, self._message(text, data))
        self._forget(self.task.id)
        self.ended.set()

    async def _status(self, state: TaskState, message: Message | None = None, **more: Any) -> None:
        await self._updater.update_status(state, message, stamp(), **more)

    def _data(self, value: Any) -> Part:
        """Build a data part, or a text part with JSON if the task would have too many values."""
        count = count_values(value, self._room)
        if count > self._room:
            return text_part(value)
        self._room -= count
        return data_part(value, words=self._plan.words)

    def _message(self, text: str, data: Any = None) -> Message:
        parts = [Part(text=text)]
        if data is not None:
            parts.append(data_part(data, words=self._plan.words))
        return self._updater.new_agent_message(parts)


def _passing(reply: Reply) -> bool:
    """Return whether a reply contains progress only."""
    return reply.status == "in_progress" and _state(reply) not in _STEP_ENDED


def _state(reply: Reply) -> Any:
    return getattr(reply.body, "state", None)


def _step(reply: Reply) -> Any:
    return getattr(reply.body, "step", None), _state(reply)


def _line(id_: str, step: dict[str, Any]) -> str:
    what = " ".join(str(step[key]) for key in ("do", "path") if step.get(key))
    why = step.get("message") or (step.get("error") or {}).get("message")
    ended = step.get("state") == "completed"  # the text for this code is less specific
    return f"Step {id_}, {what}: {step.get('state')}" + (f", {why}" if why and not ended else "")


def _reason(answer: TaskRequest) -> str | None:
    reason: Any = answer.body.get("reason") if isinstance(answer.body, dict) else None
    return reason[:500] if isinstance(reason, str) else None
