from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rcp_kernel.access.auth_throttle import AuthThrottle
from rcp_kernel.errors import RateLimited


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@given(st.lists(st.floats(0, 30), max_size=60), st.integers(1, 20))
def test_nobody_is_locked_out_for_good(pauses: list[float], allowance: int) -> None:
    clock = Clock()
    attempts = AuthThrottle(allowance, clock)
    for pause in pauses:
        clock.now += pause
        attempts.failed("192.0.2.1", "wrong")
    clock.now += 60.0 / allowance + 0.001
    attempts.check("192.0.2.1", "fresh")


def test_what_is_refused_unseen_does_not_count() -> None:
    clock = Clock()
    attempts = AuthThrottle(3, clock)
    for _ in range(3):
        attempts.failed("192.0.2.1", "wrong")
    for _ in range(1000):
        with pytest.raises(RateLimited):
            attempts.check("192.0.2.1", "wrong")
    clock.now += 20.001
    attempts.check("192.0.2.1", "wrong")


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("2001:db8::1", "2001:db8::ffff", True),
        ("2001:db8::1", "2001:db8:0:1::1", False),
        ("::ffff:192.0.2.1", "192.0.2.1", True),
        ("192.0.2.1", "192.0.2.2", False),
    ],
)
def test_a_network_of_one_party_counts_as_one(one: str, other: str, *, same: bool) -> None:
    attempts = AuthThrottle(1, Clock())
    attempts.failed(one, "wrong")
    if same:
        with pytest.raises(RateLimited):
            attempts.check(other, "fresh")
    else:
        attempts.check(other, "fresh")


def test_what_was_good_and_is_not_any_more_counts_as_wrong() -> None:
    attempts = AuthThrottle(1, Clock())
    attempts.succeeded("good")
    attempts.failed("192.0.2.1", "wrong")
    attempts.check("192.0.2.1", "good")
    attempts.failed("192.0.2.1", "good")
    with pytest.raises(RateLimited):
        attempts.check("192.0.2.1", "good")


def test_a_signed_token_waits_for_the_last_wrong_signature_alone() -> None:
    clock = Clock()
    attempts = AuthThrottle(3, clock)
    for _ in range(50):
        attempts.failed("192.0.2.1", "wrong")
    with pytest.raises(RateLimited) as limited:
        attempts.check("192.0.2.1", "fresh", signed=True)
    clock.now += limited.value.retry_after or 0.0
    assert clock.now < 100.1
    attempts.check("192.0.2.1", "fresh", signed=True)
    with pytest.raises(RateLimited):
        attempts.check("192.0.2.1", "fresh")


def test_what_is_known_of_addresses_has_a_bound() -> None:
    attempts = AuthThrottle(3, Clock())
    for number in range(25_000):
        attempts.failed(f"10.0.{number >> 8}.{number & 255}", "wrong")
    assert len(attempts) == 20_000
