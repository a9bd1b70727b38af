"""`rcpctl` for people: formats, completion in shells, watched listings, plots and the screen of all robots."""

from __future__ import annotations

import json
import os
import subprocess

import jsonpath
import pytest
import yaml

from plugins.client.rcpctl import BIN, BOUND, NEAR, OPERATOR, Run, document, documents
from plugins.client.test_rcpctl_terminal import Terminal

LISTINGS = (
    ("discover", "/sensor/*"),
    ("read", "/sensor/*"),
    ("status",),
    ("robots",),
    ("commands",),
)


@pytest.mark.parametrize("command", LISTINGS, ids=" ".join)
def test_every_listing_is_written_in_each_format(run: Run, command: tuple[str, ...]) -> None:
    names = [
        one.get("path") or one.get("version") for one in documents(run(*command, "-o", "json"))
    ]
    found = run(*command, "-o", "yaml")
    read = list(yaml.safe_load_all(found.stdout))
    assert [one.get("path") or one.get("version") for one in read] == names
    chosen = run(*command, "-o", "jsonpath={.path}").stdout.splitlines()
    assert chosen == [name for name in names if name.startswith("/")]
    table = run(*command, "-o", "table").stdout
    assert not table.startswith("{")


def test_an_expression_chooses_a_number_that_a_script_can_use(run: Run) -> None:
    found = run("read", "/sensor/battery", "-o", "jsonpath=$.body.percentage").stdout
    assert 0 <= float(found) <= 1
    assert jsonpath.findall("$.body.percentage", document(run("read", "/sensor/battery")))


@pytest.mark.parametrize("wanted", ["xml", "jsonpath=$[", "jsonpath={.path", "jsonpath"])
def test_a_format_that_is_none_is_a_fault_of_the_command_line(run: Run, wanted: str) -> None:
    done = run("robots", "-o", wanted)
    assert done.returncode == 2
    assert f"-o '{wanted}'" in done.stderr or f"-o {wanted}" in done.stderr


def test_a_library_that_is_missing_is_named_with_its_remedy(url: str) -> None:
    program = (
        "import sys; sys.modules['yaml'] = None; sys.argv[1:] = ['robots', '-o', 'yaml']\n"
        "from rcp_client.cli import main; main()"
    )
    done = subprocess.run(
        [BIN / "python", "-c", program],
        capture_output=True,
        check=False,
        text=True,
        timeout=BOUND,
        env={**os.environ, "RCP_URL": url, "RCP_TOKEN": OPERATOR},
    )
    assert done.returncode == 2
    assert "pip install 'rcp-client[console]'" in done.stderr


def completed(run: Run, shell: str, line: str) -> list[str]:
    """Return what a shell is offered at the end of a line."""
    words = line.split(" ")
    number = str(len(words) - 1)
    extra = words[-1] if shell == "fish" else number
    done = run(_RCPCTL_COMPLETE=f"{shell}_complete", COMP_WORDS=line, COMP_CWORD=extra)
    return done.stdout.splitlines()


@pytest.mark.parametrize(
    ("line", "has", "lacks"),
    [
        ("rcpctl read /sensor/p", "/sensor/pose", "/sensor/battery"),
        ("rcpctl read /tenant/alpha/sensor/p", "/tenant/alpha/sensor/pose", "/sensor/pose"),
        ("rcpctl execute /a", "/action/move_to", "/actuator/cmd_vel"),
        ("rcpctl write /", "/actuator/cmd_vel", "/action/move_to"),
        ("rcpctl watch /sensor/", "/sensor/pose", "/action/move_to"),
        ("rcpctl estop /tenant/", "/tenant/alpha", "/sensor/pose"),
        ("rcpctl rea", "read", "robots"),
    ],
)
def test_paths_complete_as_the_gateway_has_them(run: Run, line: str, has: str, lacks: str) -> None:
    found = {offer.partition(",")[2] for offer in completed(run, "bash", line)}
    assert has in found
    assert lacks not in found
    assert has in completed(run, "zsh", line)
    assert any(f",{has}" in offer for offer in completed(run, "fish", line))


def test_a_gateway_that_is_away_completes_nothing_and_says_nothing(
    run: Run, unused_port: int
) -> None:
    away = f"rcpctl --url http://127.0.0.1:{unused_port} read /"
    assert "".join(completed(run, "bash", away)) == ""


def test_bash_itself_takes_the_script(url: str) -> None:
    program = (
        'eval "$(rcpctl completion bash)"\n'
        "COMP_WORDS=(rcpctl read /sensor/pos) COMP_CWORD=2\n"
        '_rcpctl_completion rcpctl; printf "%s\\n" "${COMPREPLY[@]}"'
    )
    done = subprocess.run(
        ["bash", "-c", program],
        capture_output=True,
        check=True,
        text=True,
        timeout=BOUND,
        env={
            **os.environ,
            "PATH": f"{BIN}:{os.environ['PATH']}",
            "RCP_URL": url,
            "RCP_TOKEN": OPERATOR,
        },
    )
    assert done.stdout == "/sensor/pose\n"


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_the_other_shells_have_a_script(run: Run, shell: str) -> None:
    assert "_RCPCTL_COMPLETE" in run("completion", shell).stdout


def test_a_watched_listing_is_kept_up_to_date(run: Run, url: str) -> None:
    with Terminal(url, "commands", "--watch", "-o", "json") as terminal:
        done = document(run("execute", "/action/move_to", NEAR))
        terminal.until(done["command"])
        terminal.interrupt()
        assert terminal.wait() == 130
    shown = [line for line in terminal.text.splitlines() if line.startswith("{")]
    assert len(shown) == len(set(shown))  # only what is new


def test_progress_is_one_line_that_is_written_anew(run: Run, url: str) -> None:
    with Terminal(
        url, "execute", "/action/move_to", '{"position": {"x": 0.4, "y": 0}}'
    ) as terminal:
        assert terminal.wait() == 0
    assert terminal.text.count("\r\x1b[K") > 3
    assert "█" in terminal.text
    assert "%" in terminal.text
    last = terminal.text.split("\r\x1b[K")[-1]
    assert last.startswith("\x1b[32mcompleted")
    run("execute", "/action/move_to", NEAR)


def test_numbers_are_plotted(run: Run) -> None:
    done = run("plot", "/sensor/pose", "--field", "position.x", "--count", "5", "-o", "table")
    assert done.returncode == 0, done.stderr
    assert "(value)" in done.stdout
    assert "/tenant/alpha/sensor/pose.position.x = " in done.stdout
    (line,) = documents(
        run("plot", "/sensor/pose", "--field", "position.x", "--count", "5", "--json")
    )
    times = [moment for moment, _ in line["points"]]
    assert len(times) == 5
    assert times == sorted(times)


def test_a_plot_moves_on_a_terminal(url: str) -> None:
    with Terminal(url, "plot", "/sensor/pose", "--field", "position.x") as terminal:
        terminal.until("position.x = ")
        terminal.interrupt()
        assert terminal.wait() == 130
    assert "Traceback" not in terminal.text


def test_what_has_no_number_is_not_plotted(run: Run) -> None:
    done = run("plot", "/sensor/pose", "--field", "frame_id", "--count", "1")
    assert done.returncode == 2
    assert "no number was received" in done.stderr


def test_the_screen_shows_robots_rates_and_a_latched_stop(run: Run, url: str) -> None:
    with Terminal(url, "top") as terminal:
        terminal.until("SAMPLES/S")
        terminal.until("/tenant/alpha")
        run("estop", "--reason", "a try")
        try:
            terminal.until("E-stop latched")
        finally:
            with_admin = run("estop", "--reset", RCP_TOKEN="administrator-of-the-rcpctl-tests")
            assert with_admin.returncode == 0
        terminal.interrupt()
        assert terminal.wait() == 130
    assert "Traceback" not in terminal.text
    facts = json.loads(run("top", "--json").stdout)
    assert facts["rates"]["rover"] > 0
    assert facts["robots"][0]["path"] == "/tenant/alpha"


def test_a_command_of_a_feature_that_is_not_there_says_so(run: Run) -> None:
    told = run("record", "list")
    assert told.returncode != 0
    assert "[features.recorder]" in told.stderr
    assert "Run `rcpctl discover`" not in told.stderr
