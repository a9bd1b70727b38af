"""The feature of docs/write-a-feature.md passes the suite, as the page says."""

from __future__ import annotations

import re
import sys
from types import ModuleType
from typing import get_args

from docs.pages import DOCS
from rcp_kernel.contract.events import EventKind

PAGE = (DOCS / "write-a-feature.md").read_text(encoding="utf-8")


def _module() -> ModuleType:
    """Make a module of the page's feature and its test."""
    code = re.findall(r"^```python\n(.+?)^```", PAGE, re.DOTALL | re.MULTILINE)
    made = ModuleType("rcp_site")
    sys.modules[made.__name__] = made
    for block in code:
        exec(compile(block, "write-a-feature.md", "exec"), made.__dict__)
    return made


TestSite = _module().TestSite


def test_the_page_names_every_kind_of_event() -> None:
    (listed,) = re.findall(
        r"is an `EventKind` of that module:(.+?); or what a feature", PAGE, re.DOTALL
    )
    assert set(get_args(EventKind)) <= set(re.findall(r"`(\w+)`", listed))
