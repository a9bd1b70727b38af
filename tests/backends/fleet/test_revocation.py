"""A stolen key of a hub: revoked by a signed list, it is worth nothing within seconds."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

pytest.importorskip("zenoh")

from backends.fleet.rig import appears, hub_at, robot_at
from hubkeys import HubKey
from ports import free_port
from rcp_gateway.testing import ADMIN, OPERATOR, Served, eventually, serve
from rcp_hubs.cli import fleet
from rcp_hubs.revocation import REVOCATIONS, RevocationList, sign_list
from rcp_hubs.signer import read_private_key
from rcp_kernel.config.file import parse
from rcp_kernel.errors import Unauthenticated

pytestmark = pytest.mark.anyio
_BOUND = 60.0  # s, on any machine
_POSE, _LIMIT = "/tenant/alpha/sensor/r7/pose", "/tenant/alpha/param/r7/speed_limit"
_ROOT = f'[[keys]]\nname = "root"\nrole = "admin"\nkey = "{ADMIN}"\n'


def _rcpd(*arguments: object, code: int = 0) -> str:
    result = CliRunner().invoke(fleet, [str(one) for one in arguments])
    assert result.exit_code == code, result.output
    return result.output


def _robot(port: int, hub: HubKey, tmp_path: Path) -> str:
    text = robot_at(port) + _ROOT + hub.table() + f'[store]\npath = "{tmp_path / "robot.db"}"\n'
    return text.replace("\ngateway", f'\nfleet_key = "{tmp_path / "fleet.key.pub"}"\ngateway', 1)


def _refusal(robot: Served, hub: HubKey) -> str:
    try:
        robot.server.client_api.authenticate(hub.assertion())
    except Unauthenticated as error:
        return error.message
    return ""


async def test_a_revoked_hub_loses_its_sessions_and_gets_no_others(tmp_path: Path) -> None:
    hub, port, listed = HubKey(), free_port(), tmp_path / "revoked.jwt"
    secret, public = tmp_path / "hub.key", tmp_path / "hub.pub"
    secret.write_text(hub.private_pem)
    secret.chmod(0o600)
    public.write_text(hub.pem)
    _rcpd("key", tmp_path / "fleet.key")
    keys = f'key = "{secret}"\nrevoked = "{listed}"'
    hub_text = hub_at(port).replace(f'token = "{OPERATOR}"', keys)
    robot_text = _robot(port, hub, tmp_path)
    async with (
        serve(parse(hub_text, "test")) as served,
        serve(parse(robot_text, "test")) as robot,
    ):
        ann = served.client(OPERATOR)
        await appears(ann, _POSE)
        assert (await ann.request("write", _LIMIT, body=0.5))["status"] == "completed"
        admin = robot.client(ADMIN)
        records = await admin.subscribe("/system/audit", history=100)

        _rcpd("revoke", "--key", tmp_path / "fleet.key", "--list", listed, public)

        record = await admin.until(
            lambda m: m.get("id") == records and m.get("body", {}).get("what") == "revocation",
            _BOUND,
        )
        assert record["body"]["hubs"] == ["h1"]

        async def gone() -> bool:
            known = robot.server.gateway.sessions.known.values()
            return not [one for one in known if one.principal.via == "h1"]

        await eventually(gone, "the hub's sessions have ended", _BOUND)
        assert _refusal(robot, hub) == "the key of hub 'h1' was revoked"
        await ann.close()
        await admin.close()
    async with serve(parse(robot_text, "test")) as robot:
        assert _refusal(robot, hub) == "the key of hub 'h1' was revoked"


async def test_only_newer_lists_of_the_fleet_count(tmp_path: Path) -> None:
    hub = HubKey()
    _rcpd("key", tmp_path / "fleet.key")
    _rcpd("key", tmp_path / "other.key")
    private = read_private_key(str(tmp_path / "fleet.key"), "key")
    public = tmp_path / "hub.pub"
    public.write_text(hub.pem)
    forged = tmp_path / "forged.jwt"
    _rcpd("revoke", "--key", tmp_path / "other.key", "--list", forged, public)
    async with serve(parse(_robot(free_port(), hub, tmp_path), "test")) as robot:
        take = robot.server.client_api.service(REVOCATIONS)
        assert take is not None
        for data in (forged.read_bytes(), b"", b"nonsense", hub.assertion().encode()):
            take(data)
        assert _refusal(robot, hub) == ""
        take(sign_list(RevocationList(number=5), private).encode())
        older = tmp_path / "older.jwt"
        _rcpd("revoke", "--key", tmp_path / "fleet.key", "--list", older, public)
        take(older.read_bytes())
        assert _refusal(robot, hub) == ""


def test_a_list_of_another_fleet_is_not_continued(tmp_path: Path) -> None:
    public = tmp_path / "hub.pub"
    public.write_text(HubKey().pem)
    for name in ("fleet.key", "other.key"):
        _rcpd("key", tmp_path / name)
    listed = tmp_path / "revoked.jwt"
    _rcpd("revoke", "--key", tmp_path / "fleet.key", "--list", listed, public)
    said = _rcpd("revoke", "--key", tmp_path / "other.key", "--list", listed, public, code=1)
    assert "not signed by the fleet" in said
    assert "cannot be written" in _rcpd("key", tmp_path / "fleet.key", code=1)
