"""All errors are had from one module, whichever one they are written in."""

from __future__ import annotations

import pkgutil
from importlib import import_module

import pytest

from rcp_kernel.contract.internal_errors import LinkLost, attribute_error, to_internal_error
from rcp_protocol import errors


def test_every_error_is_had_from_one_module() -> None:
    parts = [module.name for module in pkgutil.iter_modules(errors.__path__)]
    named = [
        name for part in parts for name in import_module(f"rcp_protocol.errors.{part}").__all__
    ]
    assert sorted([*named, "BY_CODE"]) == sorted(errors.__all__)
    assert len(parts) > 1


def test_every_code_has_one_class_and_each_a_remedy() -> None:
    for code, made in errors.BY_CODE.items():
        assert made.code == code
        assert made.default_remedy
        assert made("told").remedy == made.default_remedy


@pytest.mark.parametrize("error", [ConnectionResetError("reset by peer"), TimeoutError()])
def test_a_lost_link_may_be_tried_again_unless_the_robot_may_have_acted(error: OSError) -> None:
    before = attribute_error(error, "rover", "/tenant/t/param/limit")
    after = attribute_error(error, "rover", "/tenant/t/param/limit", sent=True)
    assert before.retryable
    assert type(after) is LinkLost
    assert (after.status, after.retryable) == ("failed", False)
    assert {before.origin, after.origin} == {"rover"}
    assert {before.code, after.code, to_internal_error(error).code} == {"adapter_unavailable"}


def test_what_a_backend_raises_on_purpose_stays_and_what_it_did_not_is_confidential() -> None:
    refusal = errors.OutOfRange("too fast", origin="motor")
    assert attribute_error(refusal, "rover", "/tenant/t/param/limit") is refusal
    assert refusal.origin == "motor"
    failed = attribute_error(ZeroDivisionError("secret"), "rover", "/tenant/t/param/limit")
    assert (failed.code, failed.origin) == ("internal", "rover")
    assert "secret" not in failed.message
