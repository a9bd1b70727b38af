"""Persons of a hub at a robot's gateway: each in a session of their own, by the robot's rules."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("zenoh")

from backends.fleet.rig import appears, hub_at, recorded, robot_at
from hubkeys import HubKey
from ports import free_port
from rcp_client.messages import Notice
from rcp_gateway.reload import apply
from rcp_gateway.server import prepare
from rcp_gateway.testing import (
    ADMIN,
    OPERATOR,
    VIEWER,
    MemoryClient,
    Served,
    SteppedClock,
    eventually,
    serve,
)
from rcp_kernel.clock import SYSTEM_CLOCK, Clock
from rcp_kernel.config.file import parse
from rcp_kernel.spi import Principal

pytestmark = pytest.mark.anyio
_BOUND = 60.0  # s, on any machine
_POSE, _LIMIT = "/tenant/alpha/sensor/r7/pose", "/tenant/alpha/param/r7/speed_limit"
_MOVE = "/tenant/alpha/action/r7/move_to"
_ROOT = f'[[keys]]\nname = "root"\nrole = "admin"\nkey = "{ADMIN}"\n'
_ANN = Principal("ann", (("alpha", ("operator",)),), "key")
_BEN = f'[[keys]]\nname = "ben"\nrole = "viewer"\nkey = "{VIEWER}"\n'


def _key_file(folder: Path, key: HubKey) -> Path:
    file = folder / "hub.key"
    file.write_text(key.private_pem)
    file.chmod(0o600)
    return file


def _hub(port: int, file: Path, more: str = "") -> str:
    text = hub_at(port).replace(f'token = "{OPERATOR}"', f'key = "{file}"\n{more}')
    return text.replace('name = "operator"', 'name = "ann"', 1) + _ROOT + _BEN


class _Fleet:
    def __init__(self, hub: Served, robot: Served, ann: MemoryClient) -> None:
        self.hub, self.robot, self.ann = hub, robot, ann

    def persons(self) -> set[str]:
        """Names of the sessions that the robot's gateway has with people of hubs."""
        known = self.robot.server.gateway.sessions.known.values()
        return {s.principal.name for s in known if s.principal.via is not None}


@asynccontextmanager
async def _fleet(
    tmp_path: Path,
    roles: str = '["operator"]',
    *,
    of_hub: str = "",
    clock: Clock = SYSTEM_CLOCK,
) -> AsyncGenerator[_Fleet]:
    key, port = HubKey(), free_port()
    hub_text = _hub(port, _key_file(tmp_path, key), of_hub)
    robot_text = robot_at(port) + _ROOT + key.table(roles)
    async with (
        serve(parse(hub_text, "test")) as hub,
        serve(parse(robot_text, "test"), clock=clock) as robot,
    ):
        ann = hub.client(OPERATOR)
        await appears(ann, _POSE)
        yield _Fleet(hub, robot, ann)
        await ann.close()


async def _record(robot: Served, **wanted: Any) -> dict[str, Any]:
    """Return the record of the robot's audit log that has these facts."""
    return await recorded(robot, lambda record: wanted.items() <= record.items())


async def test_a_person_acts_in_a_session_of_their_own_and_is_on_record(tmp_path: Path) -> None:
    async with _fleet(tmp_path) as fleet:
        assert fleet.persons() == {"h1"}
        done = await fleet.ann.request("write", _LIMIT, body=0.5)
        assert done["status"] == "completed", done
        assert fleet.persons() == {"h1", "ann"}
        found = await _record(fleet.robot, what="write", principal="ann")
        assert (found["via"], found["proof"], found["path"]) == (
            "h1",
            "hub h1",
            "/tenant/alpha/param/speed_limit",
        )


async def test_the_key_and_the_deadline_of_a_command_reach_the_robot(tmp_path: Path) -> None:
    async with _fleet(tmp_path) as fleet:
        done = await fleet.ann.request(
            "execute",
            _MOVE,
            body={"position": {"x": 0.2, "y": 0.0}},
            idempotency_key="go-once",
            deadline=55.0,
        )
        assert done["status"] == "completed", done
        found = await _record(fleet.robot, idempotency_key="go-once")
        assert found["principal"] == "ann"


async def test_a_refusal_of_the_robot_comes_back_as_it_is(tmp_path: Path) -> None:
    async with _fleet(tmp_path) as fleet:
        there = fleet.robot.client(OPERATOR)
        theirs = await there.request("write", "/tenant/alpha/param/speed_limit", body=99.0)
        ours = await fleet.ann.request("write", _LIMIT, body=99.0)
        assert theirs["error"]["code"] == "out_of_range", theirs
        for part in ("code", "message", "remedy", "details", "retryable"):
            assert ours["error"].get(part) == theirs["error"].get(part), part
        await there.close()


async def test_a_role_that_the_hub_may_not_assert_is_refused_and_on_record(tmp_path: Path) -> None:
    async with _fleet(tmp_path) as fleet:
        root = fleet.hub.client(ADMIN)
        reply = await root.request("write", _LIMIT, body=0.5)
        assert reply["error"]["code"] == "forbidden", reply
        text = "hub 'h1' may not assert the role admin for 'root'"
        assert reply["error"]["message"] == text
        await _record(fleet.robot, what="denial", message=text)
        assert "root" not in fleet.persons()
        await root.close()


async def test_a_hub_asserts_only_the_roles_it_is_told_to(tmp_path: Path) -> None:
    async with _fleet(tmp_path, of_hub='roles = ["operator"]') as fleet:
        root = fleet.hub.client(ADMIN)
        reply = await root.request("write", _LIMIT, body=0.5)
        assert reply["error"]["message"] == "the hub asserts no role of root to robots", reply
        await root.close()


async def test_the_hub_for_itself_only_looks(tmp_path: Path) -> None:
    async with _fleet(tmp_path) as fleet:
        id_ = await fleet.ann.subscribe(_POSE)
        await fleet.ann.update(id_)
        assert fleet.persons() == {"h1"}
        known = fleet.robot.server.gateway.sessions.known.values()
        own = next(s for s in known if s.principal.name == "h1")
        assert own.principal.roles == ("hub",)


async def test_an_idle_session_of_a_person_is_closed(tmp_path: Path) -> None:
    async with _fleet(tmp_path, of_hub="idle = 0.2") as fleet:
        assert (await fleet.ann.request("write", _LIMIT, body=0.5))["status"] == "completed"

        async def closed() -> bool:
            known = fleet.robot.server.gateway.sessions.known.values()
            return not [s for s in known if s.principal.name == "ann" and s.connection is not None]

        await eventually(closed, "ann's session is closed", _BOUND)
        assert (await fleet.ann.request("write", _LIMIT, body=0.6))["status"] == "completed"


async def test_a_session_is_renewed_before_its_assertion_expires(tmp_path: Path) -> None:
    stepped = SteppedClock()
    stepped.advance(38)  # for the robot, an assertion is that old when it is made
    async with _fleet(tmp_path, clock=stepped.clock) as fleet:
        known = fleet.robot.server.gateway.sessions.known
        own = next(s for s in known.values() if s.principal.name == "h1")
        first = own.principal.expires
        assert first is not None

        async def renewed() -> bool:
            now = own.principal.expires
            return own.id in known and now is not None and now > first

        await eventually(renewed, "another assertion came in the same session", _BOUND)


async def test_a_hub_taken_out_of_the_robots_configuration_loses_it_at_once(
    tmp_path: Path,
) -> None:
    key, other, port = HubKey(), HubKey("h2"), free_port()
    file = _key_file(tmp_path, key)
    robot_text = robot_at(port) + _ROOT
    async with (
        serve(parse(_hub(port, file), "test")) as hub,
        serve(parse(robot_text + key.table(), "test")) as robot,
    ):
        ann = hub.client(OPERATOR)
        await appears(ann, _POSE)
        assert (await ann.request("write", _LIMIT, body=0.5))["status"] == "completed"
        await apply(robot.server, prepare(parse(robot_text + other.table(), "test"), "test"))
        refused = await ann.request("write", _LIMIT, body=0.6, deadline=20.0)
        assert refused["status"] != "completed", refused

        async def shown() -> bool:
            return "hub 'h1' is not known" in str(hub.supervisor.unit("r7").detail)

        await eventually(shown, "the hub says that it is refused", _BOUND)
        await apply(robot.server, prepare(parse(robot_text + key.table(), "test"), "test"))

        async def works() -> bool:
            return (await ann.request("write", _LIMIT, body=0.7))["status"] == "completed"

        await eventually(works, "the hub is back by itself", _BOUND)
        await ann.close()


@pytest.mark.parametrize(
    ("mode", "text", "message"),
    [
        (0o644, None, "run `chmod 600"),
        (0o600, "nonsense", "is not an Ed25519 private key"),
        (0o600, "", "is not an Ed25519 private key"),
    ],
)
async def test_a_bad_key_file_is_one_clear_sentence(
    tmp_path: Path, mode: int, text: str | None, message: str
) -> None:
    file = _key_file(tmp_path, HubKey())
    if text is not None:
        file.write_text(text)
    file.chmod(mode)
    async with serve(parse(_hub(free_port(), file), "test")) as hub:

        async def shown() -> bool:
            return hub.supervisor.state == "failed" and message in str(hub.supervisor.detail)

        await eventually(shown, "the reason is in the status")


async def test_a_link_has_the_links_of_persons_too(tmp_path: Path) -> None:
    async with _fleet(tmp_path) as fleet:
        link: dict[str, Any] = {}

        async def told() -> bool:
            link.update((await fleet.ann.request("read", f"{_POSE[:-4]}link"))["body"])
            return "version" in link  # which the role `hub` may read

        await eventually(told, "the version is known", _BOUND)
        before = dict(link)
        done = await fleet.ann.request("write", _LIMIT, body=0.5)
        assert done["status"] == "completed", done
        await told()
        assert link["links"] == before["links"] + 1
        assert link["sent"] > before["sent"], "those of the hub's own link, and of hers"
        assert link["received"] > before["received"]
        (shown,) = (
            part["links"]
            for part in fleet.robot.server.gateway.status.transports
            if part.get("name") == "zenoh"
        )

        async def equal() -> bool:
            await told()
            robots_end = shown[0]["received"], shown[0]["sent"]
            return robots_end == (link["sent"], link["received"])

        await eventually(equal, "both ends have counted the same bytes on both links", _BOUND)


async def test_values_in_a_frame_come_in_the_session_of_the_person_who_wants_them(
    tmp_path: Path,
) -> None:
    async with _fleet(tmp_path) as fleet:  # the robot lets this hub assert operators only
        mine = await fleet.ann.subscribe(_POSE, frame="base_link")
        assert (await fleet.ann.update(mine, _BOUND))["body"]["frame_id"] == "base_link"
        assert fleet.persons() == {"h1", "ann"}
        ben = fleet.hub.client(VIEWER)
        theirs = await ben.subscribe(_POSE, frame="base_link")
        told = await ben.notice("no_transform", _BOUND)
        assert told["id"] == theirs
        assert "viewer" in told["message"], told
        plain = await ben.subscribe(_POSE)  # which the hub sees for itself, and shows to viewers
        assert (await ben.update(plain, _BOUND))["body"]["frame_id"] == "map"
        await ben.close()


def _sessions(hub: Served) -> Any:
    """Return those of a hub with the robot's gateway."""
    backend: Any = hub.supervisor.backend
    return backend.gateways["r7"].sessions


async def test_a_stream_in_a_frame_leaves_the_session_of_a_person_whom_the_robot_refuses(
    tmp_path: Path,
) -> None:
    key, port = HubKey(), free_port()
    trusting = parse(robot_at(port) + _ROOT + key.table(), "test")
    wary = parse(robot_at(port) + _ROOT + key.table('["viewer"]'), "test")
    async with serve(parse(_hub(port, _key_file(tmp_path, key)), "test")) as hub:
        ann = hub.client(OPERATOR)
        async with serve(trusting):
            await appears(ann, _POSE)
            id_ = await ann.subscribe(_POSE, frame="base_link")
            await ann.update(id_, _BOUND)
        sessions = _sessions(hub)
        (before,) = sessions.held
        async with serve(wary):
            await ann.until(lambda one: "assert the role" in str(one.get("message")), _BOUND)

            async def closed() -> bool:
                return before not in sessions.held

            await eventually(closed, "it does not try again and again", _BOUND)
        ann.inbox.clear()
        async with serve(trusting):
            assert (await ann.update(id_, _BOUND))["body"]["frame_id"] == "base_link"
        await ann.close()


async def test_a_session_that_is_refused_while_nobody_uses_it_is_closed_at_once(
    tmp_path: Path,
) -> None:
    async with _fleet(tmp_path, of_hub="idle = 3600") as fleet:
        sessions = _sessions(fleet.hub)
        async with sessions.acting(_ANN) as client:
            pass
        client.channel.tell(Notice(code="refused", message="not any more"))

        async def closed() -> bool:
            return not sessions.held

        await eventually(closed, "the session is closed", _BOUND)
        assert (await fleet.ann.request("write", _LIMIT, body=0.6))["status"] == "completed"


async def test_a_session_that_takes_no_new_users_is_closed_with_the_others(tmp_path: Path) -> None:
    async with _fleet(tmp_path) as fleet:
        sessions = _sessions(fleet.hub)
        async with sessions.acting(_ANN) as client:
            client.channel.tell(Notice(code="refused", message="not any more"))
            await sessions.close()
            assert not client.connected
            assert sessions.held == set()
