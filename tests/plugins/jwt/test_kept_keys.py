"""Keys of issuers that outlive a restart, for as long as they would have counted without it."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from issuer import Key
from rcp_gateway.testing import SteppedClock
from rcp_jwt.jwks import PublicKey, read_set
from rcp_jwt.kept_keys import KeptKeys

DAY = 86_400.0
EARLIER = SteppedClock()
EARLIER.ahead = -60.0


class Rows:
    """A table of the store, whose values went through MessagePack."""

    keeps = True

    def __init__(self) -> None:
        self.rows: dict[str, Any] = {}

    def put(self, key: str, value: Any) -> None:
        if value is None:
            self.rows.pop(key, None)
        else:
            self.rows[key] = msgspec.msgpack.decode(msgspec.msgpack.encode(value))

    def load(self) -> dict[str, Any]:
        return dict(self.rows)


@pytest.fixture
def keys() -> tuple[PublicKey, ...]:
    made = [Key(f"k{n}", name) for n, name in enumerate(("RS256", "ES256", "EdDSA"))]
    return read_set({"keys": [one.jwk for one in made]})


def restarted(rows: Any, clock: SteppedClock) -> KeptKeys:
    made = KeptKeys(clock.clock, rows)
    made.load({"a", "b"})
    return made


def test_keys_count_for_the_rest_of_their_lifetime(keys: tuple[PublicKey, ...]) -> None:
    rows, clock = Rows(), SteppedClock()
    restarted(rows, clock).keep("a", keys)
    clock.advance(600.0)
    found = restarted(rows, clock).recall("a", DAY)
    assert found is not None
    assert round(found.age) == 600
    told = [(one.id, one.algorithm, one.thumbprint) for one in found.keys]
    assert told == [(one.id, one.algorithm, one.thumbprint) for one in keys]
    clock.advance(DAY - 600.0)
    assert restarted(rows, clock).recall("a", DAY) is None


def test_keys_of_another_source_or_of_the_future_do_not_count(keys: tuple[PublicKey, ...]) -> None:
    rows, clock = Rows(), SteppedClock()
    kept = restarted(rows, clock)
    kept.keep("a", keys)
    kept.keep("gone", keys)
    assert restarted(rows, clock).recall("b", DAY) is None
    assert rows.rows.keys() == {"a"}
    assert restarted(rows, EARLIER).recall("a", DAY) is None


@pytest.mark.parametrize("row", [1, {}, {"fetched": 0, "keys": [["k", b"no key"]]}])
def test_what_cannot_be_read_is_deleted(row: Any) -> None:
    rows = Rows()
    rows.rows["a"] = row
    assert restarted(rows, SteppedClock()).recall("a", DAY) is None
    assert not rows.rows
