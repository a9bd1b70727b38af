"""The notebooks run against a demo from their first cell to their last, and are kept without output."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import nbformat
import pytest
from nbclient import NotebookClient

from docs.demo import Demo
from docs.pages import ROOT

FOLDER = ROOT / "examples" / "notebooks"
_PATIENCE = 120  # s for a cell, and for the kernel to start on a busy machine


def run(name: str, live: Demo, monkeypatch: pytest.MonkeyPatch, folder: Path) -> list[Any]:
    """Run a notebook; return the outputs of its cells of code."""
    for variable, value in (("RCP_URL", live.url), ("RCP_TOKEN", live.key)):
        monkeypatch.setenv(variable, value)
    monkeypatch.setenv("IPYTHONDIR", str(folder))
    monkeypatch.setenv("MPLCONFIGDIR", str(folder))
    notebook = nbformat.read(FOLDER / f"{name}.ipynb", nbformat.NO_CONVERT)
    client = NotebookClient(notebook, timeout=_PATIENCE, startup_timeout=_PATIENCE)
    client.execute(cwd=str(folder))
    return [cell.outputs for cell in notebook.cells if cell.cell_type == "code"]


def text(outputs: list[Any]) -> str:
    """Return what a cell printed, or its value."""
    return "".join(one.get("text") or one.get("data", {}).get("text/plain", "") for one in outputs)


def has_picture(outputs: list[Any]) -> bool:
    return any("image/png" in one.get("data", {}) for one in outputs)


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.ipynb")), ids=lambda path: path.stem)
def test_a_notebook_is_valid_and_kept_without_output(path: Path) -> None:
    notebook = nbformat.read(path, nbformat.NO_CONVERT)
    nbformat.validate(notebook)
    assert all(cell.get("outputs", []) == [] for cell in notebook.cells)
    assert all(cell.get("execution_count") is None for cell in notebook.cells)


def test_a_robot_is_discovered_read_and_plotted(
    live: Demo, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    _, found, sample, scan, stream = run("read-and-plot", live, monkeypatch, tmp_path)
    assert "/tenant/alpha/sensor/pose" in text(found)
    assert "'x': " in text(sample)
    assert has_picture(scan)
    assert has_picture(stream)


def test_a_robot_is_driven_and_at_rest_at_the_end(
    live: Demo, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    _, goal, track, velocity, refused, held = run("drive", live, monkeypatch, tmp_path)
    *_, place = text(goal).strip().splitlines()
    reached = eval(place)  # a dictionary of numbers, as it is printed
    assert math.dist((reached["x"], reached["y"]), (0.8, 0.4)) < 0.3
    assert has_picture(track)
    assert float(text(velocity)) > 0.05
    assert text(refused).startswith("out_of_range\n")
    assert "'at_rest': True" in text(held)
