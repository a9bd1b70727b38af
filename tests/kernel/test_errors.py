"""All errors are had from one module, whichever one they are written in."""

from __future__ import annotations

import pkgutil
from importlib import import_module

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
