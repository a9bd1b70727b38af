"""Faults of TOML itself: each line at fault is left out, and the rest read on."""

from __future__ import annotations

import re
import tomllib
from typing import Any, NamedTuple

from rcp_toml.document import document

__all__ = ["Document", "read_toml"]

_MOST = 50
"""Lines at fault that are left out before the reading ends."""
_AT = re.compile(r" \(at (?:line (\d+), column \d+|end of document)\)\Z")
_PAIR = re.compile(r"\s*(?!\[)[^=#]+=?")
_MENDS = {
    "Invalid value": 'write a "text" in quotes, a number, true, false, a [list] or a {table}',
    "Expected '=' after": "write key = value",
    "Cannot overwrite": "the key is there already: remove one of the two",
    "Cannot declare": "the table is there already: put its keys together, or write [[name]] for "
    "one more element of a list",
    "Cannot mutate": "the table is complete in its { }: put the key there",
    "Expected newline": 'write one key = value on a line, and close a "text" with its quote',
    "Illegal character": "close the text with its quote on the same line",
    "Unescaped": "write \\\\ for a backslash, or 'text' in single quotes",
    "Unterminated": "close the text with its quote",
    "Expected ']'": "close the header with ]",
    "Expected ']]'": "close the header with ]]",
    "Invalid initial character": 'write a key of letters, digits, `_` and `-`, or a "key" in quotes',
    "Invalid statement": "write key = value, [table] or # comment",
    "Unclosed array": "close the list with ]",
    "Unclosed inline": "close the table with }",
    "Too many digits": "write a whole number of at most 64 bits",
    "Lists or tables": "write fewer [ ] and { } in each other",
    "Duplicate inline": "the key is there already: remove one of the two",
}


_LOOKS = tuple(
    (re.compile(look), mend)
    for look, mend in {
        r"[\u201c\u201d\u201e\u2018\u2019\u00ab\u00bb]": 'write "straight" quotes',
        r"[\u00a0\u2000-\u200f\u202f\u2060\ufeff]": "an invisible character is here: type the "
        "line again",
        r"\A(<{7}|={7}|>{7}|\|{7})( |\r?\Z)": "a merge left this line: keep one of the two "
        "versions, and remove the lines with `<<<<<<<`, `=======` and `>>>>>>>`",
        r"\A\s*\{": "this looks like JSON: a configuration is TOML, with [table] and key = value",
        r"\A\s*(- )?[\w-]+:(\s|\Z)": "this looks like YAML: write key = value, and [table] or "
        "[[list]] for what is below a key",
        r"\A[^=]+=.*;\s*(#.*)?\Z": "write no `;` at the end of a line",
    }.items()
)
"""What lines of other formats, editors and tools look like, and what to write instead."""


class Document(NamedTuple):
    """What could be read of a file."""

    raw: dict[str, Any] | None
    """None if too little could be read to judge the rest."""
    text: str
    """Of `raw`: lines at fault are empty."""
    faults: list[tuple[int, str]]
    """Lines and what is wrong there."""


def read_toml(text: str) -> Document:
    """Read a file with all faults of its form."""
    lines = text.split("\n")
    faults: list[tuple[int, str]] = []
    while True:
        text = "\n".join(lines)
        try:
            return Document(document(text), text, faults)
        except tomllib.TOMLDecodeError as error:
            number, message = _explain(str(error), lines)
        faults.append((number, message))
        line = lines[number - 1]
        if len(faults) == _MOST or _PAIR.match(line) is None:
            return Document(None, text, faults)
        lines[number - 1] = ""


def _explain(message: str, lines: list[str]) -> tuple[int, str]:
    """Return the line of a fault, and its message with what to write instead."""
    found = _AT.search(message)
    what = _AT.sub("", message)
    mend = next((mend for start, mend in _MENDS.items() if what.startswith(start)), None)
    if found is not None and found[1] is not None:
        number = int(found[1])
    else:  # the last line with anything on it
        number = max((i for i, line in enumerate(lines, 1) if line.strip()), default=1)
    mend = _look(lines[number - 1]) or mend
    return number, f"not TOML: {what}" + (f": {mend}" if mend else "")


def _look(line: str) -> str | None:
    """Return what to write instead of a line that looks like something else than TOML."""
    return next((mend for look, mend in _LOOKS if look.search(line)), None)
