"""The feature of docs/write-a-feature.md passes the suite, as the page says."""

from __future__ import annotations

import re
import sys
from types import ModuleType

from docs.pages import DOCS

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
