"""The backend of the tutorial runs as it is printed."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import msgspec
import pytest

from docs.pages import DOCS, keys, section
from rcp_gateway.server import Prepared, running
from rcp_kernel.config.file import parse
from rcp_kernel.model import Resource
from rcp_kernel.values import Encoding, dump
from rcp_kernel.wire import Reply, decode_request

PAGE = (DOCS / "write-a-backend.md").read_text(encoding="utf-8")
PROGRAMS = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


@pytest.fixture
def turntable(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The tutorial's module."""
    code, *_ = PROGRAMS
    module = ModuleType("rcp_turntable")
    monkeypatch.setitem(sys.modules, "rcp_turntable", module)
    exec(compile(code, "write-a-backend.md", "exec"), vars(module))
    return module


async def test_the_turntable_of_the_page_turns(turntable: Any) -> None:
    (kind,) = turntable.rcp_backends()
    config = parse(
        '[[backends]]\nuse = "turntable"\ntenant = "lab"\n'
        '[[keys]]\nname = "me"\nrole = "operator"\nkey = "a-key-for-this-test"\n',
        "test",
    )
    plugins: Any = SimpleNamespace(
        backends={"turntable": kind},
        adapters={},
        transports={},
        missing=[],
        points={"plugins": {}},
        is_missing=lambda _group, _name: None,
    )
    prepared = Prepared(config, plugins, (turntable.TurntableConfig(speed=2.0),), {}, {})
    async with running(prepared) as server:
        client_api = server.client_api
        session = client_api.session(client_api.authenticate("a-key-for-this-test"))

        async def turn_to(angle: float) -> Reply:
            body = {"angle": angle}
            request = {"type": "execute", "path": "/action/turn_to", "body": body}
            return await client_api.request(
                session, decode_request(dump(request, Encoding.JSON), Encoding.JSON)
            )

        done = await turn_to(0.2)
        assert (done.status, done.body) == ("completed", pytest.approx(0.2))
        refused = await turn_to(9.0)
        assert (refused.error or {})["code"] == "out_of_range"


def test_the_suite_of_the_page_proves_the_turntable(tmp_path: Path) -> None:
    code, suite, *_ = PROGRAMS
    (tmp_path / "rcp_turntable.py").write_text(code, encoding="utf-8")
    (tmp_path / "test_turntable.py").write_text(suite, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(tmp_path)]
    done = subprocess.run(
        [*command, "--rootdir", str(tmp_path), "-o", "anyio_mode=auto"],
        check=False,
        capture_output=True,
        text=True,
        timeout=240,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_table_of_resources_has_fields_that_there_are() -> None:
    documented = set(keys(section(DOCS / "write-a-backend.md", "Reference")))
    real = {field.name for field in msgspec.structs.fields(Resource)}
    elsewhere = {"name", "description", "value", "input", "output", "feedback", "examples"}
    assert documented == real - elsewhere
