"""What lacks is put where it lacks, in whatever part of a plan that is."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from a2a.server.events.event_queue import EventQueue
from a2a.types.a2a_pb2 import Task, TaskState

from rcp_a2a.callers import Caller
from rcp_a2a.messages import TaskRequest
from rcp_a2a.questions import Question, mended, question_of
from rcp_a2a.run import Run
from rcp_a2a.waiting import Pending, WaitingTasks
from rcp_plans.lines import plain_steps
from rcp_store.disk_store import DiskStore
from rcp_store.plugin_store import PluginStore


def lacking(*steps: str) -> Question:
    missing = tuple({"step": s, "path": "/p", "pointer": "/x", "message": ""} for s in steps)
    return Question("?", None, missing)


def after(plan: Any, question: Question, answer: Any) -> Any:
    found = mended(TaskRequest(plan), question, TaskRequest(answer), plain_steps)
    return None if found is None else found.body


def test_parameters_are_merged_into_the_value_of_their_step() -> None:
    plan = {"steps": [{"do": "execute", "path": "/p", "value": {"a": {"x": 1}}}]}
    made = after(plan, lacking("1"), {"1": {"a": {"y": 2}, "b": 3}})
    assert made["steps"][0]["value"] == {"a": {"x": 1, "y": 2}, "b": 3}


def test_steps_within_steps_and_in_fallbacks_are_found() -> None:
    inner = {"do": "execute", "path": "/p"}
    plan = {
        "steps": [
            {"do": "parallel", "id": "both", "steps": [inner, {**inner, "fallback": [inner]}]}
        ]
    }
    made = after(
        plan, lacking("both.1", "both.2.fallback.1"), {"both.1": 1, "both.2.fallback.1": 2}
    )
    both = made["steps"][0]["steps"]
    assert (both[0]["value"], both[1]["fallback"][0]["value"], "value" in both[1]) == (1, 2, False)


def test_lines_become_steps() -> None:
    made = after({"lines": "read /a\nexecute /b"}, lacking("2"), {"x": 1})
    assert [step["path"] for step in made["steps"]] == ["/a", "/b"]
    assert made["steps"][1]["value"] == {"x": 1}


def test_the_parameters_of_several_steps_need_their_names() -> None:
    plan = {"steps": [{"do": "execute", "path": "/p"}] * 2}
    assert after(plan, lacking("1", "2"), {"x": 1}) is None
    assert after(plan, lacking("1", "2"), {"lines": "what?"}) is None


def test_a_symbolic_plan_is_answered_by_a_whole_one() -> None:
    assert after({"symbolic": "(go)"}, lacking("1"), {"x": 1}) is None
    assert after({"symbolic": "(go)"}, lacking("1"), {"symbolic": "(go 1)"}) == {
        "symbolic": "(go 1)"
    }


def test_only_what_a_client_can_give_is_asked_for() -> None:
    lacks = {"step": "1", "path": "/p", "message": "m", "details": {"missing": "/x"}}
    wrong = {"step": "2", "path": "/p", "message": "m", "details": {"pointer": "/x"}}

    def refused(*faults: Any) -> Any:
        return question_of({"error": {"code": "invalid_value", "details": {"faults": [*faults]}}})

    assert refused(lacks) is not None
    assert refused(lacks, wrong) is None
    assert refused() is None
    assert question_of({}) is None


class Events(EventQueue):
    """What a client is told."""

    def __init__(self) -> None:
        self.told: list[Any] = []

    async def enqueue_event(self, event: Any) -> None:
        self.told.append(event)


@pytest.mark.anyio
async def test_a_question_taken_up_after_a_restart_has_its_own_end(tmp_path: Path) -> None:
    forgotten: list[str] = []
    nobody: Any = None
    store = DiskStore(tmp_path / "store.db", asyncio.get_running_loop())
    waiting = WaitingTasks(PluginStore(store, "a2a.questions"))
    run = Run(nobody, Task(id="t", context_id="c"), 0.01, forgotten.append, waiting)
    events = Events()
    run.listen(events)
    run.resume(Caller(nobody, "http://here"), Pending(TaskRequest({}), lacking("1")))
    async with asyncio.timeout(60):
        await run.ended.wait()
    (event,) = events.told
    assert event.status.state == TaskState.TASK_STATE_FAILED
    assert "No answer within" in event.status.message.parts[0].text
    assert forgotten == ["t"]
    assert run.question is None
    await asyncio.sleep(0)  # the loop's turn hands over what was put
    store.close()
