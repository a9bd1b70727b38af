"""The example dashboard of Grafana: each metric and label that it names is one of a real scrape."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from typing import Any

import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families

from docs.pages import ROOT
from transports.robot import KEY, Site, site

pytestmark = pytest.mark.anyio
DASHBOARD: dict[str, Any] = json.loads((ROOT / "examples/grafana/rcp-gateway.json").read_text())
_METRIC = re.compile(r"\b((?:rcp|process)_[a-z_]+)\b(?:\{([^}]*)\})?")
_GROUPED = re.compile(r"\bby \(([^)]*)\)")
_LEGEND = re.compile(r"\{\{(\w+)\}\}")
_OF_PROMETHEUS = {"job", "instance", "le"}


def expressions() -> list[tuple[str, str]]:
    """Return every query with its legend."""
    shown = [
        (target["expr"], target["legendFormat"])
        for panel in DASHBOARD["panels"]
        for target in panel["targets"]
    ]
    variables = [
        (one["definition"], "") for one in DASHBOARD["templating"]["list"] if "definition" in one
    ]
    return shown + variables


async def scrape(gateway: Site) -> dict[str, set[str]]:
    """Return the labels of every sample, after something of each kind has happened."""
    headers = {"authorization": f"Bearer {KEY}"}
    async with httpx.AsyncClient(base_url=gateway.url, headers=headers) as http:
        gateway.robot.release.set()
        context = "/rcp/v1/context/tenant/alpha"
        assert (await http.get(f"{context}/sensor/pose")).status_code == 200
        assert (await http.post(f"{context}/action/go", content=b"1")).status_code in (200, 202)
        text = (await http.get("/metrics")).text
    found: dict[str, set[str]] = defaultdict(set)
    for family in text_string_to_metric_families(text):
        for known in (family.name, family.name + "_total"):
            found[known] |= set()
        for sample in family.samples:
            found[sample.name] |= set(sample.labels)
    return found


async def test_every_metric_of_the_dashboard_is_there() -> None:
    async with site() as gateway:
        found = await scrape(gateway)
    told = 0
    for query, legend in expressions():
        metrics = _METRIC.findall(query)
        assert metrics, query
        wanted = {
            name.strip() for group in _GROUPED.findall(query) for name in group.split(",")
        } | set(_LEGEND.findall(legend))
        for name, matchers in metrics:
            assert name in found, f"{name} of {query!r}"
            told += 1
            labels = wanted | set(re.findall(r"(\w+)\s*[=!]", matchers))
            if found[name]:  # a family without a sample shows no labels
                assert labels - _OF_PROMETHEUS <= found[name], f"{query!r} has {found[name]}"
    assert told > 15


def test_every_panel_says_what_it_shows_and_finds_its_source() -> None:
    ids = [panel["id"] for panel in DASHBOARD["panels"]]
    assert len(set(ids)) == len(ids)
    for panel in DASHBOARD["panels"]:
        assert panel["title"]
        assert panel["description"]
        assert panel["fieldConfig"]["defaults"]["unit"]
        for target in panel["targets"]:
            assert target["datasource"]["uid"] == "${datasource}"
            assert 'job="$job"' in target["expr"]
