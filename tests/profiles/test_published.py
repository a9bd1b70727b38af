"""What was published of a profile holds: a change that breaks clients or robots has a new version."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import jsonschema
import msgspec
import pytest
from click.testing import CliRunner
from msgspec.structs import replace

import rcp_sim
from docs.pages import DOCS
from rcp_gateway.hookspecs import hookimpl
from rcp_gateway.testing._schemas import numbers_without_unit
from rcp_kernel.model import BRANCHES, Kind, Operation
from rcp_kernel.tree.registry import _checked
from rcp_kernel.types import PoseStamped, quantity
from rcp_kernel.values import value_type
from rcp_profiles import STANDARD, Definition, Profile, changes, document, unannounced
from rcp_profiles import messages as m
from rcp_profiles.pages import index
from rcpd.cli import main
from rcpd.profiles import write_profiles

FOLDER = DOCS / "profiles"
PROFILES = pytest.mark.parametrize("profile", STANDARD.values(), ids=STANDARD)
MOBILE = STANDARD["mobile"]


def published(name: str) -> list[dict[str, Any]]:
    """Return the schemas of a profile that were published, the newest last."""
    files = (FOLDER / "schemas").glob(f"{name}-*.json")
    found = [json.loads(file.read_text(encoding="utf-8")) for file in files]
    return sorted(found, key=lambda one: [*map(int, one["x-rcp-profile"]["version"].split("."))])


@PROFILES
def test_a_profile_keeps_what_was_published_of_it(profile: Profile) -> None:
    newest = published(profile.name)[-1]
    found = unannounced(newest, document(profile))
    assert not found, (
        f"{profile.id} differs from what was published as {newest['$id']}: {'; '.join(found)}. "
        "Raise its version (the minor for what is only added), then `rcpd profiles --write docs/profiles`"
    )


def test_pages_and_schemas_are_those_of_the_definitions(tmp_path: Path) -> None:
    write_profiles(STANDARD.values(), tmp_path)
    for file in [*tmp_path.glob("*.md"), *tmp_path.glob("schemas/*.json")]:
        kept = FOLDER / file.relative_to(tmp_path)
        assert kept.exists(), f"run `rcpd profiles --write docs/profiles`: {kept.name} is missing"
        assert kept.read_text(encoding="utf-8") == file.read_text(encoding="utf-8"), kept.name
    rows = index(STANDARD.values())
    assert rows in (FOLDER / "README.md").read_text(encoding="utf-8")


@PROFILES
def test_a_definition_is_a_resource_that_a_gateway_takes(profile: Profile) -> None:
    for definition in profile.resources:
        resource = _checked(definition.resource)
        for part in ("value", "input", "output", "feedback"):
            if (type_ := getattr(resource, part)) is not None:
                schema = value_type(type_).schema
                assert not list(numbers_without_unit(schema)), f"{part} of {resource.name}"


@PROFILES
def test_the_document_is_a_schema_that_the_examples_fit(profile: Profile) -> None:
    made = document(profile)
    jsonschema.Draft202012Validator.check_schema(made)
    validator = jsonschema.Draft202012Validator(made)
    for definition in profile.resources:
        for example in definition.resource.examples:
            validator.validate({definition.name: example})
    if "sensor/velocity" in made["properties"]:
        assert not validator.is_valid({"sensor/velocity": {"linear": "fast"}})


def changed(name: str, **facts: Any) -> Profile:
    """Return `mobile` with something else in one definition, or in its resource."""
    own = {key: facts.pop(key) for key in list(facts) if key in Definition.__struct_fields__}

    def made(one: Definition) -> Definition:
        if one.name != name:
            return one
        return replace(one, **({"resource": replace(one.resource, **facts)} | own))

    return replace(MOBILE, resources=tuple(map(made, MOBILE.resources)))


class Hasty(m.MoveTo, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """With a field that older clients do not send."""

    hurry: bool


class Polite(m.MoveTo, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """With a field that older clients need not send."""

    hurry: bool = False


class Narrow(m.MoveTo, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """With fewer frames."""

    frame: Annotated[str, msgspec.Meta(pattern="^map$")] = "map"


class Elsewhere(m.MoveTo, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """With another frame where none is given."""

    frame: str = "odom"


class Vague(m.MoveFeedback, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """With a distance that may be missing."""

    distance_remaining: quantity("m", ge=0) | None


class Richer(PoseStamped, frozen=True, forbid_unknown_fields=True):
    """With more to tell."""

    quality: quantity("1") = 1.0


def without(name: str) -> Profile:
    return replace(MOBILE, resources=tuple(one for one in MOBILE.resources if one.name != name))


def with_more(*, required: bool) -> Profile:
    more = Definition(
        resource=STANDARD["battery"].resources[0].resource,
        required=required,
    )
    return replace(MOBILE, resources=(*MOBILE.resources, more))


BREAKING: dict[str, Callable[[], Profile]] = {
    "action/move_to is gone": lambda: without("action/move_to"),
    "sensor/battery is new": lambda: with_more(required=True),
    "action/move_to is optional now": lambda: changed("action/move_to", required=False),
    "sensor/pose: frame is odom, not map": lambda: changed("sensor/pose", frame="odom"),
    "the value is in km/h, not in m/s": lambda: changed(
        "param/speed_limit", value=quantity("km/h", ge=0)
    ),
    "the value is bounded by maximum 3": lambda: changed(
        "param/speed_limit", value=quantity("m/s", ge=0, le=3)
    ),
    "the value may be beyond minimum 0": lambda: changed(
        "param/speed_limit", value=quantity("m/s")
    ),
    "/hurry is required": lambda: changed("action/move_to", input=Hasty),
    "/frame is bounded by pattern": lambda: changed("action/move_to", input=Narrow),
    "/distance_remaining may be null": lambda: changed("action/move_to", feedback=Vague),
    "action/move_to, feedback is gone": lambda: changed("action/move_to", feedback=None),
    "action/move_to: gateway is True, not None": lambda: changed("action/move_to", gateway=True),
    "sensor/pose offers write": lambda: changed(
        "sensor/pose", operations=BRANCHES[Kind.SENSOR] | Operation.WRITE
    ),
    "/frame is odom if left out, not map": lambda: changed("action/move_to", input=Elsewhere),
    "it includes drive/1.0 no longer": lambda: replace(MOBILE, includes=()),
}
ADDING: dict[str, Callable[[], Profile]] = {
    "an optional resource": lambda: with_more(required=False),
    "an input that may be left out": lambda: changed("action/move_to", input=Polite),
    "a field of a value": lambda: changed("sensor/pose", value=Richer),
    "another wording": lambda: changed("sensor/pose", description="Where it is."),
}


@pytest.mark.parametrize("says", BREAKING)
def test_a_change_that_breaks_needs_a_new_major_version(says: str) -> None:
    made = BREAKING[says]()
    assert any(says in one for one in unannounced(document(MOBILE), document(made)))
    minor = replace(made, version="1.2")
    assert any(says in one for one in unannounced(document(MOBILE), document(minor)))
    assert unannounced(document(MOBILE), document(replace(made, version="2.0"))) == []


@pytest.mark.parametrize("what", ADDING)
def test_what_is_only_added_needs_a_new_minor_version(what: str) -> None:
    made = ADDING[what]()
    assert unannounced(document(MOBILE), document(made))
    assert unannounced(document(MOBILE), document(replace(made, version="1.2"))) == []


def test_the_wording_of_a_type_is_free() -> None:
    words = {"__doc__": "A place, in better words."}
    reworded = msgspec.defstruct(
        "MoveTo", [], bases=(m.MoveTo,), namespace=words, frozen=True, forbid_unknown_fields=True
    )
    made = changed("action/move_to", input=reworded)
    assert document(made) != document(MOBILE)
    assert unannounced(document(MOBILE), document(made)) == []


def test_nothing_changes_without_a_change() -> None:
    for profile in STANDARD.values():
        assert changes(document(profile), document(profile)) == []


def test_the_command_lists_shows_and_exports_profiles() -> None:
    run = CliRunner().invoke
    listed = run(main, ["profiles"]).output.splitlines()
    assert [line.split()[0] for line in listed] == [one.id for one in STANDARD.values()]
    assert "## `action/move_to`" in run(main, ["profiles", "mobile"]).output
    assert json.loads(run(main, ["profiles", "mobile", "--schema"]).output) == document(MOBILE)
    assert len(json.loads(run(main, ["profiles", "--schema"]).output)) == len(STANDARD)
    wrong = run(main, ["profiles", "mobil"])
    assert wrong.exit_code != 0
    assert "did you mean 'mobile'?" in wrong.output


def test_a_plugins_profiles_are_published_beside_the_standard_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    crane = replace(MOBILE, name="acme.crane", description="A crane.")

    @hookimpl
    def offer() -> list[Profile]:
        return [crane]

    monkeypatch.setattr(rcp_sim, "rcp_profiles", offer, raising=False)
    listed = CliRunner().invoke(main, ["profiles"]).output
    assert crane.id in listed
    assert json.loads(
        CliRunner().invoke(main, ["profiles", "acme.crane", "--schema"]).output
    ) == document(crane)

    @hookimpl
    def again() -> list[Profile]:
        return [MOBILE]

    monkeypatch.setattr(rcp_sim, "rcp_profiles", again)
    twice = CliRunner().invoke(main, ["profiles"])
    assert twice.exit_code != 0
    assert "two plugins offer the profile 'mobile'" in twice.output
