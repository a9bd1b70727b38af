"""The alert rules that are offered are valid, tested, and about metrics that the gateway has."""

from __future__ import annotations

import re
import shutil
import subprocess

import httpx
import pytest
import yaml

from docs.pages import ROOT
from transports.robot import KEY, site

FOLDER = ROOT / "examples" / "prometheus"
RULES = yaml.safe_load((FOLDER / "alerts.yml").read_text(encoding="utf-8"))["groups"][0]["rules"]


@pytest.mark.parametrize(
    "command",
    ["check rules alerts.yml", "check config prometheus.yml", "test rules alerts_test.yml"],
)
def test_promtool_agrees(command: str) -> None:
    if shutil.which("promtool") is None:
        pytest.skip("promtool is not installed: apt install prometheus")
    done = subprocess.run(
        ["promtool", *command.split()],
        cwd=FOLDER,
        capture_output=True,
        check=False,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_alert_says_what_to_do_and_is_tested_both_ways() -> None:
    tests = yaml.safe_load((FOLDER / "alerts_test.yml").read_text(encoding="utf-8"))["tests"]
    fired = " ".join(one["labels"] for one in tests[1]["promql_expr_test"][0]["exp_samples"])
    for rule in RULES:
        assert rule["labels"]["severity"] in ("page", "ticket")
        assert {"summary", "action"} <= set(rule["annotations"])
        assert f'"{rule["alert"]}"' in fired


@pytest.mark.anyio
async def test_every_metric_of_the_rules_is_there() -> None:
    async with site() as gateway:
        headers = {"authorization": f"Bearer {KEY}"}
        async with httpx.AsyncClient(base_url=gateway.url, headers=headers) as http:
            text = (await http.get("/metrics")).text
    families = set(re.findall(r"^# TYPE (\w+)", text, re.MULTILINE))
    used = {name for rule in RULES for name in re.findall(r"\brcp_\w+", rule["expr"])}
    assert len(used) > 10
    assert used <= families
    assert re.search(
        r'^rcp_estop_latched\{backend="\w+",robot="",tenant="alpha"\} 0.0$', text, re.MULTILINE
    )
