"""Every hook has a heading with its exact signature, and every heading is a hook."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

from rcp_gateway import hookspecs

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "hooks.md").read_text(encoding="utf-8")


def signatures() -> set[str]:
    functions = {name: item for name, item in vars(hookspecs).items() if hasattr(item, "rcp_spec")}
    return {f"{name}{inspect.signature(item)}".replace("'", "") for name, item in functions.items()}


def test_every_hook_is_a_heading_with_its_signature() -> None:
    headings = set(re.findall(r"^## `(.+)`$", PAGE, re.MULTILINE))
    assert headings == signatures()


def test_every_group_of_entry_points_is_named() -> None:
    from rcp_gateway.plugins import GROUPS

    assert set(re.findall(r"^\| `(rcp\.\w+)`", PAGE, re.MULTILINE)) == set(GROUPS.values())
