"""A configuration on probation in a running gateway, and what can go wrong meanwhile."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner
from structlog.testing import capture_logs

from configuration import configuration, key, table
from rcp_gateway.server import Server
from rcp_gateway.testing import ADMIN, eventually, serve
from rcp_kernel.config.file import parse
from rcp_kernel.contract.events import Event, EventHandler
from rcp_kernel.errors import InvalidValue, PreconditionFailed
from rcp_kernel.features.configuration import FileState
from rcpd.cli import main
from rcpd.configuration_file import ConfigurationFile
from rcpd.hidden import Hidden
from rcpd.probation import Probation
from rcpd.reload import reload

OLD = configuration(table("safety", guard_after=10.0))
NEW = OLD + key("admin", ADMIN)
RENAMED = 'name = "renamed"\n' + OLD


class _Gateway:
    """A running gateway with a file, which counts its restarts and keeps its records."""

    failing = False

    def __init__(self, server: Server, path: Path) -> None:
        self.path, self.server, self.restarts = path, server, 0
        self.records: list[Event] = []
        self.on_event: EventHandler = self._heard
        server.gateway.event_bus.listeners.append(self)
        self.file = ConfigurationFile(path)
        self.file.start()
        self.probation = Probation(server, self.file, self._restart)

    def _heard(self, event: Event) -> None:
        if event.what == "configuration":
            self.records.append(event)

    def missed_event(self, event: Event, error: Exception, /) -> None:
        raise error

    def _restart(self) -> None:
        self.restarts += 1

    def propose(self, text: str, *, seconds: float = 600.0, restart: bool = False) -> str:
        """Propose a file, and return its digest."""
        probation = self.probation
        state = probation.propose(text, by="ann", via="h1", seconds=seconds, restart=restart)
        return state.digest

    @property
    def keys(self) -> list[str]:
        return [one.name for one in self.server.gateway.settings.config.keys]

    async def is_in(self, phase: str) -> FileState:
        async def reached() -> bool:
            return self.probation.state.phase == phase

        await eventually(reached, phase, 60.0)
        return self.probation.state

    async def confirm(self, digest: str) -> None:
        async def confirmed() -> bool:
            try:
                self.probation.confirm(digest, via="h1")
            except PreconditionFailed:
                raise
            except Exception:
                return False
            return True

        await eventually(confirmed, "confirmed", 60.0)


@asynccontextmanager
async def _gateway(folder: Path) -> AsyncGenerator[_Gateway]:
    path = folder / "rcp.toml"
    path.write_text(OLD)
    async with serve(parse(OLD, "test")) as served:
        made = _Gateway(served.server, path)
        yield made
        made.probation.close()


async def test_a_plugin_whose_library_is_missing_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rcp_mavlink", None)
    async with _gateway(tmp_path) as gateway:
        text = OLD + '[[backends]]\nuse = "mavlink"\ntenant = "alpha"\n'
        with pytest.raises(InvalidValue, match="'mavlink' cannot be imported") as refused:
            gateway.propose(text)
        assert "pip install" in (refused.value.remedy or "")
        assert gateway.path.read_text() == OLD


@pytest.mark.parametrize(
    "table",
    [
        '[safety]\nguard_bound = "S3cr3t"',
        '[store]\npath = { x = "S3cr3t" }',
        '[[keys]]\nname = ["S3cr3t"]',
    ],
)
async def test_a_faulty_proposal_is_refused_with_the_place_but_without_the_value(
    tmp_path: Path, table: str
) -> None:
    async with _gateway(tmp_path) as gateway:
        with pytest.raises(InvalidValue) as refused:
            gateway.propose(configuration() + table)
        assert "S3cr3t" not in str(refused.value)
        assert table.split("\n")[1].partition(" ")[0] in str(refused.value)


FAULTY = OLD + "[limits]\nmesage = 3\nbatch = 0\n"


async def test_a_proposal_is_refused_in_the_words_of_the_check(tmp_path: Path) -> None:
    async with _gateway(tmp_path) as gateway:
        with pytest.raises(InvalidValue) as refused:
            gateway.propose(FAULTY)
        line = FAULTY[: FAULTY.index("mesage")].count("\n") + 1
        first = f"{gateway.path}:{line}: [limits] mesage: unknown key; did you mean `message`?"
        assert str(refused.value).startswith(first)
        assert str(refused.value).endswith("(1 more)")
        found = (refused.value.details or {})["faults"]
        assert [(one["line"], one["key"]) for one in found] == [
            (line, "mesage"),
            (line + 1, "batch"),
        ]


async def test_a_reload_is_refused_in_the_words_of_the_check(tmp_path: Path) -> None:
    async with _gateway(tmp_path) as gateway:
        gateway.path.write_text(FAULTY)
        with capture_logs() as logs:
            assert not await reload(gateway.server, gateway.path)
        (refused,) = [one for one in logs if one["event"] == "reload_refused"]
        assert ": [limits] mesage: unknown key; did you mean `message`?" in refused["reason"]
        assert refused["reason"].endswith(f"(1 more: `rcpd check {gateway.path}`)")


ZENOH = '[transports.zenoh]\ngateway = "r7"\ntenant = "alpha"\nconnect = ["{}"]\n'


@pytest.mark.parametrize("endpoint", ["${SECRET}", "tcp/user:${SECRET}", "tcp/${PORT}:${SECRET}/x"])
async def test_what_a_plugin_says_of_a_proposal_shows_nothing_of_the_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, endpoint: str
) -> None:
    monkeypatch.setenv("SECRET", "Hunter2-S3cr3t")
    monkeypatch.setenv("PORT", "7")
    async with _gateway(tmp_path) as gateway:
        with pytest.raises(InvalidValue, match=r"…|`rcpd check`") as refused:
            gateway.propose(OLD + ZENOH.format(endpoint), restart=True)
        assert not any(part in str(refused.value).lower() for part in ("hunter2", "s3cr3t"))


async def test_what_a_plugin_says_of_a_proposal_without_secrets_is_passed_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROBOT", "alpha")
    async with _gateway(tmp_path) as gateway:
        text = ZENOH.format("nonsense").replace('"alpha"', '"${ROBOT}"')
        with pytest.raises(InvalidValue, match="nonsense"):
            gateway.propose(OLD + text, restart=True)


@pytest.mark.parametrize(
    ("secret", "message", "outcome"),
    [
        ("mean", "did you mean `limits`?", "hidden"),
        ("ab", "about a table", "shown"),
        ("admin-did-you", "did you mean `limits`?", "shown"),
        ("admin-LIMITS-you", "did you mean `limits`?", "hidden"),
        ("admin-limit-you", "did you mean `limits`?", "shown"),
        ("long-Passw0rd", "'xlong-passw0rdx' is no endpoint", "hidden"),
        ("long-Passw0rd", "unexpected value in '\\npassw0rdx'", "hidden"),
    ],
)
def test_a_message_is_hidden_for_whole_words_of_a_secret_and_for_long_parts_of_one(
    secret: str, message: str, outcome: str
) -> None:
    hidden = Hidden(f'[[keys]]\nname = "admin"\nsecret = "{secret}"\n', [secret])
    reason = hidden.reason(message, "rcp.toml")
    assert reason == message if outcome == "shown" else "`rcpd check`" in reason


async def test_only_the_file_in_force_is_confirmed(tmp_path: Path) -> None:
    async with _gateway(tmp_path) as gateway:
        digest = gateway.propose(NEW)
        await gateway.confirm(digest)
        await gateway.confirm(digest)
        assert gateway.keys == ["admin"]
        gateway.path.write_text(OLD)
        with pytest.raises(PreconditionFailed, match="changed at the robot"):
            gateway.probation.confirm(digest, via="h1")


async def test_a_roll_back_that_fails_is_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rcpd.probation.RETRY", 0.05)
    async with _gateway(tmp_path) as gateway:
        gateway.propose(NEW, seconds=1.0)
        before, away = tmp_path / "rcp.toml.before", tmp_path / "away"
        before.rename(away)
        failures: list[str] = []
        roll_back = gateway.file.roll_back

        def fails(reason: str) -> bool:
            try:
                return roll_back(reason)
            except OSError:
                failures.append(reason)
                raise

        monkeypatch.setattr(gateway.file, "roll_back", fails)

        async def failed() -> bool:
            return bool(failures)

        await eventually(failed, "fails", 60.0)
        assert gateway.path.read_text() == NEW
        away.rename(before)
        await gateway.is_in("rolled_back")
        assert gateway.path.read_text() == OLD


async def test_a_file_that_is_edited_meanwhile_is_not_put_in_force(tmp_path: Path) -> None:
    async with _gateway(tmp_path) as gateway:
        gateway.propose(RENAMED, seconds=1.0, restart=True)
        gateway.path.write_text(NEW)
        state = await gateway.is_in("rolled_back")
        assert state.reason == "somebody changed the file at the robot"
        assert gateway.restarts == 1  # for the proposal
        assert gateway.path.read_text() == NEW


async def test_a_proposal_has_its_own_time_after_one_that_was_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GONE", ADMIN)
    async with _gateway(tmp_path) as gateway:
        gateway.propose(OLD + key("admin", "${GONE}"), seconds=1.5)
        monkeypatch.delenv("GONE")  # between check and reload
        state = await gateway.is_in("rolled_back")
        assert state.reason == "the gateway refused to reload it"
        gateway.propose(NEW, seconds=2.0)
        state = await gateway.is_in("rolled_back")
        assert state.reason == "it was not confirmed within 2 s"
        found = [(one.outcome, one.facts["by"], one.facts["via"]) for one in gateway.records]
        assert found == [("rolled_back", "ann", "h1")] * 2


async def test_a_file_that_cannot_be_applied_is_rolled_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def breaks(server: Server, path: Path) -> bool:
        raise RuntimeError("a bug")

    monkeypatch.setattr("rcpd.probation.reload", breaks)
    async with _gateway(tmp_path) as gateway:
        gateway.propose(NEW)
        await gateway.is_in("rolled_back")
        assert gateway.path.read_text() == OLD


async def test_a_file_is_checked_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checks: list[str] = []

    def counted(text: str, source: str, *, show_values: bool) -> object:
        checks.append(source)
        return parse(text, source, show_values=show_values)

    monkeypatch.setattr("rcpd.probation.parse", counted)
    async with _gateway(tmp_path) as gateway:
        gateway.propose(NEW)
        assert len(checks) == 1


async def test_a_folder_that_cannot_be_written_is_named_with_a_remedy(tmp_path: Path) -> None:
    async with _gateway(tmp_path) as gateway:
        blocked = tmp_path / "rcp.toml.before.new" / "x"
        blocked.mkdir(parents=True)
        with pytest.raises(PreconditionFailed, match="cannot be written") as refused:
            gateway.propose(NEW)
        assert "ReadWritePaths" in (refused.value.remedy or "")
        assert gateway.path.read_text() == OLD


@pytest.mark.parametrize("error", [RuntimeError("a bug"), SystemExit(1)])
async def test_a_file_with_which_the_gateway_cannot_start_is_rolled_back_and_on_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    async with _gateway(tmp_path) as gateway:
        gateway.propose(RENAMED, restart=True)

    def run(*_: object) -> None:
        raise error

    again: list[bool] = []
    monkeypatch.setattr("rcpd.serve.run", run)
    monkeypatch.setattr("rcpd.configuration_file.run_again", lambda: again.append(True))
    CliRunner().invoke(main, ["serve", str(gateway.path)])
    assert again
    assert gateway.path.read_text() == OLD
    for expected in (1, 0):
        async with serve(parse(OLD, "test")) as served:
            records = _Gateway(served.server, gateway.path).records
            assert len(records) == expected
        for one in records:
            assert one.facts["reason"] == "the gateway cannot start with it"
            assert (one.facts["by"], one.facts["via"]) == ("ann", "h1")


def test_a_restart_does_not_wait_for_a_thread_that_hangs(tmp_path: Path) -> None:
    program = (
        "import asyncio, sys, time, pathlib\n"
        "from functools import partial\n"
        "from rcpd.configuration_file import ConfigurationFile\n"
        "from rcpd.process import end_in_time\n"
        "from rcpd.serve import leave\n"
        "mark = pathlib.Path(sys.argv[1])\n"
        "if mark.exists(): sys.exit(5)\n"
        "mark.touch()\n"
        "file = ConfigurationFile(mark)\n"
        "file.restarts = True\n"
        "with asyncio.Runner() as runner:\n"
        "    runner.get_loop().run_in_executor(None, time.sleep, 300)\n"
        "    end_in_time(partial(leave, 0, file))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, tmp_path / "mark"], timeout=120, check=False
    )
    assert done.returncode == 5
