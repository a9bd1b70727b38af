"""What the dashboard advises is to be done on its pages, whatever error the gateway answers with."""

from __future__ import annotations

import ast
import json
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

import rcp_gateway
import rcp_kernel
import rcp_requests
import rcp_streams
from plugins.client.test_codegen import node
from rcp_kernel.errors import BY_CODE

REMEDIES = (
    Path(__file__).parents[3] / "plugins" / "rcp_dashboard" / "web" / "src" / "lib" / "remedies.ts"
)
OF_MESSAGES = re.compile(
    r"`|/system/|/rcp/|docs/|\b(discover|hello|envelope|retry_after|segment)\b"
)
CLASSES = {kind.__name__: code for code, kind in BY_CODE.items()}
ADVISED = """
const { remedyOf } = await import(process.argv[1]);
const errors = JSON.parse(process.argv[2]);
console.log(JSON.stringify(errors.map(([code, remedy]) => remedyOf({ code, remedy }))));
"""


def test_no_remedy_speaks_of_messages_and_each_error_has_one() -> None:
    found = node()
    if found is None:
        pytest.skip("needs Node")
    errors = [(code, kind.default_remedy) for code, kind in BY_CODE.items()]
    errors += sorted({each for file in sources() for each in remedies(file)})
    assert len(errors) > 2 * len(BY_CODE)
    command = [found, "--no-warnings", "--input-type=module", "--eval", ADVISED]
    output = subprocess.run(
        [*command, REMEDIES.as_uri(), json.dumps(errors)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert output.returncode == 0, output.stderr
    advised = dict(zip(errors, json.loads(output.stdout), strict=True))
    assert not {error: text for error, text in advised.items() if not text}
    assert not {error: text for error, text in advised.items() if OF_MESSAGES.search(text)}


def sources() -> Iterator[Path]:
    """Return the modules of the core, but for its test kit."""
    for package in (rcp_kernel, rcp_streams, rcp_requests, rcp_gateway):
        root = Path(package.__path__[0])
        for file in root.rglob("*.py"):
            if "testing" not in file.relative_to(root).parts:
                yield file


def remedies(file: Path) -> Iterator[tuple[str, str]]:
    """Yield what a module advises itself, with the code of the error."""
    for call in ast.walk(ast.parse(file.read_text())):
        if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Name):
            continue
        code = CLASSES.get(call.func.id)
        for given in call.keywords:
            if code is not None and given.arg == "remedy" and (text := written(given.value)):
                yield code, text


def written(node: ast.expr) -> str:
    """Return a text of the source, with a letter for each part that is put in."""
    match node:
        case ast.Constant(value=str() as text):
            return text
        case ast.JoinedStr(values=values):
            return "".join(written(value) for value in values)
        case ast.FormattedValue():
            return "X"
        case ast.BinOp(left=left, right=right):
            return written(left) + written(right)
        case _:
            return ""
