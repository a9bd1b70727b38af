"""Each node of a TOML file has the line at which it begins."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from docs.pages import ROOT
from rcp_protocol.plain import is_list, is_map
from rcp_toml.positions import Place, line_of, positions

TEXT = r'''# first
name = "a"
"quoted key".'lite.ral' . bare = 1

[limits] # a table
message = 1

[tenants . "a.b"]
description = """
[not.a.table]
x = 1 \"""
""""
after = 'C:\'
lines = """a \
  b"""

[[backends]]
use = "sim"
[backends.buses.can0]
options = { a = 1, "b c" = [1, 2], d.e = { f = 2 } }
[[backends.items]]
n = 1
[[backends.items]]
n = 2

[[backends]]
use = 'it''s'
values = [
  1, # one ]
  [2,
   3],
  { x = 4 },

  """
]
""",
]
when = 1979-05-27 07:32:00
last = '''
TEXT = TEXT.replace("'it''s'", "'its'") + "'''\n]\n'''"

LINES: dict[Place, int] = {
    ("name",): 2,
    ("quoted key", "lite.ral", "bare"): 3,
    ("limits",): 5,
    ("tenants", "a.b", "description"): 9,
    ("tenants", "a.b", "after"): 13,
    ("tenants", "a.b", "lines"): 14,
    ("backends", 0): 17,
    ("backends", 0, "buses", "can0", "options", "b c", 1): 20,
    ("backends", 0, "buses", "can0", "options", "d", "e", "f"): 20,
    ("backends", 0, "items", 1, "n"): 24,
    ("backends", 1): 26,
    ("backends", 1, "values", 0): 29,
    ("backends", 1, "values", 1, 1): 31,
    ("backends", 1, "values", 2, "x"): 32,
    ("backends", 1, "values", 3): 34,
    ("backends", 1, "when"): 38,
    ("backends", 1, "last"): 39,
}


def places(node: Any, at: Place = ()) -> Iterator[Place]:
    if at:
        yield at
    if is_map(node):
        for key, item in node.items():
            yield from places(item, (*at, key))
    elif is_list(node):
        for index, item in enumerate(node):
            yield from places(item, (*at, index))


@pytest.mark.parametrize("ending", ["\n", "\r\n"], ids=["unix", "windows"])
def test_the_line_of_every_kind_of_node(ending: str) -> None:
    text = TEXT.replace("\n", ending)
    found = positions(text)
    assert {place: found.get(place) for place in LINES} == LINES
    assert set(found) == set(places(tomllib.loads(text)))


@pytest.mark.parametrize(
    "file",
    [*sorted((ROOT / "examples").rglob("*.toml")), ROOT / "pyproject.toml"],
    ids=lambda file: str(file.relative_to(ROOT)),
)
def test_every_node_of_a_real_file_has_a_line(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    found = positions(text)
    assert set(found) == set(places(tomllib.loads(text)))
    lines = text.split("\n")
    for place, line in found.items():
        if isinstance(place[-1], str):
            assert place[-1] in lines[line - 1]


def test_a_node_without_a_line_has_that_of_what_is_around_it() -> None:
    found = positions("[limits]\nmessage = 1\n")
    assert line_of(("limits", "deadline"), found) == 1
    assert line_of(("limits", "message", 0), found) == 2
    assert line_of(("nowhere",), found) == 1
