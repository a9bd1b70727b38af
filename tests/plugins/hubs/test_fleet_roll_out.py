"""The operator's end of a roll-out, when the hub or a reply is lost."""

from __future__ import annotations

import hashlib
import socket
from pathlib import Path
from typing import Any, cast

import pytest
from click.testing import CliRunner

from rcp_client import Client
from rcp_configuration.seal import SealKey
from rcp_configuration.service import ConfigurationState
from rcp_hubs.cli import fleet
from rcp_hubs.roll_out import RollOut, RollOutError
from rcp_kernel.errors import PreconditionFailed
from rcp_kernel.features.configuration import Phase

DATA = b"name = 'new'\n"
DIGEST = hashlib.sha256(DATA).hexdigest()


class _Robot:
    """What a client sees of a robot whose reply to the proposal was lost and that restarted."""

    def __init__(self, phase: Phase, since: str, proposed: str = DIGEST) -> None:
        key = SealKey().public
        self.states = [
            ConfigurationState(digest="", phase="rolled_back", proposed=DIGEST, since="1", key=key),
            ConfigurationState(digest="", phase=phase, proposed=proposed, since=since, key=key),
        ]
        self.confirmed = False

    async def read(self, *_: object, **__: object) -> ConfigurationState:
        return self.states.pop(0)

    async def execute(self, _path: str, body: dict[str, Any], **_: object) -> None:
        if "propose" in body:
            raise PreconditionFailed("the proposal is not sealed to this gateway's present key")
        assert body == {"confirm": DIGEST}
        self.confirmed = True


def _roll_out(robot: _Robot) -> RollOut:
    return RollOut(cast("Client", robot), DATA, seconds=60.0, restart=True, say=lambda _: None)


async def test_a_proposal_that_has_arrived_although_its_reply_was_lost_is_confirmed() -> None:
    robot = _Robot("probation", "2")
    await _roll_out(robot).run(["r7"])
    assert robot.confirmed


@pytest.mark.parametrize("robot", [_Robot("rolled_back", "1"), _Robot("probation", "2", "0" * 64)])
async def test_a_proposal_that_did_not_arrive_is_refused(robot: _Robot) -> None:
    with pytest.raises(RollOutError, match="not sealed to"):
        await _roll_out(robot).run(["r7"])
    assert not robot.confirmed


def test_a_hub_that_cannot_be_reached_is_named(tmp_path: Path) -> None:
    file = tmp_path / "new.toml"
    file.write_bytes(DATA)
    with socket.socket() as bound:  # and does not listen
        bound.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{bound.getsockname()[1]}"
        done = CliRunner().invoke(fleet, ["roll-out", str(file), "--robot", "r7", "--url", url])
    assert done.exit_code == 1
    assert "127.0.0.1" in done.output
    assert "None" not in done.output
