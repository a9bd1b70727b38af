"""The feature `configuration` by itself: the suite of all features, and its seal."""

from __future__ import annotations

import base64

import pytest

from rcp_configuration import rcp_features
from rcp_configuration.seal import SealError, SealKey, seal
from rcp_gateway.testing import ADMIN, OPERATOR, FeatureSuite, serve

PATH = "/system/configuration"


class TestConfiguration(FeatureSuite):
    (kind,) = rcp_features()


@pytest.mark.parametrize("features", ["", "[features]\nconfiguration = true\n"])
async def test_an_operator_has_no_right_and_without_the_feature_nobody(features: str) -> None:
    keys = f'[[keys]]\nname = "ann"\nrole = "operator"\nkey = "{OPERATOR}"\n'
    keys += f'[[keys]]\nname = "root"\nrole = "admin"\nkey = "{ADMIN}"\n'
    async with serve(features + keys) as served:
        for token, expected in ((OPERATOR, "unknown_path"), (ADMIN, "unsupported_operation")):
            client = served.client(token)
            reply = await client.request("execute", PATH, body={"confirm": "0" * 64})
            wanted = expected if features else "unknown_path"
            assert reply["error"]["code"] == wanted, reply
            await client.close()


def test_only_the_gateway_opens_what_was_sealed_to_it() -> None:
    key, other = SealKey(), SealKey()
    sealed = seal(b"secret", key.public)
    assert key.opened(sealed) == b"secret"
    assert b"secret" not in base64.b64decode(sealed)
    with pytest.raises(SealError):
        other.opened(sealed)
    raw = base64.b64decode(sealed)
    for changed in (
        raw[:-1],
        raw[:40] + bytes([raw[40] ^ 1]) + raw[41:],
        bytes(32) + raw[32:],
        b"",
    ):
        with pytest.raises(SealError):
            key.opened(base64.b64encode(changed).decode())
    with pytest.raises(SealError):
        key.opened("no base64!")
    with pytest.raises(SealError):
        seal(b"", "short")
