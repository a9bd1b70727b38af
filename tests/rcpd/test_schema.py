"""The schema of the configuration accepts every example and refuses broken files."""

from __future__ import annotations

import tomllib
from pathlib import Path

import jsonschema
import msgspec
import pytest
from click.testing import CliRunner

from broken import BROKEN
from docs.pages import ROOT
from rcpd.cli import main
from rcpd.schema import json_schema

pytest.importorskip("zenoh")
pytest.importorskip("can")

EXAMPLES = [
    path for path in sorted((ROOT / "examples").rglob("*.toml")) if path.name != "pyproject.toml"
]
REFUSED = [
    one
    for one in BROKEN
    if one.says.startswith(("did you mean `", "at least", "at most", "a whole", "needs `", '"', "true or"))
]  # fmt: skip


@pytest.fixture(scope="module")
def validator() -> jsonschema.Draft202012Validator:
    made = json_schema()
    jsonschema.Draft202012Validator.check_schema(made)
    return jsonschema.Draft202012Validator(made)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.name)
def test_an_example_fits(path: Path, validator: jsonschema.Draft202012Validator) -> None:
    errors = list(validator.iter_errors(tomllib.loads(path.read_text(encoding="utf-8"))))
    if path.name == "turtle.toml":  # its plugin is not installed
        assert [list(one.absolute_path) for one in errors] == [["backends", 0, "use"]]
    else:
        assert errors == []


def test_enough_broken_files_are_refused() -> None:
    assert len(REFUSED) >= 10


@pytest.mark.parametrize("one", REFUSED, ids=lambda one: one.says)
def test_a_broken_file_does_not_fit(
    one: tuple[str, ...], validator: jsonschema.Draft202012Validator
) -> None:
    assert not validator.is_valid(tomllib.loads(one[0]))


def test_the_command_prints_it() -> None:
    done = CliRunner().invoke(main, ["schema"])
    assert done.exit_code == 0
    assert msgspec.json.decode(done.output) == msgspec.json.decode(
        msgspec.json.encode(json_schema())
    )
