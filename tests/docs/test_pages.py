"""Links lead somewhere, decisions are numbered and listed, commands and error codes are all told."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from docs.pages import DOCS, ROOT, every_page
from rcpd.cli import main

PAGES = every_page()
DECISIONS = sorted((DOCS / "decisions").glob("0*.md"))


def anchors(page: Path) -> set[str]:
    """Return the anchors that a page's headings make, as forges make them."""
    text = re.sub(
        r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL
    )
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_of_a_page_lead_somewhere(page: Path) -> None:
    text = re.sub(
        r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL
    )
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith(("http://", "https://", "mailto:")):
            continue
        name, _, anchor = target.partition("#")
        found = (page.parent / name).resolve() if name else page
        assert found.exists(), f"{page.name} links to {target}"
        if anchor:
            assert anchor in anchors(found), f"{page.name} links to {target}"


def test_decisions_are_numbered_without_gaps_and_listed() -> None:
    numbers = [int(page.name[:4]) for page in DECISIONS]
    index = (DOCS / "decisions" / "README.md").read_text(encoding="utf-8")
    assert numbers == list(range(1, len(numbers) + 1))
    for page in DECISIONS:
        title = page.read_text(encoding="utf-8").splitlines()[0].partition(": ")[2]
        assert f"[{page.name[:4]}]({page.name}) | {title} |" in index


@pytest.mark.parametrize("page", DECISIONS, ids=lambda page: page.stem)
def test_a_decision_has_its_sections(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert text.startswith(f"# {page.name[:4]}: ")
    assert re.search(r"^Status: \w", text, re.MULTILINE)
    assert re.findall(r"^## (.+)$", text, re.MULTILINE) == ["Context", "Decision", "Consequences"]


def test_every_command_of_rcpd_is_told() -> None:
    text = (DOCS / "operate.md").read_text(encoding="utf-8")
    for name, command in main.commands.items():
        parts = getattr(command, "commands", None)
        for whole in [f"{name} {part}" for part in parts] if parts else [name]:
            assert f"`rcpd {whole}" in text, f"docs/operate.md does not tell of `rcpd {whole}`"
    assert CliRunner().invoke(main, ["--help"]).exit_code == 0
