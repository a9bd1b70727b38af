"""Tokens of an issuer that are good, and what they make of who brings them."""

from __future__ import annotations

import json
import time
from typing import Any

import jwt
import pytest

from configuration import backend
from issuer import AUDIENCE, Issuer, issuing, who
from kernel.world import CONFIG, World, world_of
from rcp_jwt import issuers
from rcp_kernel.errors import (
    Forbidden,
    Unauthenticated,
)

pytestmark = pytest.mark.anyio


@pytest.mark.parametrize("algorithm", ["RS256", "ES256", "EdDSA"])
async def test_a_token_of_each_algorithm_is_good(
    world: World, issuer: Issuer, algorithm: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(issuers, "_GAP", 0.0)
    issuer.add("other", algorithm)
    principal = await who(world, issuer.token("other", sub="bea"))
    assert (principal.name, principal.roles, principal.tenants) == ("bea", ("operator",), ("*",))
    assert principal.proof == f"jwt {issuer.url}"


@pytest.mark.parametrize("form", ["pem", "jwk", "jwks", "file"])
async def test_keys_are_given_as_text_or_file(form: str, tmp_path: Any) -> None:
    async with issuing() as issuer:
        key = issuer.keys["k1"]
        texts = {
            "pem": key.pem,
            "jwk": json.dumps(key.jwk),
            "jwks": json.dumps({"keys": [key.jwk]}),
            "file": str(tmp_path / "key.pem"),
        }
        (tmp_path / "key.pem").write_text(key.pem)
        table = issuer.table(source=f"keys = {json.dumps(texts[form])}")
        async with world_of(CONFIG + table) as world:
            assert world.server.client_api.authenticate(issuer.token()).name == "ann"
        assert issuer.asked == 0


async def test_a_token_without_kid_is_tried_with_the_keys_of_its_algorithm(
    world: World, issuer: Issuer
) -> None:
    await who(world, issuer.token())
    now = int(time.time())
    claims = {"iss": issuer.url, "aud": [AUDIENCE, "other"], "sub": "ann", "exp": now + 60}
    token = jwt.encode(claims, issuer.keys["k1"].private, "ES256")
    assert (await who(world, token)).name == "ann"


async def test_the_audience_may_be_one_of_several(world: World, issuer: Issuer) -> None:
    assert (await who(world, issuer.token(aud=["other", AUDIENCE]))).name == "ann"
    with pytest.raises(Unauthenticated, match="for another audience"):
        await who(world, issuer.token(aud=["other", "another"]))


async def test_claims_give_roles_in_tenants(issuer: Issuer) -> None:
    more = """
role_claim = "realm_access.roles"
tenant_claim = "https://example.org/sites"
name_claim = "email"
prefix = "corp:"
[jwt.by_claim]
driver = { role = "operator" }
guest = { role = "viewer", tenants = ["alpha"] }
"""
    beta = backend("other", "beta")
    async with world_of(CONFIG + beta + issuer.table(more)) as world:

        async def grants(roles: Any, sites: Any) -> Any:
            token = issuer.token(
                email="ann@example.org",
                realm_access={"roles": roles},
                **{"https://example.org/sites": sites},
            )
            return (await who(world, token)).grants

        assert await grants(["driver"], ["alpha"]) == (("alpha", ("operator",)),)
        assert await grants("driver", "beta") == (("beta", ("operator",)),)
        assert await grants(["driver", "guest", "x"], ["beta", "alpha"]) == (
            ("beta", ("operator",)),
            ("alpha", ("operator", "viewer")),
        )
        for roles, sites in [
            (["driver"], "*"),
            (["driver"], ["gamma"]),
            (["driver"], None),
            (["guest"], "beta"),
            ([], "alpha"),
            ([1, None, {}], "alpha"),
            ({"driver": True}, "alpha"),
        ]:
            with pytest.raises(Forbidden, match=r"gives corp:ann@example\.org no role"):
                await grants(roles, sites)
        with pytest.raises(Unauthenticated, match="`email`"):
            await who(world, issuer.token(realm_access={"roles": ["driver"]}))


async def test_a_signature_is_checked_once(
    world: World, issuer: Issuer, monkeypatch: pytest.MonkeyPatch
) -> None:
    token = issuer.token()
    first = await who(world, token)
    monkeypatch.setattr(issuers, "verify", None)
    assert world.server.client_api.authenticate(token) is first
