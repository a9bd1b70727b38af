"""Services and actions that pages offer: others call them, over rosbridge and any other interface."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from typing import Any

import msgspec
import pytest

from configuration import backend, key, role, rule
from plugins.rosbridge.rig import OPEN, OPERATOR, ROVER, Page, Site, page, site
from rcp_clients import CLIENTS
from rcp_kernel.spi import Backend, Host
from rcp_rosbridge import offering
from rcp_rosbridge.graph import Graph

ADD, GO = "/add_two_ints", "/go"
ADDED = "/tenant/alpha/service/clients/add_two_ints"
GONE = "/tenant/alpha/action/clients/go"
OFFERS = backend("offered", use="clients", offers_of_one=3, waiting=2, service_timeout=5.0)
GUEST = "guest-of-these-tests"
CALLER = role(
    "caller", rule("*", "/tenant/alpha/**"), deny=[rule("execute", "/action/clients/offer")]
) + key("caller", GUEST)


@pytest.fixture
async def gateway() -> AsyncGenerator[Site]:
    async with site(OPEN, ROVER, OFFERS, CALLER, kinds=(CLIENTS,)) as made:
        yield made


@pytest.fixture
async def provider(gateway: Site) -> AsyncGenerator[Page]:
    async with page(gateway) as made:
        yield made


@pytest.fixture
async def caller(gateway: Site) -> AsyncGenerator[Page]:
    async with page(gateway) as made:
        yield made


async def offer(provider: Page, caller: Page, name: str = ADD, **more: Any) -> None:
    """Offer a service, and wait until another client sees it."""
    await provider.send(op="advertise_service", service=name, **more)
    await listed(caller, name)


async def listed(caller: Page, name: str, *, present: bool = True) -> None:
    """Wait until a service is there, or is not."""
    async with asyncio.timeout(60):
        while (name in (await caller.values("/rosapi/services"))["services"]) != present:
            pass


async def answer(provider: Page, name: str = ADD, **response: Any) -> dict[str, Any]:
    """Answer the next call; return it."""
    call = await provider.op("call_service", service=name)
    await provider.send(op="service_response", service=name, id=call["id"], **response)
    return call


async def test_a_page_calls_what_another_page_offers(provider: Page, caller: Page) -> None:
    await offer(provider, caller, type="example_interfaces/srv/AddTwoInts")
    found = await caller.call("/rosapi/service_type", {"service": ADD})
    assert found["values"]["type"] == "example_interfaces/srv/AddTwoInts"
    await caller.send(op="call_service", id="c", service=ADD, args={"a": 1, "b": 2})
    call = await answer(provider, values={"sum": 3}, result=True)
    assert call["args"] == {"a": 1, "b": 2}
    response = await caller.op("service_response", id="c")
    assert (response["result"], response["values"]) == (True, {"sum": 3})


async def test_other_clients_call_it_by_its_path(
    gateway: Site, provider: Page, caller: Page
) -> None:
    await offer(provider, caller, type="std_srvs/srv/SetBool")
    client = gateway.served.client(OPERATOR)
    shown = await client.request("discover", ADDED)
    assert shown["body"]["resources"][0]["meta"]["offered"]["by"] == "anonymous"
    wrong = await client.request("execute", ADDED, body={"data": "yes"})
    assert wrong["error"]["code"] == "invalid_value"
    id_ = await client.send(type="execute", path=ADDED, body={"data": True})
    await answer(provider, values={"success": True, "message": "set"}, result=True)
    assert (await client.final(id_))["body"] == {"success": True, "message": "set"}


async def test_a_failure_has_its_reason(gateway: Site, provider: Page, caller: Page) -> None:
    await offer(provider, caller)
    for values, told in (("no water", "no water"), ({"x": 1}, "has failed")):
        await caller.send(op="call_service", id="c", service=ADD)
        await answer(provider, values=values, result=False)
        response = await caller.op("service_response", id="c")
        assert response["result"] is False
        assert told in response["values"]
    client = gateway.served.client(OPERATOR)
    id_ = await client.send(type="execute", path=ADDED)
    await answer(provider, values="no water", result=False)
    reply = await client.final(id_)
    assert (reply["status"], reply["error"]["code"]) == ("failed", "device_rejected")
    assert reply["message"] == "no water"


async def test_calls_end_when_the_page_goes(gateway: Site, caller: Page) -> None:
    client = gateway.served.client(OPERATOR)
    async with page(gateway) as provider:
        await offer(provider, caller)
        await caller.send(op="call_service", id="taken", service=ADD)
        await provider.op("call_service")
        await caller.send(op="call_service", id="next", service=ADD)
        await provider.op("call_service")
    for id_ in ("taken", "next"):
        response = await caller.op("service_response", id=id_)
        assert response["result"] is False
        assert "has gone, or offers it no more" in response["values"]
    await listed(caller, ADD, present=False)
    assert (await client.request("execute", ADDED))["error"]["code"] == "unknown_path"


async def test_a_page_withdraws_what_it_offers_and_offers_it_again(
    provider: Page, caller: Page
) -> None:
    await offer(provider, caller)
    for _ in range(2):
        await provider.send(op="unadvertise_service", service=ADD)
        await provider.send(op="advertise_service", service=ADD)
        await listed(caller, ADD)
    await provider.send(op="unadvertise_service", service=ADD)
    await listed(caller, ADD, present=False)
    await provider.send(op="unadvertise_service", service=ADD)
    await provider.status("was not advertised")


async def test_an_action_has_feedback_a_result_and_a_cancel(provider: Page, caller: Page) -> None:
    await provider.send(op="advertise_action", action=GO, type="my_msgs/action/Go")
    async with asyncio.timeout(60):
        while GO not in (await caller.values("/rosapi/action_servers"))["action_servers"]:
            pass
    goal = {"op": "send_action_goal", "action": GO, "feedback": True, "args": {"x": 1}}
    await caller.send(**goal, id="g1")
    call = await provider.op("send_action_goal", action=GO)
    assert (call["args"], call["action_type"]) == ({"x": 1}, "my_msgs/action/Go")
    mine = {"action": GO, "id": call["id"]}
    await provider.send(op="action_feedback", **mine, values={"left": 2})
    assert (await caller.op("action_feedback", id="g1"))["values"] == {"left": 2}
    await provider.send(op="action_result", **mine, values={"ok": 1}, status=4, result=True)
    result = await caller.op("action_result", id="g1")
    assert (result["values"], result["status"], result["result"]) == ({"ok": 1}, 4, True)

    await caller.send(**goal, id="g2")
    call = await provider.op("send_action_goal", action=GO)
    await caller.send(op="cancel_action_goal", action=GO, id="g2")
    assert (await provider.op("cancel_action_goal", action=GO))["id"] == call["id"]
    end = {"op": "action_result", "action": GO, "id": call["id"], "values": {}}
    await provider.send(**end, status=5, result=False)
    assert (await caller.op("action_result", id="g2"))["status"] == 5

    await caller.send(**goal, id="g3")
    end["id"] = (await provider.op("send_action_goal", action=GO))["id"]
    await provider.send(**{**end, "values": "blocked"}, status=6, result=False)
    result = await caller.op("action_result", id="g3")
    assert result["status"] == 6
    assert "blocked" in result["values"]


async def test_a_page_that_does_not_answer_is_not_waited_for(
    gateway: Site, provider: Page, caller: Page
) -> None:
    await offer(provider, caller)
    response = await caller.call(ADD, timeout=0.2)
    assert response["result"] is False
    assert "did not finish within 0.2 s" in response["values"]
    await answer(provider, values={}, result=True)
    await provider.status("has ended")
    await provider.send(op="service_response", service=ADD, id="nix", values={})
    await provider.status("waits for an answer")
    assert not gateway.kernel.commands.running or len(gateway.kernel.commands.running) == 1


async def test_names_that_exist_are_refused(
    monkeypatch: pytest.MonkeyPatch, gateway: Site, provider: Page, caller: Page
) -> None:
    monkeypatch.setattr(offering, "_AGAIN", 0.01)
    await provider.send(op="advertise_service", service="/reset_system", id="1")
    assert (await provider.status("/reset_system exists already"))["id"] == "1"
    await offer(provider, caller)
    await caller.send(op="advertise_service", service=ADD, id="2")
    assert (await caller.status("exists already"))["id"] == "2"
    client = gateway.served.client(OPERATOR)
    for name, code in ((ADD, "already_running"), ("take", "precondition_failed")):
        body = {"name": name}
        reply = await client.request("execute", "/tenant/alpha/action/clients/offer", body=body)
        assert reply["error"]["code"] == code
    await caller.send(op="advertise_service", service="/a b", id="3")
    await caller.status("/a b")


async def test_a_page_that_was_loaded_again_has_its_name_again(gateway: Site, caller: Page) -> None:
    async with page(gateway) as old, page(gateway) as new:
        await offer(old, caller)
        await new.send(op="advertise_service", service=ADD)
        await new.values("/rosapi/get_time")
        await old.socket.close()
        await caller.values("/rosapi/get_time")
        async with asyncio.timeout(60):
            while True:
                await caller.send(op="call_service", id="c", service=ADD, timeout=5)
                done = asyncio.ensure_future(caller.op("service_response", id="c"))
                asked = asyncio.ensure_future(new.op("call_service", service=ADD))
                await asyncio.wait((done, asked), return_when=asyncio.FIRST_COMPLETED)
                if asked.done():
                    break
                asked.cancel()
        call = asked.result()
        await new.send(op="service_response", service=ADD, id=call["id"], values={"x": 1})
        assert (await done)["values"] == {"x": 1}


async def test_the_right_to_offer_is_a_right(gateway: Site, provider: Page, caller: Page) -> None:
    async with page(gateway, GUEST) as guest:
        await guest.send(op="advertise_service", service=ADD, id="1")
        told = await guest.status("cannot offer")
        assert (told["id"], told["level"]) == ("1", "error")
        await offer(provider, caller)
        await guest.send(op="call_service", id="c", service=ADD)
        call = await provider.op("call_service", service=ADD)
        # Only who offers it may answer.
        stranger = gateway.served.client(GUEST)
        path = "/tenant/alpha/service/clients/respond"
        reply = await stranger.request("execute", path, body={"call": call["id"], "output": {}})
        assert reply["error"]["code"] == "unknown_path"
        mine = {"service": ADD, "id": call["id"]}
        await provider.send(op="service_response", **mine, values={"y": 2}, result=True)
        assert (await guest.op("service_response", id="c"))["values"] == {"y": 2}


async def test_without_such_a_backend_clients_are_told() -> None:
    async with site(OPEN, ROVER) as gateway, page(gateway) as client:
        await client.send(op="advertise_service", service=ADD, id="1")
        assert "backend `clients`" in (await client.status("cannot offer"))["msg"]


async def test_what_a_page_offers_before_all_is_open_is_offered_when_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As by a page that is back sooner than all backends of a gateway that was started again."""
    opens = asyncio.Event()

    @asynccontextmanager
    async def late(config: Any, host: Host) -> AsyncGenerator[Backend]:
        await opens.wait()
        async with CLIENTS.open(config, host) as backend:
            yield backend

    monkeypatch.setattr("rcp_gateway.server._FIRST_OPEN", 0.01)
    monkeypatch.setattr(offering, "_OPENING", 0.01)
    kind = msgspec.structs.replace(CLIENTS, open=late)
    async with (
        site(OPEN, ROVER, OFFERS, kinds=(kind,)) as gateway,
        page(gateway) as provider,
        page(gateway) as caller,
    ):
        for id_, name in (("1", ADD), ("2", "/not_this")):
            await provider.send(op="advertise_service", service=name, id=id_)
            told = await provider.status("nothing here takes offers yet")
            assert (told["id"], told["level"]) == (id_, "warning")
        await provider.send(op="unadvertise_service", service="/not_this")
        opens.set()
        await listed(caller, ADD)
        await caller.send(op="call_service", id="c", service=ADD)
        await answer(provider, values={"sum": 3}, result=True)
        assert (await caller.op("service_response", id="c"))["values"] == {"sum": 3}
        found = (await caller.values("/rosapi/services"))["services"]
        assert "/not_this" not in found


async def test_offers_and_calls_are_bounded(gateway: Site, provider: Page, caller: Page) -> None:
    for number in range(3):
        await offer(provider, caller, f"/s{number}")
    await provider.send(op="advertise_service", service="/s3", id="4")
    assert (await provider.status("at most"))["id"] == "4"
    for number in range(3):
        await caller.send(op="call_service", id=f"c{number}", service="/s0")
    response = await caller.op("service_response", id="c2")
    assert response["result"] is False
    assert "wait for the client that offers it" in response["values"]


async def test_any_client_offers_by_the_gateways_own_protocol(gateway: Site, caller: Page) -> None:
    client = gateway.served.client(OPERATOR)
    body = {"name": "hello", "description": "Says hello."}
    id_ = await client.send(type="execute", path="/action/clients/offer", body=body)
    await client.until(lambda m: m.get("id") == id_ and m.get("status") == "in_progress")
    await caller.send(op="call_service", id="c", service="/hello", args={"who": "me"})
    told = await client.until(lambda m: bool((m.get("body") or {}).get("calls")))
    call = told["body"]["calls"][0]
    taken = await client.request("execute", "/service/clients/take", body={"call": call})
    assert taken["body"]["input"] == {"who": "me"}
    again = await client.request("execute", "/service/clients/take", body={"call": call})
    assert again["error"]["code"] == "unknown_path"
    done = {"call": call, "output": {"said": "hello me"}}
    await client.request("execute", "/service/clients/respond", body=done)
    assert (await caller.op("service_response", id="c"))["values"] == {"said": "hello me"}
    await client.close()
    await listed(caller, "/hello", present=False)


def test_no_client_takes_the_name_of_a_robots_own_service() -> None:
    def facts(path: str, **meta: Any) -> dict[str, Any]:
        schemas = {"input": {"type": "object", "properties": {}}}
        common = {"kind": "service", "operations": ["execute"], "schemas": schemas}
        return {"path": path, "backend": path.split("/")[4], "meta": meta, **common}

    graph = Graph("a")
    offered = {"name": "/stop", "type": "", "by": "eve"}
    robots = facts("/tenant/a/service/rover/stop", service="/stop", type="std_srvs/srv/Trigger")
    for _ in graph.build([facts("/tenant/a/service/clients/stop", offered=offered), robots]):
        pass
    found = graph.service("/stop")
    assert found is not None
    assert found.path == robots["path"]


async def test_a_call_is_answered_by_nobody_else_of_the_same_name() -> None:
    namesake = key("anonymous", GUEST, role="operator")
    async with (
        site(OPEN, ROVER, OFFERS, namesake, kinds=(CLIENTS,)) as gateway,
        page(gateway) as provider,
        page(gateway) as caller,
        page(gateway, GUEST) as other,
    ):
        await offer(provider, caller)
        calling = asyncio.create_task(caller.call(ADD, {"a": 1}))
        call = await provider.op("call_service", service=ADD)
        answer = {"call": call["id"], "output": {"sum": 0}}
        refused = await other.call("/tenant/alpha/service/clients/respond", answer)
        assert refused["result"] is False
        assert "has ended" in refused["values"]
        right = {"op": "service_response", "service": ADD, "id": call["id"], "result": True}
        await provider.send(**right, values={"sum": 3})
        assert (await calling)["values"] == {"sum": 3}
