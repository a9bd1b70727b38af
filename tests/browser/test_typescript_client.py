"""The TypeScript client does in Chromium what its own tests say, as it does in Node."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import pytest
from playwright.async_api import Page

from clients.test_typescript import typescript
from docs.demo import Demo
from plugins.client.test_codegen import node


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The tests as one script."""
    found = node()
    assert found is not None
    client = typescript(tmp_path_factory.mktemp("typescript"))
    made = client / "tests.js"
    subprocess.run([found, "test/chromium/bundle.mjs", made], cwd=client, check=True, timeout=120)
    return made.read_text(encoding="utf-8")


async def test_the_client_passes_its_tests_in_a_page(
    page: Page, running: Demo, bundle: str
) -> None:
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    await page.goto(f"{running.url}/healthz")
    about = {"RCP_URL": running.url, "RCP_TOKEN": running.key, "RCP_ADMIN": running.admin}
    environment = json.dumps({"env": {**about, "RCP_ENCODING": "msgpack"}})
    await page.evaluate(f"globalThis.process = {environment}; {bundle}")
    result = await page.evaluate("run()")
    assert result["failed"] == []
    assert errors == []
    source = Path(__file__).parents[2] / "clients" / "typescript" / "test" / "client.test.ts"
    written = re.findall(r'^test\("(.+?)",', source.read_text(encoding="utf-8"), re.MULTILINE)
    assert result["passed"] == written
