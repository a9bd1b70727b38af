"""The jobs of an operator: those that the documentation lists, and how each is done."""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable
from pathlib import Path

from browser.jobs.hands import Hands
from browser.jobs.site import Site

__all__ = ["JOBS", "job", "listed"]

Job = Callable[[Hands, Site], Awaitable[None]]
JOBS: dict[str, Job] = {}
"""How each job is done, by its words in the documentation."""
_DOCS = Path(__file__).parents[3] / "docs" / "dashboard.md"


def job(words: str) -> Callable[[Job], Job]:
    """Register how a job of the documentation is done, whatever the hands are."""

    def register(done: Job) -> Job:
        assert words not in JOBS, words
        JOBS[words] = done
        return done

    return register


def listed() -> list[str]:
    """Return the jobs of the table in the documentation."""
    section = _DOCS.read_text().partition("\n## Jobs\n")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (.+?) \|", section, re.MULTILINE)
    return [row for row in rows if row != "job" and not row.startswith("-")]
