"""The transport and the adapter of the tutorials pass their suites, as the pages say."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

from docs.pages import DOCS
from rcp_gateway.api import Connection
from rcp_kernel.sessions.outbox import Outbox
from rcpd.scaffold import write_plugin


def _module(page: str, name: str) -> ModuleType:
    """Make a module of all code of a page."""
    text = (DOCS / page).read_text(encoding="utf-8")
    made = ModuleType(name)
    sys.modules[name] = made
    for block in re.findall(r"^```python\n(.+?)^```", text, re.DOTALL | re.MULTILINE):
        exec(compile(block, page, "exec"), made.__dict__)
    return made


TestTcp = _module("write-a-transport.md", "rcp_tcp").TestTcp
TestText = _module("write-an-adapter.md", "rcp_text").TestText
pytestmark = pytest.mark.filterwarnings("error")


def test_what_a_page_says_of_a_connection_exists() -> None:
    text = (DOCS / "write-a-transport.md").read_text("utf-8")
    cells = re.findall(r"^\| (`.+?`(?:, `.+?`)*) \|", text, re.MULTILINE)
    names = re.findall(r"(outbox|connection)\.(\w+)", " ".join(cells))
    assert len(names) > 8
    known = {"outbox": set(dir(Outbox)), "connection": set(dir(Connection))}
    assert [name for of, name in names if name not in known[of]] == []


@pytest.mark.parametrize(("kind", "name"), [("transport", "tcp"), ("adapter", "text")])
def test_the_code_of_a_page_is_what_rcpd_new_writes(kind: str, name: str, tmp_path: Path) -> None:
    text = (DOCS / f"write-a{'n' if kind == 'adapter' else ''}-{kind}.md").read_text("utf-8")
    code = re.findall(r"^```python\n(.+?)^```", text, re.DOTALL | re.MULTILINE)[0]
    made = write_plugin(kind, name, tmp_path)
    assert (made / f"rcp_{name}" / "__init__.py").read_text(encoding="utf-8") == code
