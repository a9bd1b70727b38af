"""Keys that are easy to guess are told of: by name to whoever checks the file, by number in the log."""

from __future__ import annotations

import os
import secrets
import signal
import uuid
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner

from durability.process import ADMIN, Served, until
from rcp_kernel.config.file import parse
from rcpd.cli import main
from rcpd.demo import Demo
from rcpd.key_strength import entropy, weak_keys

ENOUGH = 64
CONFIG = """
[transports.asgi]
port = 0
[[backends]]
use = "sim"
name = "rover"
tenant = "alpha"
[[keys]]
name = "ann"
role = "operator"
key = "{ann}"
[[keys]]
name = "bob"
role = "operator"
sha256 = "{bob}"
"""


@pytest.mark.parametrize(
    "key",
    [
        "operator-operator",
        "changeme12345678",
        "correct horse battery staple",
        "SuperSecretKey2026!",
        "Password123Password123",
        "A1b2C3A1b2C3A1b2C3A1b2C3",
        "0123456789abcdef0123456789abcdef",
        "aaaaaaaaaaaaaaaaaaaaaaaaaaaaaaaa",
        "the-key-of-the-pilot-0123456789",
    ],
)
def test_words_repetitions_and_sequences_are_weak(key: str) -> None:
    assert entropy(key) < ENOUGH


@pytest.mark.parametrize(
    "made",
    [
        lambda: secrets.token_hex(16),
        lambda: secrets.token_hex(32).upper(),
        lambda: secrets.token_urlsafe(24),
        lambda: secrets.token_urlsafe(32),
        lambda: str(uuid.uuid4()),
        lambda: "anchor cactus violin thunder meadow pencil",
    ],
)
def test_what_chance_made_is_strong(made: Callable[[], str]) -> None:
    for _ in range(200):
        key = made()
        assert entropy(key) >= ENOUGH, key


def test_the_keys_of_the_demo_are_strong() -> None:
    assert weak_keys(parse(Demo(0).config("info"), "demo").keys) == []


def test_check_names_a_weak_key_and_says_what_to_do(tmp_path: Path) -> None:
    file = tmp_path / "rcp.toml"
    for ann, warned in (("operator-operator", True), (secrets.token_hex(32), False)):
        file.write_text(CONFIG.format(ann=ann, bob="0" * 64))
        done = CliRunner().invoke(main, ["check", str(file)])
        assert done.exit_code == 0, done.output
        assert ("key 'ann' is easy to guess" in done.output) is warned
        assert ("`openssl rand -hex 32`" in done.output) is warned
        assert (f"`rcpd token create ann --config {file}" in done.output) is warned
        assert "'bob'" not in done.output
        assert ann not in done.output


def test_the_log_has_their_number_at_the_start_and_after_a_reload(tmp_path: Path) -> None:
    served = Served(tmp_path, tmp_path / "store.db")
    try:
        (line,) = [line for line in served.text.splitlines() if "weak_keys" in line]
        assert '"keys": 1' in line
        assert f"rcpd check {served.config}" in line
        text = served.config.read_text()
        served.config.write_text(text + text[text.index("[[keys]]") : text.index("[store]")])
        os.kill(served.pid, signal.SIGHUP)
        until(lambda: '"keys": 2' in served.text)
        assert ADMIN not in served.text
    finally:
        served.end()
