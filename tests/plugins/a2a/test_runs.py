"""A message is a plan and a task is its run: told step by step, cancelled, asked about, refused whole."""

from __future__ import annotations

import asyncio
import base64
import json
import re
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import msgspec
import pytest

from configuration import key, role
from expiring import LIFE, brief_key
from plugins.a2a.agent import KEY_BETA, agent, caller, data, rpc, sent, text
from plugins.a2a.receiver import BOUND
from rcp_gateway.testing import SteppedClock
from rcp_kernel.model import Resource
from transports.robot import Site, until

pytestmark = pytest.mark.anyio
GO = "execute /action/go 5"
CAREFUL = (
    role("careful", approve=["/action/go"])
    + role("careful-alone", approve=["/action/go"], approve_own=True)
    + key("careful", "key-of-who-is-careful", role=["operator", "careful"])
    + key("alone", "key-of-who-is-alone", role=["operator", "careful-alone"])
    + key("boss", "key-of-the-boss-of-all", role="admin")
)
CAREFUL_KEY, ALONE_KEY, BOSS_KEY = (
    "key-of-who-is-careful", "key-of-who-is-alone", "key-of-the-boss-of-all",
)  # fmt: skip


class View(msgspec.Struct, frozen=True):
    """A picture."""

    format: str
    data: bytes


def state(task: dict[str, Any]) -> str:
    return task["status"]["state"].removeprefix("TASK_STATE_")


def said(task: dict[str, Any]) -> str:
    return task["status"]["message"]["parts"][0]["text"]


def facts(task: dict[str, Any]) -> dict[str, Any]:
    return task["status"]["message"]["parts"][1]["data"]


class Stream:
    """The events of a stream, one after the other."""

    def __init__(self, lines: AsyncIterator[str]) -> None:
        self._lines = lines
        self.seen: list[dict[str, Any]] = []

    async def next(self) -> dict[str, Any] | None:
        async with asyncio.timeout(BOUND):
            async for line in self._lines:
                if line.startswith("data:"):
                    self.seen.append(json.loads(line[5:]))
                    return self.seen[-1]
        return None

    async def until(self, wanted: str) -> dict[str, Any]:
        while (event := await self.next()) is not None:
            found = event.get("task") or event.get("statusUpdate")
            if found is not None and state(found) == wanted:
                return found
        raise AssertionError(f"no {wanted} in {self.seen}")

    async def rest(self) -> list[dict[str, Any]]:
        while await self.next() is not None:
            pass
        return self.seen


@asynccontextmanager
async def streamed(
    client: httpx.AsyncClient, method: str, path: str, **kw: Any
) -> AsyncGenerator[Stream]:
    async with client.stream(method, path, **kw) as answer:
        assert answer.status_code == 200
        assert answer.headers["content-type"].startswith("text/event-stream")
        yield Stream(answer.aiter_lines())


async def ended(client: httpx.AsyncClient, id_: str) -> dict[str, Any]:
    """Wait until a task has ended."""
    async with asyncio.timeout(BOUND):
        while True:
            task = (await client.get(f"/a2a/tasks/{id_}")).json()
            if state(task) in ("COMPLETED", "FAILED", "CANCELED", "REJECTED"):
                return task
            await asyncio.sleep(0.02)


async def begun(client: httpx.AsyncClient, site: Site, params: dict[str, Any]) -> str:
    """Send a message without waiting; returns the task's id once the robot moves."""
    configuration = params.setdefault("configuration", {})
    configuration["returnImmediately"] = True
    id_ = (await sent(client, params))["id"]
    async with asyncio.timeout(BOUND):
        await site.robot.started.get()
    return id_


# -- from beginning to end -------------------------------------------------------------------------


async def test_a_stream_tells_each_step_and_ends_with_the_plan(
    gateway: Site, client: httpx.AsyncClient
) -> None:
    gateway.robot.release.set()
    plan = {
        "steps": [
            {"do": "execute", "path": "/service/add", "value": 1, "id": "first"},
            {"do": "execute", "path": "/action/go", "value": {"$result": "first"}},
        ]
    }
    async with streamed(client, "POST", "/a2a/message:stream", json=data(plan)) as stream:
        seen = await stream.rest()
    assert state(seen[0]["task"]) == "SUBMITTED"
    states = [state(e["statusUpdate"]) for e in seen if "statusUpdate" in e]
    assert states[0] == "WORKING"
    assert states[-1] == "COMPLETED"
    artifacts = [e["artifactUpdate"]["artifact"] for e in seen if "artifactUpdate" in e]
    assert [a["artifactId"] for a in artifacts] == ["step-first", "step-2"]
    assert [a["parts"][0]["data"]["result"] for a in artifacts] == [2.0, 2.0]
    task = (await client.get(f"/a2a/tasks/{seen[0]['task']['id']}")).json()
    assert [a["artifactId"] for a in task["artifacts"]] == ["step-first", "step-2"]


@pytest.mark.parametrize(
    "params",
    [
        text("execute /service/add 1"),
        text("(add alpha 1)"),
        text('{"lines": "execute /service/add 1"}'),
        data({"symbolic": "(add alpha 1)"}),
        data("execute /service/add 1"),
    ],
    ids=["line", "symbolic", "json text", "symbolic data", "string data"],
)
async def test_every_notation_of_a_plan_is_understood(
    client: httpx.AsyncClient, params: dict[str, Any]
) -> None:
    task = await sent(client, params)
    assert state(task) == "COMPLETED", said(task)
    assert task["artifacts"][0]["parts"][0]["data"]["result"] == 2.0


async def test_a_whole_number_stays_one_on_its_way_to_a_step(client: httpx.AsyncClient) -> None:
    wait = {"do": "sequence", "steps": [{"do": "read", "path": "/sensor/pose"}]}
    plan = {"steps": [{**wait, "retry": {"times": 2}}]}
    assert state(await sent(client, data(plan))) == "COMPLETED"


async def test_times_are_told_in_milliseconds(client: httpx.AsyncClient) -> None:
    task = await sent(client, text("execute /service/add 1"))
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d{3})?Z", task["status"]["timestamp"])


async def test_a_client_that_takes_text_only_gets_no_data(client: httpx.AsyncClient) -> None:
    modes = {"acceptedOutputModes": ["text/plain"]}
    task = await sent(client, text("execute /service/add 1", configuration=modes))
    (part,) = task["artifacts"][0]["parts"]
    _, written, _ = re.split(r"\n?\[(?:end of )?robot-data \w+\]\n?", part["text"])
    assert json.loads(written)["result"] == 2.0


async def test_who_does_not_wait_gets_the_task_at_once(
    gateway: Site, client: httpx.AsyncClient
) -> None:
    id_ = await begun(client, gateway, text(GO))
    task = (await client.get(f"/a2a/tasks/{id_}")).json()
    assert state(task) in ("SUBMITTED", "WORKING")
    gateway.robot.release.set()
    assert state(await ended(client, id_)) == "COMPLETED"


async def test_a_step_that_fails_ends_the_task_with_its_error(
    gateway: Site, client: httpx.AsyncClient
) -> None:
    task = await sent(client, text("execute /action/go 200"))
    assert state(task) == "FAILED"
    assert "too far" in said(task)
    assert facts(task)["code"] == "device_rejected"
    assert task["artifacts"][0]["metadata"]["state"] == "failed"


async def test_a_dry_run_tells_what_would_be_sent_and_moves_nothing(
    gateway: Site, client: httpx.AsyncClient
) -> None:
    task = await sent(client, text(GO, metadata={"dry_run": True}))
    assert state(task) == "COMPLETED"
    (check,) = task["artifacts"]
    assert check["parts"][0]["data"]["steps"][0]["path"] == "/tenant/alpha/action/go"
    assert gateway.robot.started.empty()


async def test_a_plan_with_faults_is_rejected_with_all_of_them(
    gateway: Site, client: httpx.AsyncClient
) -> None:
    plan = {
        "steps": [
            {"do": "execute", "path": "/action/go", "value": 1},
            {"do": "execute", "path": "/service/nowhere"},
            {"do": "write", "path": "/param/limit", "value": 9},
        ]
    }
    task = await sent(client, data(plan))
    assert state(task) == "REJECTED"
    faults = facts(task)["details"]["faults"]
    assert [(f["step"], f["code"]) for f in faults] == [
        ("2", "unknown_path"),
        ("3", "out_of_range"),
    ]
    assert gateway.robot.started.empty()


async def test_who_may_only_look_is_refused_by_a_rejected_task(gateway: Site) -> None:
    async with caller(gateway, None) as client:
        task = await sent(client, text(GO))
        assert state(task) == "REJECTED"
        assert gateway.robot.started.empty()


async def test_a_plan_never_leaves_the_tenants_of_its_sender(gateway: Site) -> None:
    async with caller(gateway, KEY_BETA) as client:
        hidden = await sent(client, text("execute /tenant/alpha/action/go 5"))
        none = await sent(client, text("execute /tenant/alpha/action/leap 5"))
        assert state(hidden) == state(none) == "REJECTED"
        assert said(hidden).replace("go", "leap") == said(none)


# -- cancel, and cuts ------------------------------------------------------------------------------


async def test_a_cancel_reaches_the_robot_before_it_is_answered(
    gateway: Site, client: httpx.AsyncClient
) -> None:
    id_ = await begun(client, gateway, text(GO))
    task = (await client.post(f"/a2a/tasks/{id_}:cancel", json={})).json()
    assert state(task) == "CANCELED"
    assert not gateway.server.gateway.commands.running
    assert task["artifacts"][0]["metadata"]["state"] == "cancelled"


async def test_a_stream_ends_with_the_cancel_of_another_connection(
    gateway: Site, client: httpx.AsyncClient
) -> None:
    async with streamed(client, "POST", "/a2a/message:stream", json=text(GO)) as stream:
        id_ = (await stream.until("WORKING"))["taskId"]
        await gateway.robot.started.get()
        answer = await rpc(client, "CancelTask", id=id_)
        assert state(answer["result"]) == "CANCELED"
        await stream.until("CANCELED")
        assert await stream.next() is None


async def test_a_task_goes_on_without_its_client_and_is_followed_again(
    gateway: Site, client: httpx.AsyncClient
) -> None:
    async with streamed(client, "POST", "/a2a/message:stream", json=text(GO)) as stream:
        id_ = (await stream.until("WORKING"))["taskId"]
    await gateway.robot.started.get()
    async with streamed(client, "GET", f"/a2a/tasks/{id_}:subscribe") as stream:
        first = await stream.next()
        assert first is not None
        assert first["task"]["id"] == id_
        gateway.robot.release.set()
        await stream.until("COMPLETED")
        assert await stream.next() is None


async def test_a_stream_whose_request_has_a_body_without_an_end_ends() -> None:
    async with (
        asyncio.timeout(BOUND),
        agent(more="[limits]\nmessage = 100_000") as gateway,
        caller(gateway) as client,
    ):
        id_ = await begun(client, gateway, text(GO))

        async def endless() -> AsyncGenerator[bytes]:
            while True:
                yield bytes(4096)

        with suppress(httpx.HTTPError):
            await client.request("GET", f"/a2a/tasks/{id_}:subscribe", content=endless())


async def test_a_task_under_way_takes_no_messages(gateway: Site, client: httpx.AsyncClient) -> None:
    id_ = await begun(client, gateway, text(GO))
    answer = await rpc(client, "SendMessage", **text("execute /service/add 1", taskId=id_))
    assert answer["error"]["code"] == -32004
    gateway.robot.release.set()
    assert state(await ended(client, id_)) == "COMPLETED"


async def test_a_stop_of_the_gateway_ends_streams_and_tells_why() -> None:
    async with AsyncExitStack() as stack:
        site = await stack.enter_async_context(agent())
        async with (
            caller(site) as client,
            streamed(client, "POST", "/a2a/message:stream", json=text(GO)) as stream,
        ):
            await stream.until("WORKING")
            await site.robot.started.get()
            async with asyncio.timeout(BOUND):
                ending = asyncio.ensure_future(stack.aclose())
                await stream.rest()
                await ending


async def test_a_stream_ends_with_the_proof_of_its_client(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rcp_kernel.sessions.credential_expiry._LOOK", 0.05)
    time = SteppedClock()
    async with (
        agent(clock=time.clock) as site,
        caller(site, brief_key(site.server)) as client,
        streamed(client, "POST", "/a2a/message:stream", json=text(GO)) as stream,
    ):
        await stream.until("WORKING")
        time.adjust(LIFE + 1)
        await stream.rest()
        assert (await client.get("/a2a/tasks")).status_code == 401


async def test_a_stop_of_the_gateway_leaves_the_task_failed(tmp_path: Path) -> None:
    async with agent(folder=tmp_path) as site, caller(site) as client:
        id_ = await begun(client, site, text(GO))
    async with agent(folder=tmp_path) as site, caller(site) as client:
        task = (await client.get(f"/a2a/tasks/{id_}")).json()
        assert state(task) == "FAILED"
        assert "stopped" in said(task) or "restarted" in said(task)


# -- what is asked ---------------------------------------------------------------------------------


@pytest.mark.parametrize("answer", [{"1": 4}, 4, "4"], ids=["by step", "alone", "as text"])
async def test_a_parameter_that_lacks_is_asked_for_and_the_plan_goes_on(
    client: httpx.AsyncClient, answer: Any
) -> None:
    task = await sent(client, text("execute /service/add"))
    assert state(task) == "INPUT_REQUIRED"
    (missing,) = facts(task)["missing"]
    assert (missing["step"], missing["path"]) == ("1", "/tenant/alpha/service/add")
    assert missing["schema"]["type"] == "number"
    useless = await sent(client, text("what?", taskId=task["id"]))
    assert state(useless) == "INPUT_REQUIRED"
    done = await sent(client, data(answer, taskId=task["id"], messageId="m-2"))
    assert done["id"] == task["id"]
    assert done["contextId"] == task["contextId"]
    assert state(done) == "COMPLETED", said(done)
    assert done["artifacts"][0]["parts"][0]["data"]["result"] == 5.0


async def test_of_two_answers_at_once_one_counts(client: httpx.AsyncClient) -> None:
    task = await sent(client, text("execute /service/add"))
    answers = (data({"1": 4}, taskId=task["id"]), data({"1": 4}, taskId=task["id"]))
    done = await asyncio.gather(
        *(client.post("/a2a/message:send", json=answer) for answer in answers)
    )
    assert sorted(d.status_code for d in done) in ([200, 200], [200, 400])
    over = (await client.get(f"/a2a/tasks/{task['id']}")).json()
    assert state(over) == "COMPLETED"
    assert len(over["artifacts"]) == 1


async def test_a_question_may_be_answered_by_another_plan(client: httpx.AsyncClient) -> None:
    task = await sent(client, text("execute /service/add"))
    done = await sent(client, text("execute /service/add 2", taskId=task["id"]))
    assert state(done) == "COMPLETED", said(done)


async def test_a_task_that_waits_for_an_answer_can_be_cancelled(client: httpx.AsyncClient) -> None:
    task = await sent(client, text("execute /service/add"))
    answer = await rpc(client, "CancelTask", id=task["id"])
    assert state(answer["result"]) == "CANCELED"
    more = await rpc(client, "SendMessage", **text("execute /service/add 1", taskId=task["id"]))
    assert more["error"]["code"] == -32004


async def test_a_task_that_nobody_answers_fails() -> None:
    async with agent("input_timeout = 0.05") as site, caller(site) as client:
        task = await sent(client, text("execute /service/add"))
        over = await ended(client, task["id"])
        assert (state(over), "No answer" in said(over)) == ("FAILED", True)


@pytest.fixture
async def careful() -> AsyncGenerator[Site]:
    async with agent(more=CAREFUL) as made:
        made.robot.release.set()
        yield made


async def test_an_approval_is_asked_for_and_given_by_the_client_where_a_rule_lets_it(
    careful: Site,
) -> None:
    async with caller(careful, ALONE_KEY) as client:
        task = await sent(client, text(GO))
        assert state(task) == "INPUT_REQUIRED"
        assert facts(task)["question"] == "approval"
        assert careful.robot.started.empty()
        useless = await sent(client, data({"decision": "perhaps"}, taskId=task["id"]))
        assert state(useless) == "INPUT_REQUIRED"
        done = await sent(client, data({"decision": "approve"}, taskId=task["id"]))
        assert state(done) == "COMPLETED", said(done)


async def test_a_client_never_approves_its_own_without_such_a_rule(careful: Site) -> None:
    async with caller(careful, CAREFUL_KEY) as client, caller(careful, BOSS_KEY) as boss:
        task = await sent(client, text(GO))
        assert state(task) == "AUTH_REQUIRED"
        again = await sent(client, text("approve", taskId=task["id"]))
        assert state(again) == "AUTH_REQUIRED"
        assert careful.robot.started.empty()
        await decide(boss, facts(again)["approval"], "approve")
        done = await ended(client, task["id"])  # without another message
        assert state(done) == "COMPLETED", said(done)


async def decide(boss: httpx.AsyncClient, approval: str, decision: str) -> None:
    body = {"id": approval, "decision": decision, "reason": "because"}
    decided = await boss.post("/rcp/v1/context/system/approvals?wait=5", json=body)
    assert decided.status_code == 200, decided.text


async def test_a_task_ends_when_somebody_else_rejects_it(careful: Site) -> None:
    async with caller(careful, CAREFUL_KEY) as client, caller(careful, BOSS_KEY) as boss:
        task = await sent(client, text(GO))
        await decide(boss, facts(task)["approval"], "reject")
        over = await ended(client, task["id"])
        assert state(over) == "REJECTED"
        assert "because" in said(over)
        assert careful.robot.started.empty()


async def test_a_task_that_waits_survives_a_restart(tmp_path: Path) -> None:
    async with agent(folder=tmp_path) as first, caller(first) as client:
        task = await sent(client, text("execute /action/go"))
        assert state(task) == "INPUT_REQUIRED"
        other = await sent(client, text("execute /action/go"))
    async with agent(folder=tmp_path) as second, caller(second) as client:
        second.robot.release.set()
        found = (await client.get(f"/a2a/tasks/{task['id']}")).json()
        assert state(found) == "INPUT_REQUIRED"
        assert facts(found)["question"] == "parameters"
        done = await sent(client, data({"1": 2}, taskId=task["id"]))
        assert state(done) == "COMPLETED", said(done)
        gone = await client.post(f"/a2a/tasks/{other['id']}:cancel", json={})
        assert state(gone.json()) == "CANCELED"
        running = await begun(client, second, text("execute /service/add 1"))
        assert state(await ended(client, running)) == "COMPLETED"


async def test_a_task_that_waited_for_too_long_over_a_restart_has_failed(tmp_path: Path) -> None:
    async with agent(folder=tmp_path) as first, caller(first) as client:
        task = await sent(client, text("execute /action/go"))
    async with agent("input_timeout = 0.05", folder=tmp_path) as second, caller(second) as client:
        over = await ended(client, task["id"])
        assert state(over) == "FAILED"
        assert "answered" in said(over)


async def test_an_approval_is_asked_for_again_after_a_restart(tmp_path: Path) -> None:
    async with agent(more=CAREFUL, folder=tmp_path) as first, caller(first, ALONE_KEY) as client:
        task = await sent(client, text(GO))
        assert state(task) == "INPUT_REQUIRED"
    async with agent(more=CAREFUL, folder=tmp_path) as second, caller(second, ALONE_KEY) as client:
        second.robot.release.set()
        again = await sent(client, text("approve", taskId=task["id"]))
        assert state(again) == "INPUT_REQUIRED"
        assert facts(again)["approval"] != facts(task)["approval"]
        done = await sent(client, text("approve", taskId=task["id"]))
        assert state(done) == "COMPLETED", said(done)


@pytest.mark.parametrize("modes", [None, ["image/png", "application/json"], ["application/json"]])
async def test_an_image_is_a_file_part(
    gateway: Site, client: httpx.AsyncClient, modes: list[str] | None
) -> None:
    pixels = b"\x89PNG" + bytes(100)
    gateway.robot.host.declare(
        Resource(name="sensor/picture", description="A view.", value=View, live=True)
    )
    gateway.robot.host.publish("sensor/picture", View("png", pixels))
    configuration = None if modes is None else {"acceptedOutputModes": modes}
    task = await sent(client, text("read /sensor/picture", configuration=configuration))
    parts = task["artifacts"][0]["parts"]
    if modes == ["application/json"]:
        assert base64.b64decode(parts[0]["data"]["result"]["data"]) == pixels
        return
    step, picture = parts
    assert (picture["mediaType"], picture["filename"]) == ("image/png", "step-1-1.png")
    assert base64.b64decode(picture["raw"]) == pixels
    assert "step-1-1.png" in step["data"]["result"]["data"]


async def test_a_rejected_approval_ends_the_task_with_the_reason(careful: Site) -> None:
    async with caller(careful, CAREFUL_KEY) as client:
        task = await sent(client, text(GO))
        no = {"decision": "reject", "reason": "people are near"}
        over = await sent(client, data(no, taskId=task["id"]))
        assert state(over) == "REJECTED"
        assert "people are near" in said(over)
        assert careful.robot.started.empty()


async def test_nothing_of_a_run_is_left_behind(gateway: Site, client: httpx.AsyncClient) -> None:
    gateway.robot.release.set()
    await asyncio.gather(*(sent(client, text("execute /service/add 1")) for _ in range(10)))
    before = len(asyncio.all_tasks())
    await asyncio.gather(*(sent(client, text("execute /service/add 1")) for _ in range(10)))
    await until(lambda: len(asyncio.all_tasks()) <= before)
