"""Each of the broken files is told of with its line, and what the message says mends it."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner

from broken import BROKEN, CAN, MAVLINK, NEEDS, PAN, Broken
from rcp_gateway.server import prepare
from rcp_kernel.config.file import load
from rcp_kernel.errors import StartupError
from rcpd.cli import main
from rcpd.diagnosis import Diagnosis, explained

MARK = "#!"


def marked(text: str) -> list[int]:
    return [i for i, line in enumerate(text.split("\n"), 1) if line.endswith(MARK)]


def mended(one: Broken) -> str:
    lines = one.text.split("\n")
    (number,) = marked(one.text)
    assert one.mend is not None
    lines[number - 1] = "" if one.mend.startswith("^") else one.mend
    return "\n".join([one.mend[1:], *lines] if one.mend.startswith("^") else lines)


def needs_its_extra(text: str) -> None:
    for part, module in NEEDS.items():
        if part in text:
            pytest.importorskip(module)


def refusal(file: Path) -> StartupError | None:
    try:
        prepare(load(file), str(file))
    except StartupError as error:
        return error
    return None


def test_there_are_enough() -> None:
    assert len({one.text for one in BROKEN}) == len(BROKEN) >= 110


@pytest.mark.parametrize("one", BROKEN, ids=lambda one: one.says)
def test_a_fault_is_told_with_its_line_and_its_mend(
    one: Broken, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RCP_EMPTY", "")
    needs_its_extra(one.text)
    found = Diagnosis(one.text, "rcp.toml").findings
    assert [fault.line for fault in found] == marked(one.text), found
    assert one.says in found[0].message
    if one.mend is not None:
        assert Diagnosis(mended(one), "rcp.toml").findings == []


SEVERAL = f"""\
name = 3 #!
nmae = "x" #!

[limits]
message = 3 #!
mesage = 4096 #!
anonymous = false #!
deadline = "long" #!

[log]
level = inof #!

[[backends]] # a robot
use = "sim"
name = "ro ver" #!
tennant = "alpha" #!
rat = 3 #!

[[backends]]
use = "sin" #!
tenant = "alpha"

{CAN}
{PAN}
{PAN.replace("pan", "tilt").replace("node = 1", "node = 1 #!")}
[transports]
aggi = {{}} #!
asgi = {{ port = 80800 }} #!

[[keys]]
name = "ann"
role = "operater" #!
key = \"\"\"
a-long-key-of-this-test-1\"\"\"

[[keys]]
name = "bob"
role = "viewer"
key = "a-long-key-of-this-test-1" #!

[[keys]]
name = "eve"
role = "viewer"
key = "${{RCP_NOT_SET}}" #!

[roles.driver]
allow = [
  {{ operations = ["read"], paths = ["/**"] }},
  {{ operations = ["fly"], paths = ["/**"] }}, #!
]
"""


def test_several_faults_are_told_at_once() -> None:
    pytest.importorskip("can")
    found = Diagnosis(SEVERAL, "rcp.toml").findings
    assert sorted({fault.line for fault in found}) == marked(SEVERAL)
    assert len(found) == len(marked(SEVERAL))


def test_a_file_of_nothing_but_faults_is_bounded() -> None:
    text = "[limits]\n" + "".join(f"wrong_{i} = {i}\n" for i in range(1000))
    found = Diagnosis(text, "rcp.toml")
    assert len(found.findings) == 100
    assert found.full


def test_lists_nested_too_deep_are_one_fault() -> None:
    (fault,) = Diagnosis("name = " + "[" * 50_000, "rcp.toml").findings
    assert "nested too deep" in fault.message


def test_a_line_names_file_table_and_key(tmp_path: Path) -> None:
    file = tmp_path / "rcp.toml"
    file.write_text('[[backends]]\nuse = "sim"\nname = "rover"\ntenant = "a"\nrate = 5000\n')
    done = CliRunner().invoke(main, ["check", str(file)])
    assert done.exit_code == 1
    assert f"\n{file}:5: [backends.rover] rate: 5000 does not fit: write a number" in done.output


def test_faults_as_json(tmp_path: Path) -> None:
    file = tmp_path / "rcp.toml"
    file.write_text("[limits]\nmessage = 3\nmesage = 3\n")
    done = CliRunner().invoke(main, ["check", "--json", str(file)])
    assert done.exit_code == 1
    answer = msgspec.json.decode(done.output)
    assert answer["file"] == str(file)
    assert not answer["ok"]
    assert [(one["line"], one["table"], one["key"]) for one in answer["faults"]] == [
        (2, "limits", "message"),
        (3, "limits", "mesage"),
    ]
    file.write_text("")
    done = CliRunner().invoke(main, ["check", "--json", str(file)])
    assert done.exit_code == 0
    assert msgspec.json.decode(done.output) == {
        "file": str(file),
        "ok": True,
        "faults": [],
        "warnings": [],
    }


def test_a_gateway_that_nobody_can_reach_is_warned_of(tmp_path: Path) -> None:
    file = tmp_path / "rcp.toml"
    file.write_text("[transports]\nasgi = false\n")
    done = CliRunner().invoke(main, ["check", str(file)])
    assert done.exit_code == 0
    assert f"warning: {file}:2: [transports] asgi: nothing listens" in done.output


@pytest.mark.parametrize("one", BROKEN, ids=lambda one: one.says)
def test_a_start_that_is_refused_tells_of_the_fault_for_which_it_is(
    one: Broken, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RCP_EMPTY", "")
    needs_its_extra(one.text)
    lesser = "" if "store" in one.text else f'store = {{ path = "{tmp_path}" }} # is a folder\n'
    file, text = tmp_path / "rcp.toml", lesser + one.text
    file.write_text(text)
    error = refusal(file)
    if error is None:
        assert Diagnosis(text, str(file)).refusal(StartupError("")) is None
        return
    (line,) = marked(text)
    assert explained(error, file).startswith(f"{file}:{line}: ")


def test_a_file_that_is_not_there_is_told_as_the_check_does(tmp_path: Path) -> None:
    file = tmp_path / "rcp.toml"
    done = CliRunner().invoke(main, ["serve", str(file)])
    assert done.exit_code == 1
    assert f"{file}:1: cannot be read: No such file or directory; `rcpd init`" in done.output


def test_a_refusal_that_no_fault_explains_is_told_itself(tmp_path: Path) -> None:
    file = tmp_path / "rcp.toml"
    file.write_text(f'store = {{ path = "{tmp_path}" }}\n')
    told = explained(StartupError("the plugin 'x' has a hook that is async"), file)
    assert told == f"the plugin 'x' has a hook that is async (1 more: `rcpd check {file}`)"


def test_serve_names_the_first_fault_with_its_line_and_counts_the_others(tmp_path: Path) -> None:
    file = tmp_path / "rcp.toml"
    file.write_text("[limits]\nmessage = 3\nmesage = 3\n")
    done = CliRunner().invoke(main, ["serve", str(file)])
    assert done.exit_code == 1
    assert done.output.startswith(f"rcpd: {file}:2: [limits] message: 3 does not fit")
    assert done.output.endswith(f"(1 more: `rcpd check {file}`)\n")


def test_links_that_are_no_list_are_one_fault() -> None:
    needs_its_extra(MAVLINK)
    text = f'{MAVLINK}name = "a"\n{MAVLINK}name = "b"\nlinks = "x"\n'
    found = Diagnosis(text, "rcp.toml").findings
    assert [fault.line for fault in found] == [9], found


@pytest.mark.parametrize("key", ["key", "sha256"])
def test_a_secret_is_in_no_finding(key: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RCP_SECRET", "Open-Sesame")
    text = f'[[keys]]\nname = "${{RCP_SECRET}}"\nrole = 3\n{key} = "${{RCP_SECRET}}"\nkee = 3\n'
    found = Diagnosis(text + '[log]\nlevel = "${RCP_SECRET}"\n', "rcp.toml").findings
    assert len(found) >= 3
    assert "Sesame" not in repr(found)
