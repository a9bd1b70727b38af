"""One task as it runs: the replies of its plan's command, told as status updates and artifacts."""

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
    stamp,
    text_part,
    told,
)
from rcp_a2a.questions import (
    LINES,
    Decision,
    Question,
    decision_of,
    is_plan,
    mended,
    question_of,
    with_schemas,
)
from rcp_a2a.stops import PLANS
from rcp_kernel.api import HeldRequest, Query, Session, at_once
from rcp_kernel.client_api import ClientApi
from rcp_kernel.errors import Forbidden, RcpError, UnknownPath
from rcp_kernel.features.approval import APPROVALS, NoApprovals
from rcp_kernel.wire import Reply, Request

__all__ = ["Run"]

log = structlog.get_logger("rcp.a2a")
_PROGRESS = 256  # values of a step's progress that are told
_PACE = 0.2  # s between two updates that only tell of progress
_STEP_ENDED = frozenset(("completed", "recovered", "failed", "skipped", "cancelled"))
_FINAL = {
    "completed": TaskState.TASK_STATE_COMPLETED,
    "failed": TaskState.TASK_STATE_FAILED,
    "rejected": TaskState.TASK_STATE_REJECTED,
    "cancelled": TaskState.TASK_STATE_CANCELED,
}


class Run:
    """A plan under way."""

    def __init__(
        self, client_api: ClientApi, task: Task, patience: float, forget: Callable[[str], object]
    ) -> None:
        self._client_api = client_api
        self._patience = patience
        self._forget = forget
        self.task = task
        self.question: Question | None = None
        """What the client was asked for, while the task waits for it."""
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
        """The gateway has said something: a robot may move before it does."""
        self._urgent = asyncio.Event()
        """There is more to tell than progress."""
        self._states: dict[str, str] = {}
        self._room = VALUES
        """Values that the artifacts of the task may still have as data."""
        self._updater: TaskUpdater

    # -- the gateway's side --------------------------------------------------------------------

    def start(self, caller: Caller, plan: TaskRequest, approval: str | None = None) -> None:
        """Have the gateway check the plan and begin it."""
        self._plan, self._session = plan, caller.session
        request = HeldRequest(
            since=caller.since,
            type="execute",
            path=PLANS,
            id=f"a2a-{self.task.id}",
            dry_run=plan.dry_run,
            deadline=plan.deadline,
            approval=approval,
            body=Raw(msgspec.json.encode(plan.body)),
        )
        self._client_api.submit(caller.session, request, self._take)

    def answer(self, caller: Caller, answer: TaskRequest) -> str | None:
        """Go on with what a client answered; return what is still to be told if that is no use."""
        question = self.question
        assert question is not None
        if question.approval is not None and not is_plan(answer):
            return self._decide(caller, question.approval, decision_of(answer), answer)
        lines = self._client_api.service(LINES) or (lambda _text: [])
        plan = mended(self._plan, question, answer, lines)
        if plan is None:
            return "That is neither a plan nor what is missing. " + question.text
        self._resume()
        self.start(caller, plan)
        return None

    def _decide(
        self, caller: Caller, approval: str, decision: Decision | None, answer: TaskRequest
    ) -> str | None:
        if decision is None:
            return "Answer with the decision `approve` or `reject`, or with another plan."
        try:
            approvals = self._client_api.service(APPROVALS) or NoApprovals()
            approvals.answer(caller.session, approval, decision, _reason(answer))
        except Forbidden as error:
            if decision == "reject":
                return error.message
            # It is for somebody else to decide; who has done so by now lets the plan pass.
        except UnknownPath:
            pass  # it has lapsed: the plan asks anew
        except RcpError as error:
            return error.message
        self._resume()
        self.start(caller, self._plan, None if decision == "reject" else approval)
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
            self._replies.pop()  # the newest progress wins for a task that is behind
        self._replies.append(reply)
        self._arrived.set()
        if not _passing(reply):
            self._urgent.set()

    async def cancel(self, caller: Caller) -> None:
        """Have the plan's running steps cancelled; returns once the robots have confirmed it."""
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
        """Have everything told to a queue from now on."""
        self._updater = TaskUpdater(queue, self.task.id, self.task.context_id)

    async def attend(self) -> None:
        """Tell what happens until the plan has ended, or the client is asked for something."""
        final = False
        while not final:
            await self._arrived.wait()
            self._arrived.clear()
            passing = False
            while self._replies:
                await self._client_api.turns.wait(self._session.principal.identity)
                reply = self._replies.popleft()
                await self._tell(reply)
                final = final or reply.final
                passing = _passing(reply)
            if passing and not final:
                self._urgent.clear()
                with suppress(TimeoutError):
                    async with asyncio.timeout(_PACE):
                        await self._urgent.wait()

    async def _tell(self, reply: Reply) -> None:
        facts = told(reply)
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
            # Progress alone goes into the metadata, where the newest replaces the one before.
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
        """Return the schema of what a path takes, as its caller may see it."""
        page = at_once(self._client_api.discover(self._session, path, Query(limit=1)))
        schemas = page["resources"][0]["schemas"] if page["resources"] else {}
        return schemas.get("input") or schemas.get("value")

    async def ask(self, question: Question, text: str) -> None:
        """Ask the client, who may take some time for the answer."""
        self.question = question
        loop = asyncio.get_running_loop()
        self._lapse = loop.call_later(self._patience, self._lapsed)
        message = self._message(text, question.plain)
        await self._status(TaskState.TASK_STATE_INPUT_REQUIRED, message)

    async def ask_again(self, text: str) -> None:
        """Tell a client that its answer is of no use."""
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
        """Make a part of data; of its JSON if the task would have too many values."""
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
    """Tell whether a reply is of progress only."""
    return reply.status == "in_progress" and _state(reply) not in _STEP_ENDED


def _state(reply: Reply) -> Any:
    return getattr(reply.body, "state", None)


def _step(reply: Reply) -> Any:
    return getattr(reply.body, "step", None), _state(reply)


def _line(id_: str, step: dict[str, Any]) -> str:
    what = " ".join(str(step[key]) for key in ("do", "path") if step.get(key))
    why = step.get("message") or (step.get("error") or {}).get("message")
    ended = step.get("state") == "completed"  # what is said of that says no more
    return f"Step {id_}, {what}: {step.get('state')}" + (f", {why}" if why and not ended else "")


def _reason(answer: TaskRequest) -> str | None:
    reason: Any = answer.body.get("reason") if isinstance(answer.body, dict) else None
    return reason[:500] if isinstance(reason, str) else None
