"""Every code block of every page is run or checked; one that nothing checks is a failure."""

from __future__ import annotations

import base64
import configparser
import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
import warnings
from collections.abc import Callable, Iterator
from itertools import groupby
from pathlib import Path
from textwrap import indent
from typing import NoReturn

import click
import pytest
import yaml
from click.testing import CliRunner

from docs.blocks import BLOCKS, Block
from docs.pages import ROOT
from plugins.client.test_codegen import node
from programs import program
from rcp_client.cli import rcpctl
from rcp_client.codegen import generate
from rcpd.cli import main as rcpd
from rcpd.diagnosis import Diagnosis

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = set(PROJECT["optional-dependencies"])
TARGETS = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
# What is not of this project, so that only the shell says whether it can be written like this.
FOREIGN = frozenset(
    [
        ".",
        "./main",
        "cat",
        "cd",
        "claude",
        "colcon",
        "cp",
        "curl",
        "docker",
        "echo",
        "export",
        "go",
        "jupyter",
        "mkdir",
        "mosquitto",
        "npx",
        "openssl",
        "pip",
        "promtool",
        "pytest",
        "python",
        "python3",
        "ros2",
        "rustc",
        "sudo",
        "systemctl",
        "umask",
    ]
)
_PLAIN = frozenset({"", "text", "mermaid"})
"""What nobody runs: what a program printed, drawings."""


def of(*languages: str) -> list[Block]:
    return [block for block in BLOCKS if block.language in languages]


def each(*languages: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Run a test with each block in these languages."""
    _CHECKED.update(languages)
    return pytest.mark.parametrize("block", of(*languages), ids=str)


_CHECKED: set[str] = set()


@each("sh", "bash")
def test_a_shell_takes_a_block_and_each_of_our_programs_its_command_line(block: Block) -> None:
    subprocess.run(["bash", "-n"], input=block.text, text=True, check=True, timeout=60)
    for words in commands(block.text):
        takes(words)


def commands(text: str) -> Iterator[list[str]]:
    """Return the words of the commands of a script, without its substitutions and redirections."""
    for line in text.replace("\\\n", " ").splitlines():
        lexer = shlex.shlex(line, posix=True, punctuation_chars="|&;<>()")
        lexer.whitespace_split = True
        words: list[str] = []
        skipped = False
        for word in lexer:
            if skipped:
                skipped = False
            elif word[0] in "<>":
                skipped = True
            elif word[0] in "|&;()":
                yield words
                words = []
            else:
                words.append(word)
        yield words


def takes(words: list[str]) -> None:
    """Make sure that a program would take its arguments."""
    while words and re.match(r"\w+=", words[0]):
        words = words[1:]
    if not words:
        return
    program, *arguments = words
    name = program.removeprefix(".venv/bin/")
    if name in ("rcpctl", "rcpd"):
        parses(rcpctl if name == "rcpctl" else rcpd, name, arguments)
    elif name == "make":
        assert arguments[0] in TARGETS
    elif name == "pip":
        for extras in re.findall(r"rcp-gateway\[([\w,-]+)\]", " ".join(arguments)):
            assert set(extras.split(",")) <= EXTRAS
    elif name == "python" and arguments[0] != "-m":
        assert (ROOT / arguments[0]).is_file()
    else:
        assert name in FOREIGN, f"{name} is no command that the tests know"


def parses(command: click.Command, name: str, arguments: list[str]) -> None:
    """Parse a command line down to its subcommand, without running it."""
    parent: click.Context | None = None
    while True:
        try:
            with CliRunner().isolation(input="an-answer\n" * 9):
                context = command.make_context(name, arguments, parent)
        except click.BadParameter as error:
            assert "does not exist" in error.message  # noqa: PT017 - a file of the reader
            return
        with warnings.catch_warnings():  # Click 9 has all of them in `args`
            warnings.simplefilter("ignore", DeprecationWarning)
            rest = [*getattr(context, "protected_args", ()), *context.args]
        if not isinstance(command, click.Group) or not rest:
            return
        name, found, arguments = command.resolve_command(context, rest)
        assert found is not None
        assert name is not None
        command, parent = found, context


# An excerpt of a robot's table.
_PART = re.compile(r"(interfaces = |\[backends\.)")
# What an excerpt leaves out, or only the reader's machine has.
_LEFT_OUT = re.compile(
    r"cannot be (read|imported)|No such file|there is no (recording|folder|file)|"
    r"needs `buses`|there is no tenant|refers to the unknown tenant|"
    r"no installed plugin offers \w+ '(lift|maintenance|site|tcp|text|turntable|turtle)'"
)


@each("toml")
def test_a_configuration_of_a_page_has_no_fault_but_what_its_excerpt_leaves_out(
    block: Block, monkeypatch: pytest.MonkeyPatch
) -> None:
    if "[project" in block.text:
        assert tomllib.loads(block.text)["project"]
        return
    for name in re.findall(r"\$\{(\w+)\}", block.text):
        secret = f"{name} of this test, and of nobody else"
        monkeypatch.setenv(name, base64.b64encode(secret.encode()).decode())
    text = block.text
    if _PART.match(text) and "[[backends]]" not in text:
        use = block.page.removeprefix("backends/rcp_").partition("/")[0]
        text = f'[[backends]]\nuse = "{use}"\ntenant = "lab"\n{text}'
    found = Diagnosis(text, str(block)).findings
    assert [one for one in found if not _LEFT_OUT.search(one.message)] == []


@each("json")
def test_json_of_a_page_is_json(block: Block) -> None:
    rest = block.text.strip()
    while rest:  # a dialogue has several messages
        _, end = json.JSONDecoder().raw_decode(rest)
        rest = rest[end:].lstrip()


@each("yaml")
def test_yaml_of_a_page_is_yaml(block: Block) -> None:
    assert yaml.safe_load(block.text)


@each("ini")
def test_a_unit_of_a_page_is_what_rcpd_init_writes_but_for_its_hardening(block: Block) -> None:
    unit = configparser.RawConfigParser(strict=False)
    unit.read_string(block.text)
    template = (ROOT / "rcpd/templates/rcp-gateway.service.in").read_text(encoding="utf-8")
    known = set(re.findall(r"^(\w+)=", template, re.MULTILINE)) | {"ExecStartPre"}
    for section in unit.sections():
        assert {key.lower() for key in known} >= set(unit[section])


_TSC = ROOT / "plugins/rcp_dashboard/web/node_modules/typescript/bin/tsc"


@each("ts")
def test_typescript_of_a_page_has_no_error_of_types(block: Block, tmp_path: Path) -> None:
    found = node()
    if found is None or not _TSC.exists():
        lacking("the dashboard's packages are not installed: make dashboard")
    source = ROOT / "clients" / "typescript" / "src"
    given = "declare const token: string, url: string;\n"
    if "import { Client" not in block.text:
        given += 'import { Client } from "rcp-client";\n'
    (tmp_path / "page.ts").write_text(given + block.text, encoding="utf-8")
    packages = _TSC.parents[2]
    options = {
        "target": "es2023",
        "module": "esnext",
        "moduleResolution": "bundler",
        "strict": True,
        "noEmit": True,
        "skipLibCheck": True,
        "allowImportingTsExtensions": True,
        "types": [],
        "lib": ["es2023", "dom"],
        "paths": {
            "rcp-client": [str(source / "index.ts")],
            "rcp-client/msgpack": [str(source / "msgpack.ts")],
            "@msgpack/msgpack": [str(packages / "@msgpack/msgpack")],
        },
    }
    (tmp_path / "package.json").write_text('{"type": "module"}', encoding="utf-8")
    config = {"compilerOptions": options, "files": ["page.ts"]}
    (tmp_path / "tsconfig.json").write_text(json.dumps(config), encoding="utf-8")
    succeeds(str(found), str(_TSC), "-p", str(tmp_path))


@each("js")
def test_javascript_of_a_page_can_be_read(block: Block, tmp_path: Path) -> None:
    found = node()
    if found is None:
        lacking("there is no Node")
    (tmp_path / "page.mjs").write_text(block.text, encoding="utf-8")
    succeeds(str(found), "--check", str(tmp_path / "page.mjs"))


@each("nginx")
def test_nginx_takes_a_block(block: Block, tmp_path: Path) -> None:
    assert block.page == "docs/deploy.md"  # tests/docs/test_nginx.py runs it


_MODULES = {
    "docs/write-a-backend.md": ("rcp_turntable",),
    "docs/networked-backend.md": ("lift", "rcp_lift"),
}
"""What the last block of a page, which proves the others, imports of them."""


def test_python_of_the_pages_has_no_error_of_types(tmp_path: Path) -> None:
    """All pages at once, because the checker takes seconds to start."""
    _CHECKED.add("python")
    for page, blocks in groupby(of("python"), lambda block: block.page):
        text = "".join(typed(block) for block in blocks)
        for name in _MODULES.get(page, ()):
            (tmp_path / f"{name}.py").write_text(text.partition('"""Prove')[0])
        (tmp_path / f"{page.replace('/', '_').removesuffix('.md')}.py").write_text(text)
    settings = {
        "typeCheckingMode": "basic",
        "reportUndefinedVariable": "none",  # what an excerpt leaves out
        "reportInvalidTypeForm": "none",  # `quantity(…)` makes types
        "reportMissingModuleSource": "none",
        "reportRedeclaration": "none",
        "extraPaths": [str(ROOT / at) for at in ("", "backends", "plugins", "clients/python")],
    }
    (tmp_path / "pyrightconfig.json").write_text(json.dumps(settings), encoding="utf-8")
    succeeds(sys.executable, "-m", "pyright", "--pythonpath", sys.executable, "-p", str(tmp_path))


_RUSTLS = """
use std::{io, sync::Arc};
pub struct ClientConfig;
pub struct ClientConnection;
pub struct StreamOwned<C, T>(C, T);
impl ClientConnection {
    pub fn new(_: Arc<ClientConfig>, _: pki_types::ServerName<'static>) -> Result<Self, io::Error> {
        Ok(ClientConnection)
    }
}
impl<C, T> StreamOwned<C, T> {
    pub fn new(connection: C, stream: T) -> Self {
        StreamOwned(connection, stream)
    }
}
impl<C, T: io::Read> io::Read for StreamOwned<C, T> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        self.1.read(into)
    }
}
impl<C, T: io::Write> io::Write for StreamOwned<C, T> {
    fn write(&mut self, data: &[u8]) -> io::Result<usize> {
        self.1.write(data)
    }
    fn flush(&mut self) -> io::Result<()> {
        self.1.flush()
    }
}
pub mod pki_types {
    pub struct ServerName<'a>(std::marker::PhantomData<&'a ()>);
    impl TryFrom<String> for ServerName<'static> {
        type Error = std::fmt::Error;
        fn try_from(_: String) -> Result<Self, Self::Error> {
            Ok(ServerName(std::marker::PhantomData))
        }
    }
}
"""
"""What the pages use of rustls, which comes from a registry that not every machine reaches."""


@each("rust")
def test_rust_of_the_pages_compiles(block: Block, tmp_path: Path) -> None:
    (tmp_path / "rcp.rs").write_text(generate("rust", [], "http://robots"), encoding="utf-8")
    (tmp_path / "rustls.rs").write_text(_RUSTLS, encoding="utf-8")
    page = tmp_path / "page.rs"
    page.write_text(f"mod rcp;\nmod rustls;\n{block.text}\n")
    out = ("--emit", "metadata", "--out-dir", str(tmp_path))
    succeeds(program("rustc"), "--edition", "2021", "--crate-type", "lib", *out, str(page))


def typed(block: Block) -> str:
    """Return a block as a part of a module: what awaits is put into a function."""
    text = f"# {block}\n{block.text}\n"
    try:
        compile(block.text, str(block), "exec")
    except SyntaxError:
        return f"async def page_{block.line}():\n{indent(text, '    ')}\n"
    return text


def lacking(reason: str) -> NoReturn:
    if os.environ.get("RCP_CI"):
        pytest.fail(reason)
    pytest.skip(reason)


def succeeds(*command: str) -> None:
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_block_of_no_checked_language_is_plain_text() -> None:
    assert {block.language for block in BLOCKS} - _CHECKED <= _PLAIN
