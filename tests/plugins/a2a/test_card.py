"""The card says what the agent can do for whom, where it is, and can be verified."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Generator
from time import thread_time
from types import SimpleNamespace
from typing import Any

import httpx
import jwt
import pytest
from a2a.client import A2ACardResolver
from a2a.server.request_handlers.response_helpers import agent_card_to_dict
from a2a.types.a2a_pb2 import AgentCard, AgentSkill
from a2a.utils.signing import create_signature_verifier
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, rsa
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from google.protobuf.json_format import ParseDict

from configuration import key, role, rule
from plugins.a2a.agent import VERSION, agent, caller, data, rpc, sent, text
from plugins.a2a.rover import OPERATOR, rovers
from rcp_a2a.signing import CardKey
from rcp_a2a.skills import skills_of
from rcp_gateway.api import Query
from rcp_kernel.errors import ConfigError
from rcp_web.untrusted import TextMarker
from transports.robot import Site

pytestmark = pytest.mark.anyio
CARD = "/.well-known/agent-card.json"
MANY = 2_000  # services
MUTE = "key-of-who-may-not-plan"
MOVERS = '[anonymous]\nrole = "operator"'


def skills(card: dict[str, Any]) -> list[str]:
    return [skill["id"] for skill in card["skills"]]


async def test_the_public_card_has_what_anonymous_may_execute() -> None:
    async with agent(more=MOVERS) as site, caller(site, None) as client:
        card = (await client.get(CARD)).json()
        assert skills(card) == [
            "plan",
            "stop",
            "robots",
            "action.go",
            "service.add",
            "service.hold",
        ]
        go = next(one for one in card["skills"] if one["id"] == "action.go")
        assert "m" in go["description"]
        assert go["examples"]


async def test_the_robots_are_listed_by_a_task() -> None:
    async with agent() as site, caller(site) as client:
        card = (await rpc(client, "GetExtendedAgentCard"))["result"]
        (skill,) = (one for one in card["skills"] if one["id"] == "robots")
        for example, form in zip(skill["examples"], (data, text), strict=True):
            said = json.loads(example) if form is data else example
            task = await sent(client, form(said))
            (artifact,) = task["artifacts"]
            robots = artifact["parts"][0]["data"]["result"]
            assert [one["path"] for one in robots] == ["/tenant/alpha", "/tenant/beta"]
    async with agent(top="[features]\ninventory = false") as site, caller(site) as client:
        card = (await rpc(client, "GetExtendedAgentCard"))["result"]
        assert "robots" not in skills(card)


async def test_the_public_card_reveals_nothing_to_those_who_may_only_look(gateway: Site) -> None:
    async with caller(gateway, None) as client:
        assert skills((await client.get(CARD)).json()) == ["plan"]
        assert "alpha" not in (await client.get(CARD)).text


async def test_the_card_of_a_hidden_tenant_is_as_that_of_none() -> None:
    closed = '[anonymous]\nrole = "operator"\ntenants = ["alpha"]'
    async with agent(more=closed) as site, caller(site, None) as client:
        assert "action.go" in skills((await client.get(f"/a2a/alpha{CARD}")).json())
        hidden = (await client.get(f"/a2a/beta{CARD}")).text
        none = (await client.get(f"/a2a/nowhere{CARD}")).text
        assert hidden.replace("beta", "nowhere") == none


async def test_the_card_names_each_binding_and_version(gateway: Site) -> None:
    async with caller(gateway, None) as client:
        card = (await client.get(f"/a2a/alpha{CARD}")).json()
    received = [(i["protocolBinding"], i["protocolVersion"]) for i in card["supportedInterfaces"]]
    assert received == [
        ("JSONRPC", "1.0"), ("HTTP+JSON", "1.0"), ("JSONRPC", "0.3"), ("HTTP+JSON", "0.3"),
    ]  # fmt: skip
    assert card["supportedInterfaces"][0]["url"] == f"{gateway.url}/a2a"
    assert card["supportedInterfaces"][0]["tenant"] == "alpha"


@pytest.mark.parametrize("tenant", ["", "/a2a/alpha"])
async def test_a_card_has_nothing_that_1_0_does_not_allow(gateway: Site, tenant: str) -> None:
    async with caller(gateway, None) as client:
        card = (await client.get(f"{tenant}{CARD}")).json()
        ParseDict(card, AgentCard())  # refuses unknown fields, as the schema of 1.0 does
    async with caller(gateway) as client:
        ParseDict((await client.get("/a2a/alpha/extendedAgentCard")).json(), AgentCard())


async def test_a_client_of_the_version_before_finds_the_address_where_it_looks() -> None:
    async with agent("old_card = true") as site, caller(site, None) as client:
        card = (await client.get(f"/a2a/alpha{CARD}")).json()
        assert card["url"] == f"{site.url}/a2a/alpha"
        assert card["protocolVersion"].startswith("0.3")
        assert card["supportedInterfaces"][0]["protocolVersion"] == "1.0"


async def test_the_card_is_found_from_outside_where_the_configuration_says() -> None:
    async with agent('url = "https://robots.example/gate/"') as site, caller(site) as client:
        card = (await client.get(CARD)).json()
        assert card["supportedInterfaces"][0]["url"] == "https://robots.example/gate/a2a"


async def test_the_card_tells_how_one_proves_oneself(gateway: Site) -> None:
    async with caller(gateway, None) as client:
        card = (await client.get(CARD)).json()
    assert card["securitySchemes"]["bearer"]["httpAuthSecurityScheme"]["scheme"] == "Bearer"
    assert card["securityRequirements"] == [{"schemes": {"bearer": {}}}, {}]
    async with agent(top="anonymous = false") as site, caller(site, None) as client:
        card = (await client.get(CARD)).json()
    assert card["securityRequirements"] == [{"schemes": {"bearer": {}}}]


async def test_a_card_that_is_known_is_not_sent_again(gateway: Site) -> None:
    async with caller(gateway, None) as client:
        first = await client.get(CARD)
        assert first.headers["cache-control"] == "public, max-age=60"
        again = await client.get(CARD, headers={"if-none-match": first.headers["etag"]})
        assert (again.status_code, again.content) == (304, b"")


async def test_the_card_follows_the_tree() -> None:
    async with agent(more=MOVERS) as site, caller(site, None) as client:
        first = await client.get(CARD)
        site.robot.host.withdraw("action/go")
        second = await client.get(CARD)
        assert "action.go" not in skills(second.json())
        assert first.headers["etag"] != second.headers["etag"]


async def test_the_extended_card_has_what_the_caller_may_execute(client: httpx.AsyncClient) -> None:
    card = (await client.get("/a2a/extendedAgentCard")).json()
    assert skills(card) == ["plan", "stop", "robots", "action.go", "service.add", "service.hold"]
    answer = await rpc(client, "GetExtendedAgentCard", tenant="beta")
    assert answer["result"]["name"].endswith("(beta)")


async def test_every_example_runs_as_it_stands(gateway: Site, client: httpx.AsyncClient) -> None:
    """Checked only: a stop would keep the others from running."""
    card = (await rpc(client, "GetExtendedAgentCard"))["result"]
    examples = [(one["id"], text) for one in card["skills"] for text in one["examples"]]
    assert {id_ for id_, _ in examples} == {*skills(card)}
    for id_, example in examples:
        task = await sent(client, text(example, metadata={"dry_run": True}))
        assert task["status"]["state"] == "TASK_STATE_COMPLETED", (id_, example, task)
    await sent(client, text(next(one for id_, one in examples if id_ == "service.add")))
    assert [name for name, _ in gateway.robot.ran] == ["service/add"]


async def test_every_example_of_a_simulated_rover_passes_the_checks() -> None:
    headers = VERSION | {"authorization": f"Bearer {OPERATOR}"}
    async with rovers() as url, httpx.AsyncClient(base_url=url, headers=headers) as client:
        card = (await rpc(client, "GetExtendedAgentCard"))["result"]
        for skill in card["skills"]:
            for example in skill["examples"]:
                task = await sent(client, text(example, metadata={"dry_run": True}))
                assert task["status"]["state"] == "TASK_STATE_COMPLETED", (example, task)


async def test_who_may_not_run_plans_is_offered_nothing() -> None:
    mute = role("mute", rule("*", "/tenant/**")) + key("mute", MUTE, role="mute")
    async with agent(more=mute) as site, caller(site, MUTE) as client:
        card = (await rpc(client, "GetExtendedAgentCard"))["result"]
        assert skills(card) == ["plan"]
        assert card["skills"][0]["description"].startswith("Not with your rights")
        assert "examples" not in card["skills"][0]
        task = await sent(client, text("execute /service/add 1"))
        assert task["status"]["state"] == "TASK_STATE_REJECTED"


async def test_a_viewer_gets_no_skills_of_motion_in_the_extended_card(gateway: Site) -> None:
    async with caller(gateway, None) as client:
        assert skills((await client.get("/a2a/extendedAgentCard")).json()) == ["plan"]


def pem(key: Any) -> str:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()).decode()


KEYS = {
    "ES256": ec.generate_private_key(ec.SECP256R1()),
    "RS256": rsa.generate_private_key(65537, 2048),
    "EdDSA": ed25519.Ed25519PrivateKey.generate(),
}


@pytest.mark.parametrize("algorithm", KEYS)
async def test_a_signed_card_is_verified_by_the_keys_beside_it(
    algorithm: str, tmp_path: Any
) -> None:
    file = tmp_path / "card.pem"
    file.write_text(pem(KEYS[algorithm]))
    async with agent(f'card_key = "{file}"') as site, caller(site) as client:
        known = jwt.PyJWKSet.from_dict((await client.get("/a2a/.well-known/jwks.json")).json())
        verify = create_signature_verifier(lambda kid, _: known[kid or ""], [algorithm])
        card = await A2ACardResolver(client, site.url).get_agent_card()
        verify(card)
        answer = await client.get("/a2a/extendedAgentCard")
        assert answer.json()["signatures"]


async def test_without_a_key_there_is_nothing_to_verify_with(client: httpx.AsyncClient) -> None:
    assert "signatures" not in (await client.get(CARD)).json()
    assert (await client.get("/a2a/.well-known/jwks.json")).status_code == 404


@pytest.mark.parametrize("given", ["/nowhere/at/all.pem", "-----BEGIN NOTHING-----", ""])
def test_a_key_that_cannot_be_read_is_told_with_its_place(given: str) -> None:
    with pytest.raises(ConfigError, match=r"\[plugins.a2a\] card_key"):
        CardKey(given)


def test_a_key_of_another_kind_is_refused() -> None:
    with pytest.raises(ConfigError, match="unsupported type"):
        CardKey(pem(ec.generate_private_key(ec.SECP384R1())))


class Many:
    """Finds very many services, as `ClientApi.discover` does."""

    def discover(self, _session: Any, pattern: str, query: Query) -> Generator[None, None, Any]:
        yield from ()
        if not pattern.endswith("**"):
            return {"resources": [{}]}
        first = int(query.cursor or 0)
        last = first + (query.limit or 0)
        described = {"description": "Adds.", "examples": [], "schemas": {}}
        named = [{"path": f"/tenant/alpha/service/s{n}", **described} for n in range(first, last)]
        return {"resources": named, "cursor": str(last) if last < MANY else None}


def test_very_many_skills_are_described_in_steps() -> None:
    session: Any = SimpleNamespace(tenant="alpha")
    client_api: Any = Many()
    work, steps = skills_of(client_api, session, TextMarker()), 0
    try:
        while True:
            next(work)
            steps += 1
    except StopIteration as end:
        found = end.value
    assert len(found) == MANY + 3  # a plan, a stop, and the list of robots
    assert steps >= MANY // 32


async def test_a_card_of_very_many_skills_is_written_in_turns_and_as_in_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    many: Any = Many()
    turns = [0]

    def counted(card: AgentCard) -> dict[str, Any]:
        turns[-1] += 1
        end = thread_time() + 500e-6  # so that no machine is fast enough for many in a turn
        while thread_time() < end:
            pass
        return agent_card_to_dict(card)

    def turn() -> None:
        turns.append(0)
        asyncio.get_running_loop().call_soon(turn)

    def skills(
        _client_api: Any, session: Any, marker: TextMarker
    ) -> Generator[None, None, list[AgentSkill]]:
        return skills_of(many, session, marker)

    async with agent("old_card = true", MOVERS) as site, caller(site, None) as client:
        monkeypatch.setattr("rcp_a2a.cards.skills_of", skills)
        monkeypatch.setattr("rcp_a2a.cards.agent_card_to_dict", counted)
        turn()
        card = (await client.get(CARD)).json()
        assert len(card["skills"]) == MANY + 3
        assert card == agent_card_to_dict(ParseDict(card, AgentCard(), ignore_unknown_fields=True))
        assert sum(turns) >= MANY // 32
        assert max(turns) <= 10
