"""All errors are had from one module, whichever one they are written in."""

from __future__ import annotations

import pkgutil
from importlib import import_module

import rcp_kernel
from rcp_kernel import errors


def test_every_error_is_had_from_one_module() -> None:
    parts = [m.name for m in pkgutil.iter_modules(rcp_kernel.__path__) if "errors_" in m.name]
    named = [name for part in parts for name in import_module(f"rcp_kernel.{part}").__all__]
    assert sorted([*named, "BY_CODE"]) == sorted(errors.__all__)
    assert len(parts) > 1


def test_every_code_has_one_class_and_each_a_remedy() -> None:
    for code, made in errors.BY_CODE.items():
        assert made.code == code
        assert made.default_remedy
        assert made("told").remedy == made.default_remedy
