"""A configuration's fault is told with file, table, the nearest right name and what is allowed."""

from __future__ import annotations

from pathlib import Path

import pytest

from rcp_gateway.server import prepare
from rcp_kernel.config.file import load, parse
from rcp_kernel.errors import ConfigError

GOOD = """
[[backends]]
use = "sim"
tenant = "alpha"
"""


def refused(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        prepare(parse(text, "robots.toml"), "robots.toml")
    return str(caught.value)


def test_a_short_file_is_enough() -> None:
    config = parse(GOOD, "robots.toml")
    assert config.tenant_names == ["alpha"]
    assert config.backends[0].name == "sim"
    assert set(config.transports) == {"asgi", "http", "ws", "sse"}


def test_a_transport_is_taken_out_by_false() -> None:
    assert "sse" not in parse("[transports]\nsse = false", "robots.toml").transports


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("[limit]\nmessage = 4", ["unknown key `limit`", "did you mean `limits`", "robots.toml"]),
        ("[limits]\nmesage = 4096", ["[limits]", "`mesage`", "did you mean `message`", "in_flight"]),
        ('[limits]\nmessage = "big"', ["limits.message", "'big'", "int"]),
        ("[limits]\nmessage = 3", ["limits.message = 3", ">= 1024"]),
        (GOOD + "rat = 3", ["backend 'sim'", "`rat`", "did you mean `rate`"]),
        (GOOD + "rate = 5000", ["backend 'sim'", "rate = 5000", "<= 1000"]),
        ('[[backends]]\nuse = "sin"\ntenant = "a"', ["backends 'sin'", "did you mean 'sim'"]),
        ('[[backends]]\nuse = "sim"', ["backends[0]", "tenant"]),
        ('[backends]\nuse = "sim"', ["[[backends]]"]),
        (GOOD + GOOD, ["two [[backends]] have the name 'sim'"]),
        ('[[keys]]\nname = "k"\nrole = "boss"\nkey = "0123456789abcdef"', ["role 'boss'", "operator"]),
        ('[[keys]]\nname = "k"\nrole = "admin"', ["key 'k' needs either `key` or `sha256`"]),
        ('[[keys]]\nname = "k"\nrole = "admin"\nkey = "short"', ["keys[0].key", "length"]),
        ('[anonymous]\nrole = "viewr"', ["did you mean 'viewer'"]),
        ('[[roles.x.allow]]\noperations = ["fly"]\npaths = ["/**"]', ["roles", "'fly'"]),
        ("transports = 3", ["transports"]),
        ('[transports.asgi]\nhost = "0.0.0.0"', ["0.0.0.0", "reachable from other machines", "anonymous = false"]),
        ("a = ", ["not TOML"]),
    ],
)  # fmt: skip
def test_a_fault_is_told_in_full(text: str, parts: list[str]) -> None:
    message = refused(text)
    assert "robots.toml" in message or "installed plugin" in message
    for part in parts:
        assert part in message


def test_a_secret_comes_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    text = '[[keys]]\nname = "k"\nrole = "admin"\nkey = "${ROBOT_KEY}"'
    monkeypatch.setenv("ROBOT_KEY", "0123456789abcdef-secret")
    assert parse(text, "f").keys[0].key == "0123456789abcdef-secret"
    monkeypatch.delenv("ROBOT_KEY")
    with pytest.raises(ConfigError, match=r"keys\[0\].key uses the environment variable ROBOT_KEY"):
        parse(text, "f")


def test_a_secret_never_stands_in_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROBOT_KEY", "topsecret")
    with pytest.raises(ConfigError) as caught:
        parse('[[keys]]\nname = "k"\nrole = "admin"\nkey = "${ROBOT_KEY}"', "f")
    assert "topsecret" not in str(caught.value)


def test_a_file_that_is_not_there_is_told_by_its_name(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.toml: cannot be read"):
        load(tmp_path / "nowhere.toml")


OPEN = '[transports.asgi]\nhost = "0.0.0.0"\n'
PLAIN = OPEN + "plaintext = true\n"
KEY = '[[keys]]\nname = "k"\nrole = "{}"\nkey = "a-key-of-this-test"\n'
NOTHING = "[roles.nothing]\nallow = []\n"


def test_strangers_are_kept_out_by_one_word() -> None:
    config = parse("anonymous = false\n" + PLAIN + KEY.format("viewer"), "robots.toml")
    assert config.closed
    prepare(config, "robots.toml")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (PLAIN + KEY.format("viewer"), "clients need no credentials"),
        ("anonymous = false\n" + PLAIN, "no credentials give a role"),
        ("anonymous = false\n" + PLAIN + KEY.format("nothing") + NOTHING, "no credentials give"),
        ("anonymous = false\n" + OPEN + KEY.format("viewer"), "in plain text"),
    ],
)
def test_what_is_open_to_others_has_to_be_safe(text: str, told: str) -> None:
    with pytest.raises(ConfigError, match=rf"robots\.toml: \[transports\.asgi\] .*{told}"):
        prepare(parse(text, "robots.toml"), "robots.toml")
    prepare(parse(text.replace("0.0.0.0", "127.0.0.1"), "robots.toml"), "robots.toml")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('role = "viewer"', "needs a `subject` or a `san`"),
        ('subject = "x"', "needs a `role`"),
        ('subject = "x"\nrole = "vewer"', "did you mean 'viewer'"),
        ('san = "x.example"\nrole = "viewer"', "san = 'x.example'"),
    ],
)
def test_a_certificate_says_whose_it_is_and_what_it_may(text: str, told: str) -> None:
    assert told in refused(f'[[certificates]]\nname = "c"\n{text}')


def test_a_subject_of_no_known_form_is_found_before_anything_starts() -> None:
    text = '[[certificates]]\nname = "c"\nrole = "viewer"\nsubject = "CN=a=b, nothing"\n'
    with pytest.raises(ConfigError, match=r"robots\.toml: .* 'c': .* not an RFC 4514 name"):
        prepare(parse(text, "robots.toml"), "robots.toml")
