"""Tokens that are not what they say, and tables that are faulty: refused, with the reason."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import time
from typing import Any

import jwt
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from configuration import configuration
from issuer import AUDIENCE, Issuer, Key, issuing, who
from kernel.world import CONFIG, World, world_of
from rcp_gateway.server import prepare
from rcp_jwt.config import JwtConfig
from rcp_jwt.issuers import Issuers
from rcp_jwt.webtokens import read_token, verify
from rcp_kernel.clock import SYSTEM_CLOCK
from rcp_kernel.config.file import parse
from rcp_kernel.errors import (
    ConfigError,
    Forbidden,
    RcpError,
    TokenExpired,
    Unauthenticated,
)

pytestmark = pytest.mark.anyio


@pytest.mark.parametrize(
    ("claims", "error", "said"),
    [
        ({"exp": 1_000_000_000}, TokenExpired, "has expired"),
        ({"exp": None}, Unauthenticated, "needs the claims"),
        ({"aud": None}, Unauthenticated, "needs the claims"),
        ({"aud": "other"}, Unauthenticated, "for another audience"),
        ({"aud": []}, Unauthenticated, "aud"),
        ({"aud": {"a": 1}}, Unauthenticated, "aud"),
        ({"iss": "https://elsewhere.example"}, Unauthenticated, "issuer is not configured"),
        ({"iss": None}, Unauthenticated, "malformed"),
        ({"nbf": 4_000_000_000}, Unauthenticated, "not valid yet"),
        ({"iat": 4_000_000_000}, Unauthenticated, "not valid yet"),
        ({"exp": "soon"}, Unauthenticated, "malformed"),
        ({"exp": [1]}, Unauthenticated, "malformed"),
        ({"exp": float("inf")}, Unauthenticated, "malformed"),
        ({"sub": None}, Unauthenticated, "`sub`"),
        ({"sub": ""}, Unauthenticated, "`sub`"),
        ({"sub": "a\nb"}, Unauthenticated, "`sub`"),
        ({"sub": "x" * 129}, Unauthenticated, "`sub`"),
    ],
)
async def test_a_claim_that_is_not_right_refuses(
    world: World, issuer: Issuer, claims: dict[str, Any], error: type[RcpError], said: str
) -> None:
    token = issuer.token(**claims)
    with pytest.raises(error, match=said) as refused:
        await who(world, token)
    assert token not in refused.value.message


async def test_the_clocks_may_differ_by_the_leeway(world: World, issuer: Issuer) -> None:
    now = int(time.time())
    assert (await who(world, issuer.token(exp=now - 20, nbf=now + 20, iat=now + 20))).name == "ann"
    with pytest.raises(TokenExpired):
        await who(world, issuer.token(exp=now - 31))
    with pytest.raises(Unauthenticated, match="not valid yet"):
        await who(world, issuer.token(nbf=now + 40))


async def test_max_age_counts_whatever_exp_says(issuer: Issuer) -> None:
    async with world_of(CONFIG + issuer.table('role = "viewer"\nmax_age = 60')) as world:
        now = int(time.time())
        principal = await who(world, issuer.token(iat=now - 50))
        assert principal.expires == (now - 50 + 60 + 30) * 1_000_000_000
        with pytest.raises(TokenExpired):
            await who(world, issuer.token(iat=now - 91))
        with pytest.raises(Unauthenticated, match="`iat`"):
            await who(world, issuer.token(iat=None))


def forged(head: dict[str, Any], claims: dict[str, Any], secret: bytes) -> str:
    parts = [base64.urlsafe_b64encode(json.dumps(p).encode()).rstrip(b"=") for p in (head, claims)]
    mac = hmac.new(secret, b".".join(parts), hashlib.sha256).digest()
    return b".".join([*parts, base64.urlsafe_b64encode(mac).rstrip(b"=")]).decode()


@pytest.mark.parametrize("algorithm", ["none", "None", "HS256", "HS384", "ES256", "RS512", "PS256"])
async def test_the_algorithm_is_the_keys_and_not_the_tokens(
    world: World, issuer: Issuer, algorithm: str
) -> None:
    key = issuer.keys["k1"]
    await who(world, issuer.token())
    claims = {"iss": issuer.url, "aud": AUDIENCE, "sub": "ann", "exp": time.time() + 60}
    secrets = [key.pem.encode(), json.dumps(key.jwk).encode(), b""]
    for secret in secrets:
        for kid in ({"kid": "k1"}, {}):
            token = forged({"alg": algorithm, "typ": "JWT", **kid}, claims, secret)
            with pytest.raises(Unauthenticated):
                await who(world, token)
            with pytest.raises(Unauthenticated):
                await who(world, token.rpartition(".")[0] + ".")


async def test_a_key_that_the_token_brings_along_counts_for_nothing(
    world: World, issuer: Issuer
) -> None:
    mine = Key("mine", "ES256")
    claims = {"iss": issuer.url, "aud": AUDIENCE, "sub": "ann", "exp": time.time() + 60}
    for head in (
        {"jwk": mine.jwk, "kid": "k1"},
        {"jku": "http://127.0.0.1:1/keys", "kid": "k1"},
        {"x5u": "http://127.0.0.1:1/cert", "kid": "k1"},
        {"kid": "../../../../dev/null"},
        {"kid": "k1"},
    ):
        with pytest.raises(Unauthenticated):
            await who(world, jwt.encode(claims, mine.private, "ES256", headers=head))


async def test_what_is_critical_is_refused(world: World, issuer: Issuer) -> None:
    claims = {"iss": issuer.url, "aud": AUDIENCE, "sub": "ann", "exp": time.time() + 60}
    for crit in (["exp"], ["b64"], [], "x"):
        head = {"kid": "k1", "crit": crit}
        token = jwt.encode(claims, issuer.keys["k1"].private, "ES256", headers=head)
        with pytest.raises(Unauthenticated):
            await who(world, token)


async def test_an_algorithm_that_is_not_listed_is_not_taken(issuer: Issuer) -> None:
    table = issuer.table('role = "viewer"\nalgorithms = ["RS256"]')
    async with world_of(CONFIG + table) as world:
        with pytest.raises(Unauthenticated, match="algorithm"):
            await who(world, issuer.token())


async def test_an_issuer_does_not_speak_for_another(issuer: Issuer) -> None:
    async with (
        issuing() as other,
        world_of(CONFIG + issuer.table() + other.table('role = "viewer"')) as world,
    ):
        with pytest.raises(Unauthenticated):
            await who(world, other.token(iss=issuer.url))
        mine = await who(world, issuer.token())
        theirs = await who(world, other.token())
        assert (mine.name, theirs.name) == ("ann", "ann")
        assert mine.roles != theirs.roles


_KEY = Key("k1", "ES256")
_CONFIG = JwtConfig(issuer="i", audience="a", keys=_KEY.pem, role="viewer")
_GOOD = jwt.encode(
    {"iss": "i", "aud": "a", "sub": "s", "exp": 4_000_000_000}, _KEY.private, "ES256"
)


@given(
    st.text()
    | st.binary().map(lambda b: b.decode("latin-1"))
    | st.lists(
        st.binary().map(lambda b: base64.urlsafe_b64encode(b).decode().rstrip("=")),
        min_size=3,
        max_size=3,
    ).map(".".join)
)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_text_does_more_than_be_refused(text: str) -> None:
    found = Issuers([_CONFIG], ["t"], SYSTEM_CLOCK)
    with pytest.raises(Unauthenticated):
        found.find("eyJ" + text, "digest")


@given(st.integers(0, len(_GOOD) - 1), st.integers(1, 127))
def test_no_token_stays_good_that_was_changed(place: int, flip: int) -> None:
    found = Issuers([_CONFIG], ["t"], SYSTEM_CLOCK)
    changed = _GOOD[:place] + chr(ord(_GOOD[place]) ^ flip) + _GOOD[place + 1 :]
    try:
        principal: Any = found.find(changed, "digest")
    except Unauthenticated:
        return
    # base64 has several texts for the same bytes: only those of the very same token pass.
    read = read_token(changed)
    assert verify(changed, list(found.issuers["i"].candidates(read)), _CONFIG, _CONFIG.audience)
    assert principal.name == "s"


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.integers() | st.text(),
        lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    )
)
def test_whatever_a_signed_claim_holds_it_is_told_by_an_error_of_the_contract(value: Any) -> None:
    config = JwtConfig(
        issuer="i",
        audience="a",
        keys=_KEY.pem,
        role="viewer",
        role_claim="r.x",
        by_claim={"v": _CONFIG},
        tenant_claim="t",
        max_age=1e9,
    )
    found = Issuers([config], ["t"], SYSTEM_CLOCK)
    for claim in ("exp", "iat", "nbf", "aud", "sub", "r", "t"):
        claims = {"iss": "i", "aud": "a", "sub": "s", "exp": 4_000_000_000, "iat": 1_700_000_000}
        head, body = (
            base64.urlsafe_b64encode(json.dumps(part).encode()).rstrip(b"=")
            for part in ({"alg": "ES256"}, {**claims, claim: value})
        )
        algorithm = jwt.get_algorithm_by_name("ES256")
        signed = algorithm.sign(head + b"." + body, _KEY.private)
        token = b".".join([head, body, base64.urlsafe_b64encode(signed).rstrip(b"=")]).decode()
        try:
            found.find(token, "digest" + claim)
        except (Unauthenticated, Forbidden):
            continue


# -- the configuration -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('issuer = "https://i"\nrole = "viewer"\ndiscovery = true', "audience"),
        ('issuer = "https://i"\naudience = "a"\nrole = "viewer"', "needs one of `keys`"),
        ('issuer = "http://i"\naudience = "a"\nrole = "viewer"\ndiscovery = true', "https"),
        (
            'issuer = "i"\naudience = "a"\nrole = "viewer"\njwks_url = "http://u:p@127.0.0.1/"',
            "without a user name",
        ),
        ('issuer = "https://i"\naudience = []\nrole = "viewer"\ndiscovery = true', "is empty"),
        (
            'issuer = "https://i"\naudience = "a"\nrole = "viewer"\ndiscovery = true\nlifetime = 60',
            "keys expire between two fetches",
        ),
        ('issuer = "https://i"\naudience = "a"\ndiscovery = true', "needs a `role`"),
        ('issuer = "https://i"\naudience = "a"\nrole = "x"\ndiscovery = true', "role 'x'"),
        (
            'issuer = "https://i"\naudience = "a"\ndiscovery = true\nalgorithms = ["HS256"]\nrole = "viewer"',
            "HS256",
        ),
        (
            'issuer = "https://i"\naudience = "a"\nrole = "viewer"\ndiscovery = true\nrole_claim = "r"',
            "must be used together",
        ),
        (
            'issuer = "https://i"\naudience = "a"\ndiscovery = true\nrole_claim = "r"\nby_claim = { x = { role = "opertor" } }',
            "did you mean 'operator'",
        ),
        ('issuer = "i"\naudience = "a"\nrole = "viewer"\nkeys = "nowhere.pem"', "cannot be read"),
        ('issuer = "i"\naudience = "a"\nrole = "viewer"\nkeys = "{}"', "is not a public key"),
    ],
)
def test_a_faulty_table_says_what_is_wrong(text: str, said: str) -> None:
    quiet = configuration()
    with pytest.raises(ConfigError, match=said):
        prepare(parse(f"{quiet}[[jwt]]\n{text}\n", "test"), "test")


def test_a_private_key_is_refused_and_not_shown() -> None:
    from cryptography.hazmat.primitives.serialization import (
        Encoding,
        NoEncryption,
        PrivateFormat,
    )

    pem = _KEY.private.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()).decode()
    with pytest.raises(ConfigError, match="private key") as refused:
        Issuers([JwtConfig(issuer="i", audience="a", keys=pem, role="viewer")], [], SYSTEM_CLOCK)
    assert pem.splitlines()[1] not in str(refused.value)
