"""`rcpctl` as a person or script runs it: real processes, against a real `rcpd`."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import time
from itertools import takewhile
from pathlib import Path

import pytest

from plugins.client.proxy import Proxy
from plugins.client.rcpctl import ADMIN, BIN, BOUND, FAR, NEAR, OPERATOR, Run, document, documents

# -- every subcommand ----------------------------------------------------------------------------


def test_discover_lists_resources_one_a_line(run: Run) -> None:
    found = documents(run("discover", "/**", "--kind", "param"))
    names = [item["path"].rpartition("/")[2] for item in found]
    assert names == ["robot_description", "speed_limit"]
    assert found[1]["schemas"]["value"]["maximum"] == 2.5
    table = run("discover", "--text", "-q", "charger").stdout.splitlines()
    assert table[0].split() == ["PATH", "KIND", "OPERATIONS", "STATE", "DESCRIPTION"]
    assert table[1].startswith("/tenant/alpha/action/dock ")
    shown = run("--text", "discover", "/action/move_to").stdout
    assert "position.x" in shown
    assert 'example  {"position": ' in shown
    assert "Nothing matches." in run("discover", "--text", "/param/none").stderr


def test_read_shows_values(run: Run) -> None:
    pose = document(run("read", "/sensor/pose", "--field", "position.x"))
    assert pose["path"] == "/tenant/alpha/sensor/pose"
    assert pose["body"]["position"].keys() == {"x"}
    assert pose["state"] == "fresh"
    assert run("read", "--text", "/param/speed_limit").stdout == "1.0\n"
    many = documents(run("read", "/event/*", "/param/*"))
    assert {item["path"].split("/")[3] for item in many} == {"event", "param"}


def test_fleet_says_that_a_gateway_is_no_hub(run: Run) -> None:
    done = run("fleet")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == (
        "rcpctl: this gateway is not the hub of a fleet. Pass the hub's address with --url.\n"
    )


def test_read_goes_on_after_a_path_that_is_not_there(run: Run) -> None:
    done = run("read", "/sensor/nothing", "/param/speed_limit")
    assert done.returncode == 3
    assert json.loads(done.stdout)["body"] == 1.0
    assert done.stderr == (
        "rcpctl: no resource /tenant/alpha/sensor/nothing. "
        "Run `rcpctl discover` to list the available paths.\n"
    )


def test_write_takes_json_standard_input_or_a_file(run: Run, tmp_path: Path) -> None:
    assert document(run("write", "/param/speed_limit", "0.5"))["body"] == 0.5
    assert document(run("write", "/param/speed_limit", "-", stdin="0.6\n"))["body"] == 0.6
    file = tmp_path / "value.json"
    file.write_text("0.7")
    assert document(run("write", "/param/speed_limit", f"@{file}"))["body"] == 0.7
    assert document(run("write", "--dry-run", "/param/speed_limit", "0.8"))["dry_run"] is True


def test_write_takes_several_paths_as_one(run: Run) -> None:
    rest = '/actuator/cmd_vel={"linear": {"x": 0}}'
    done = document(run("write", rest, "/param/speed_limit=0.65"))
    assert [one["path"].rpartition("/")[2] for one in done["body"]] == ["cmd_vel", "speed_limit"]
    assert document(run("read", "/param/speed_limit"))["body"] == 0.65
    for wrong in (("/param/speed_limit=0.5", "0.5"), ("/param/speed_limit",), ("/a=1", "/a=2")):
        assert run("write", *wrong).returncode == 2
    refused = run("write", rest, "/param/speed_limit=9")
    assert (refused.returncode, "allowed range" in refused.stderr) == (3, True)


def test_a_dry_run_writes_nothing(run: Run) -> None:
    run("write", "/param/speed_limit", "0.7")
    assert document(run("write", "--dry-run", "/param/speed_limit", "0.8"))["dry_run"] is True
    assert document(run("read", "/param/speed_limit"))["body"] == 0.7
    drive = '{"linear": {"x": 0.1}}'
    done = run("write", "/actuator/cmd_vel", drive, "--valid-for", "0.1", "--text")
    assert done.stdout.startswith("completed /tenant/alpha/actuator/cmd_vel written.\n")


def test_a_value_may_begin_with_a_minus(run: Run) -> None:
    done = run("write", "/param/speed_limit", "-0.5")
    assert done.returncode == 3
    assert "-0.5 < 0 m/s" in done.stderr


def test_a_value_that_is_not_json_is_a_mistake_of_usage(run: Run) -> None:
    done = run("write", "/param/speed_limit", "fast")
    assert done.returncode == 2
    assert (
        "'fast' is not valid JSON; /tenant/alpha/param/speed_limit accepts, for example, '1.0'"
        in (done.stderr)
    )
    assert run("write", "/param/speed_limit", "@/nowhere/at/all").returncode == 2


def test_execute_waits_for_the_end(run: Run) -> None:
    done = document(run("execute", "/action/move_to", NEAR))
    assert done["status"] == "completed"
    assert done["command"].startswith("cmd-")
    assert "error" in done["body"]
    steps = documents(run("execute", "/action/move_to", NEAR, "--feedback"))
    assert [step["status"] for step in steps][-1] == "completed"
    assert "in_progress" in {step["status"] for step in steps}
    shown = run("execute", "--text", "/action/move_to", NEAR).stdout.splitlines()
    assert shown[0].startswith("accepted cmd-")
    assert any(line.startswith("completed Command") for line in shown)


def test_a_command_is_left_running_listed_and_cancelled(run: Run) -> None:
    started = document(run("execute", "/action/move_to", FAR, "--no-wait"))
    assert started["status"] in ("accepted", "in_progress")
    (listed,) = documents(run("commands", "--running"))
    assert listed["command"] == started["command"]
    refused = run("execute", "/action/move_to", FAR)
    assert refused.returncode == 3
    assert "currently in progress; rejecting duplicate request" in refused.stderr
    cancelled = document(run("cancel", started["command"]))
    assert cancelled["body"] == {"cancelled": [started["command"]]}
    assert run("cancel", "cmd-of-nobody").returncode == 3
    end = time.monotonic() + BOUND
    while documents(run("commands", "--running")):  # the rover brakes first
        assert time.monotonic() < end
    table = run("commands", "--text").stdout.splitlines()
    assert table[0].startswith("COMMAND ")
    assert table[1].split()[:2] == [started["command"], "cancelled"]


def test_what_takes_too_long_has_failed(run: Run) -> None:
    done = run("execute", "/action/move_to", FAR, "--deadline", "0.2")
    assert done.returncode == 1
    assert "did not finish within 0.2 s" in done.stderr


def test_an_error_is_json_where_json_was_asked_for(run: Run) -> None:
    done = run("--json", "write", "/param/speed_limit", "9")
    assert done.returncode == 3
    assert json.loads(done.stderr)["error"]["code"] == "out_of_range"
    assert done.stdout == ""


def test_watch_prints_a_line_for_each_update(run: Run) -> None:
    found = documents(run("watch", "/sensor/pose", "--count", "5", "--rate", "50"))
    assert len(found) == 5
    assert found == sorted(found, key=lambda item: item["seq"])
    assert found[0]["body"]["frame_id"] == "map"
    reliable = documents(run("watch", "/sensor/pose", "--count", "9", "--reliable"))
    numbers = [item["seq"] for item in reliable]
    assert numbers == list(range(numbers[0], numbers[0] + 9))
    some = documents(
        run(
            *("watch", "/sensor/pose", "--field", "position.x", "--history", "3", "--count", "3"),
            *("--where", '{"field": "position.x", "lt": 100}'),
        )
    )
    assert [item["body"].keys() for item in some] == [{"position"}] * 3
    text = run("watch", "--text", "/param/*", "--duration", "0.2").stdout
    assert text.endswith(" 1.0\n")
    assert run("watch", "/sensor/pose", "--where", "[]").returncode == 2


def test_status_is_shown_whole_or_short(run: Run) -> None:
    report = document(run("status"))
    assert report["state"] == "ok"
    assert report["backends"][0]["name"] == "rover"
    lines = run("status", "--text").stdout.splitlines()
    assert lines[0].startswith("ok  version ")
    assert any(line.split()[:4] == ["rover", "sim", "alpha", "ready"] for line in lines)


def test_an_unknown_path_is_told_with_the_nearest(run: Run) -> None:
    for words in (("read", "/sensor/pos"), ("write", "/param/sped_limit", "1")):
        done = run(*words)
        assert done.returncode == 3
        meant = "sensor/pose" if words[0] == "read" else "param/speed_limit"
        assert f"Did you mean /tenant/alpha/{meant}" in done.stderr
    assert "Did you mean" not in run("read", "/sensor/nothing_of_the_kind").stderr


def test_the_estop_takes_anybody_to_make_and_some_to_release(run: Run) -> None:
    stopped = document(run("estop", "--reason", "a test"))
    assert stopped["active"]
    assert run("execute", "/action/dock").returncode == 3
    first, second, *_ = run("status", "--text").stdout.splitlines()
    assert first.startswith("E-stop latched: rover, by operator since 2")
    assert first.endswith(" (a test). To reset it: rcpctl estop --reset")
    assert second.startswith("ok  version ")
    denied = run("estop", "--reset")
    assert denied.returncode == 3
    assert "may not reset an e-stop" in denied.stderr
    shown = run("estop", "--reset", "--text", RCP_TOKEN=ADMIN).stdout
    assert shown == "E-stop reset. Nothing moves until a new command.\n"


def test_a_lease_is_acquired_for_all_that_the_principal_runs(run: Run) -> None:
    held = document(run("lease", "acquire", "/tenant/alpha", "--ttl", "60", "--reason", "a demo"))
    assert (held["holder"], held["session"]) == ("operator", None)
    assert document(run("lease", "list"))["reason"] == "a demo"
    assert run("write", "/param/speed_limit", "1.0").returncode == 0
    refused = run("write", "/param/speed_limit", "1.0", RCP_TOKEN=ADMIN)
    assert refused.returncode == 3
    assert "operator holds the lease" in refused.stderr
    shown = run("lease", "release", "/tenant/alpha", "--text").stdout
    assert shown == "/tenant/alpha is free.\n"
    assert run("lease", "list", "--text").stderr == "No leases.\n"


def test_robots_are_listed_and_searched(run: Run) -> None:
    (rover,) = documents(run("robots"))
    assert (rover["path"], rover["kind"], rover["state"]) == ("/tenant/alpha", "rover", "ready")
    assert document(run("robots", "ugv", "alpha"))["path"] == "/tenant/alpha"
    assert run("robots", "--text", "submarine").stderr == "No robots.\n"
    assert document(run("lease", "acquire", "/tenant/alpha", "--ttl", "60"))
    head, row = run("robots", "--text").stdout.splitlines()
    columns = ["ROBOT", "KIND", "STATE", "MODE", "BATTERY", "CONTROL", "PROFILES"]
    assert head.split() == columns
    assert row.split()[:3] == ["/tenant/alpha", "rover", "ready"]
    assert "operator (lease)" in row
    assert "mobile/1.1" in row
    assert run("lease", "release", "/tenant/alpha").returncode == 0


def test_a_lease_is_held_until_somebody_takes_it(url: str, run: Run) -> None:
    with subprocess.Popen(
        [BIN / "rcpctl", "lease", "hold", "/actuator", "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "RCP_URL": url, "RCP_TOKEN": OPERATOR},
    ) as holder:
        assert holder.stdout is not None
        assert holder.stderr is not None
        assert json.loads(holder.stdout.readline())["holder"] == "operator"
        taken = run("lease", "acquire", "/actuator", "--take", "--reason", "mine", RCP_TOKEN=ADMIN)
        assert taken.returncode == 0
        assert holder.wait(BOUND) == 3
        assert "mine (by admin)" in holder.stderr.read()
    assert run("lease", "release", "/actuator", RCP_TOKEN=ADMIN).returncode == 0


# -- the ends of a run ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (("read",), 2),
        (("nothing",), 2),
        (("watch", "/sensor/pose", "--rate", "0"), 2),
        (("--url", "ftp://here", "status"), 2),
        (("codegen", "--lang", "cobol"), 2),
        (("status", "--url", "http://127.0.0.1:1"), 4),
        (("--token", "of-nobody-at-all", "status"), 3),
        (("status", "--tenant", "gamma"), 3),
        (("write", "/param/speed_limit", "1", "--token", "of-nobody-at-all"), 3),
        (("--help",), 0),
        (("execute", "--help"), 0),
        (("--version",), 0),
    ],
)
def test_the_exit_status_says_how_it_went(run: Run, arguments: tuple[str, ...], code: int) -> None:
    done = run(*arguments)
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr


def test_options_stand_before_or_after_the_subcommand(run: Run, url: str) -> None:
    for arguments in (
        ("--url", url, "--token", OPERATOR, "read", "/param/speed_limit"),
        ("read", "/param/speed_limit", "--url", url, "--token", OPERATOR),
        ("--url", "http://127.0.0.1:1", "read", "--url", url, "/param/speed_limit"),
    ):
        assert document(run(*arguments, RCP_URL="http://127.0.0.1:2"))["body"] == 1.0


def test_every_subcommand_explains_itself(run: Run) -> None:
    listed = run("--help").stdout.partition("Commands:")[2].split("\n")
    names = [line.split()[0] for line in listed if line.startswith("  ") and line[2] != " "]
    assert "lease" in names
    for name in names:
        text = run(name, "--help").stdout
        if name == "completion":  # which asks nobody
            continue
        assert "--url" in text
        assert "--json" in text


def test_a_reader_that_has_had_enough_ends_the_watch(url: str) -> None:
    env = {**os.environ, "RCP_URL": url}
    with subprocess.Popen(
        [BIN / "rcpctl", "watch", "/sensor/pose"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=env,
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.readline()
        process.stdout.close()
        assert process.wait(BOUND) == 0
        assert process.stderr.read() == b""


@pytest.mark.anyio
async def test_a_watch_across_cuts_prints_every_sample_once(url: str) -> None:
    """The rover publishes 50 poses a second, of which 128 are kept for who is away."""
    async with asyncio.timeout(BOUND), Proxy(int(url.rpartition(":")[2])) as proxy:
        process = await asyncio.create_subprocess_exec(
            *(BIN / "rcpctl", "watch", "/sensor/pose", "--reliable", "--count", "100"),
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            env={**os.environ, "RCP_URL": proxy.url, "RCP_TOKEN": OPERATOR},
        )
        assert process.stdout is not None
        numbers: list[int] = []
        async for line in process.stdout:
            numbers.append(json.loads(line)["seq"])
            if len(numbers) % 25 == 0:
                proxy.cut()
        _, errors = await process.communicate()
        assert process.returncode == 0
    assert numbers == list(range(numbers[0], numbers[0] + 100))
    assert proxy.connections >= 4
    assert errors.count(b"reconnected") >= 3
    assert b"gap" not in errors


def test_the_demo_leaves_its_key_for_the_same_user() -> None:
    with subprocess.Popen(
        [BIN / "rcpd", "demo", "--port", "0"], stdout=subprocess.PIPE, text=True
    ) as demo:
        try:
            assert demo.stdout is not None
            banner = list(takewhile(lambda line: not line.startswith("Ready."), demo.stdout))
            where = next(line.split()[0].rstrip("/") for line in banner if "dashboard" in line)
            for path in ("/tenant/alpha/param/speed_limit", "/tenant/beta/param/speed_limit"):
                done = subprocess.run(
                    [BIN / "rcpctl", "--url", where, "write", path, "0.5"],
                    capture_output=True,
                    text=True,
                    timeout=BOUND,
                    check=False,
                )
                assert document(done)["body"] == 0.5
        finally:
            demo.terminate()
            demo.communicate(timeout=BOUND)
