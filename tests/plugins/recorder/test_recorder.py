"""Recordings have what happened, and are seen, started and stopped by whoever may."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncGenerator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import Any, ClassVar

import pytest
from mcap.reader import SeekingReader

import rcp_recorder
from configuration import backend, key, role, rule, table
from plugins.recorder.files import Line, lines, topics
from rcp_gateway.testing import FeatureSuite, MemoryClient, ScriptedRobot, scripted, serve
from rcp_gateway.testing._serve import Served
from rcp_kernel.errors import ConfigError
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host, RobotFacts
from rcp_kernel.types import quantity
from rcp_profiles.messages import BatteryState

pytestmark = pytest.mark.anyio
(KIND,) = rcp_recorder.rcp_features()
PATH = "/system/recorder"
NOTICES = "/tenant/alpha/notices"
BOUND = 60.0  # s
ADMIN, ALPHA, HALF, SECRET = (f"{n}-{n}-{n}-{n}" for n in ("admin", "alpha", "half", "secret"))
Speed = quantity("m/s", ge=-1, le=1)
Open = Callable[..., AbstractAsyncContextManager[Served]]


class TestRecorder(FeatureSuite):
    kind = KIND

    @pytest.fixture(autouse=True)
    def _folder(self, tmp_path: Path) -> None:
        type(self).options = {"folder": str(tmp_path), "paths": ["/tenant/**"], "black_box": {}}


def robot(host: Host) -> ScriptedRobot:
    host.describe(RobotFacts(kind="rover", vendor="Acme", serial="A-1"))
    made = ScriptedRobot(
        host,
        Resource(name="sensor/battery", description="The battery.", value=BatteryState),
        Resource(name="sensor/speed", description="The speed.", value=Speed),
        Resource(name="sensor/secret", description="What not all may read.", value=str),
        Resource(name="actuator/drive", description="The drive.", value=Speed, safe=0.0),
        Resource(name="param/limit", description="A limit.", value=Speed),
        Resource(name="action/go", description="Goes.", input=Speed),
    )
    made.release.set()
    return made


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "recordings"


@pytest.fixture
def gateway(folder: Path) -> Open:
    @asynccontextmanager
    async def opened(*tables: str, **options: Any) -> AsyncGenerator[Served]:
        config = "".join(
            (
                backend("rover", use="robot"),
                backend("other", "beta", use="second"),
                role(
                    "half",
                    rule("discover read subscribe", "/**"),
                    rule("discover read subscribe execute", PATH),
                    deny=[rule("read subscribe", "/sensor/secret")],
                ),
                key("admin", ADMIN, role="admin"),
                key("alfred", ALPHA, roles={"alpha": ["admin"]}),
                key("harry", HALF, roles={"alpha": ["half"]}),
                table("features.recorder", **{"folder": folder, "free_mb": 0, **options}),
                *tables,
            )
        )
        async with serve(
            config, scripted(robot, "robot"), scripted(robot, "second"), features=[KIND]
        ) as served:
            for supervisor in served.server.supervisors:
                await asyncio.wait_for(supervisor.settled.wait(), BOUND)
            yield served

    return opened


def robot_of(served: Served, kind: str = "robot") -> ScriptedRobot:
    (life,) = (life for life in served.lives if life.kind == kind)
    assert isinstance(life.backend, ScriptedRobot)
    return life.backend


async def recordings(client: MemoryClient) -> list[dict[str, Any]]:
    reply = await client.request("read", PATH)
    assert reply["status"] == "completed", reply
    return reply["body"]


async def until(client: MemoryClient, wanted: Callable[[list[dict[str, Any]]], object]) -> Any:
    """Read the list until it has what is wanted."""
    async with asyncio.timeout(BOUND):
        while not (found := wanted(await recordings(client))):  # noqa: ASYNC110 - a thread writes
            await asyncio.sleep(0.02)
    return found


async def do(client: MemoryClient, **body: Any) -> dict[str, Any]:
    return await client.request("execute", PATH, body=body)


def of(folder: Path, name: str, tenant: str = "alpha") -> list[Path]:
    return sorted(folder.glob(f"{name}.{tenant}.*.mcap"))


def values(found: list[Line], topic: str) -> list[Any]:
    return [line.value for line in found if line.topic == topic]


async def test_every_channel_has_what_happened(gateway: Open, folder: Path) -> None:
    async with gateway(paths=["/tenant/**"]) as served:
        made, admin = robot_of(served), served.client(ADMIN)
        made.measure("sensor/battery", BatteryState(percentage=0.5, voltage=24.0, current=None), 5)
        made.measure("sensor/speed", 0.25)
        path = "/tenant/alpha/param/limit"
        assert (await admin.request("write", path, body=0.5))["status"] == "completed"
        go = await admin.request("execute", "/tenant/alpha/action/go", body=0.75)
        assert go["status"] == "completed"
    found = lines(*of(folder, "always"))
    (battery,) = [line for line in found if line.topic == "/tenant/alpha/sensor/battery"]
    assert battery.value["percentage"] == 0.5
    assert battery.publish_time == 5
    assert battery.log_time > 10**18
    assert values(found, "/tenant/alpha/sensor/speed") == [0.25]
    (write,) = values(found, "/tenant/alpha/param/limit/events")
    assert (write["what"], write["value"], write["principal"]) == ("write", 0.5, "admin")
    steps = values(found, "/tenant/alpha/action/go/commands")
    assert (steps[0]["status"], steps[0]["input"]) == ("accepted", 0.75)
    assert steps[-1]["status"] == "completed"
    assert not of(folder, "always", "beta")


async def test_a_file_says_of_which_robot_and_software_it_is(gateway: Open, folder: Path) -> None:
    async with gateway(paths=["/tenant/**"]) as served:
        robot_of(served).measure("sensor/speed", 0.25)
    (file,) = of(folder, "always")
    with file.open("rb") as data:
        reader = SeekingReader(data)
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        summary = reader.get_summary()
    assert metadata["rcp"]["recording"] == "always"
    assert metadata["rcp"]["gateway"]
    assert metadata["rcp.robot"]["serial"] == "A-1"
    assert ADMIN not in file.read_bytes().decode("latin-1")
    assert summary is not None
    assert summary.chunk_indexes[0].compression == "zstd"
    schema = json.loads(next(iter(summary.schemas.values())).data)
    assert schema["unit"] == "m/s"


async def test_an_estop_is_recorded_and_the_recording_goes_on(gateway: Open, folder: Path) -> None:
    async with gateway(paths=["/tenant/**"]) as served:
        made, admin = robot_of(served), served.client(ADMIN)
        stop = await admin.request("execute", "/system/estop", body={"reason": "smoke"})
        assert stop["status"] == "completed", stop
        assert made.halts
        made.measure("sensor/speed", 0.5)
        body = {"reset": True}
        assert (await admin.request("execute", "/system/estop", body=body))["status"] == "completed"
    found = lines(*of(folder, "always"))
    stops = values(found, "/tenant/alpha/estops")
    assert [(one["reset"], one.get("reason")) for one in stops] == [(False, "smoke"), (True, None)]
    assert values(found, "/tenant/alpha/sensor/speed") == [0.5]


async def test_what_cannot_be_recorded_delays_no_stop_and_is_told(
    gateway: Open, folder: Path
) -> None:
    async with gateway(paths=["/tenant/**"], folder="/dev/null/recordings") as served:
        made, admin = robot_of(served), served.client(ADMIN)
        async with asyncio.timeout(BOUND):
            while True:
                status = (await admin.request("read", "/system/status"))["body"]
                if status["recorder"]["state"] == "stopped":
                    break
                await asyncio.sleep(0.02)
        assert status["recorder"]["detail"]
        assert status["state"] == "degraded"
        made.measure("sensor/speed", 0.5)
        assert (await admin.request("execute", "/system/estop", body={}))["status"] == "completed"
        assert made.halts


async def test_a_recording_on_request_has_what_its_principal_may_read(
    gateway: Open, folder: Path
) -> None:
    async with gateway() as served:
        made, harry = robot_of(served), served.client(HALF)
        reply = await do(harry, start={"name": "test", "paths": ["/tenant/*/sensor/**"]})
        assert reply["body"] == {"done": "started", "name": "test", "paths": 2}
        for number in range(3):
            made.measure("sensor/secret", f"{number}")
            made.measure("sensor/speed", number / 10)
            robot_of(served, "second").measure("sensor/speed", 1.0)
        assert (await do(harry, stop="test"))["status"] == "completed"
        (item,) = await until(harry, lambda found: [i for i in found if i["state"] == "kept"])
        assert item["paths"] == ["/tenant/alpha/sensor/speed"]
        assert "error" in await do(harry, stop="test")
    assert topics(*of(folder, "*", "*")) <= {"/tenant/alpha/sensor/speed", NOTICES}


async def test_what_does_not_change_is_recorded_at_the_start(gateway: Open, folder: Path) -> None:
    async with gateway() as served:
        made, admin = robot_of(served), served.client(ADMIN)
        made.measure("sensor/speed", 0.25)
        made.measure("param/limit", 0.5)
        entry = served.server.gateway.registry.entries["/tenant/alpha/param/limit"]
        assert entry.latest is not None
        entry.latest.received -= 100 * 10**9  # it was received long before the other
        await do(admin, start={"name": "test", "paths": ["/tenant/alpha/**"]})
        await do(admin, stop="test")
        await until(admin, lambda found: [i for i in found if i["state"] == "kept"])
        status = (await admin.request("read", "/system/status"))["body"]["recorder"]
        assert "clock_set_back" not in status
    (file,) = of(folder, "test")
    assert topics(file) - {NOTICES} == {"/tenant/alpha/sensor/speed", "/tenant/alpha/param/limit"}


async def test_nothing_readable_is_no_recording(gateway: Open) -> None:
    async with gateway() as served:
        harry = served.client(HALF)
        paths = ["/tenant/alpha/sensor/secret", "/tenant/beta/**"]
        reply = await do(harry, start={"name": "test", "paths": paths})
        assert reply["error"]["code"] == "forbidden"
        assert not await recordings(harry)


async def test_a_recording_is_hidden_from_whoever_may_not_read_all_of_it(gateway: Open) -> None:
    async with gateway(paths=["/tenant/*/sensor/**"]) as served:
        made = robot_of(served)
        admin, alfred, harry = (served.client(token) for token in (ADMIN, ALPHA, HALF))
        made.measure("sensor/speed", 0.1)
        made.measure("sensor/secret", "hidden")
        robot_of(served, "second").measure("sensor/speed", 0.1)
        all_of_it = {"/tenant/alpha/sensor/speed", "/tenant/alpha/sensor/secret"}
        await until(
            admin,
            lambda found: len(found) == 2 and any(all_of_it <= set(i["paths"]) for i in found),
        )
        assert [item["tenant"] for item in await recordings(alfred)] == ["alpha"]
        assert await recordings(harry) == []
        (file,) = [item["path"] for item in await recordings(alfred)]
        assert (await do(harry, pin=file))["error"]["code"] == "invalid_value"
        assert "error" in await do(harry, stop="always")


async def test_a_pinned_file_stays_pinned_after_a_restart(gateway: Open) -> None:
    async with gateway(paths=["/tenant/*/sensor/**"]) as served:
        robot_of(served).measure("sensor/speed", 0.1)
    async with gateway() as served:
        admin = served.client(ADMIN)
        (item,) = await until(admin, lambda found: found)
        assert (await do(admin, pin=item["path"]))["body"]["done"] == "pinned"
        await until(admin, lambda found: found[0].get("pinned"))
    async with gateway() as served:
        admin = served.client(ADMIN)
        await until(admin, lambda found: found and found[0].get("pinned"))
        await do(admin, unpin=item["path"])
        await until(admin, lambda found: not found[0].get("pinned"))


async def test_a_recording_ends_when_its_time_is_over(gateway: Open) -> None:
    async with gateway() as served:
        admin = served.client(ADMIN)
        await do(admin, start={"name": "short", "paths": ["/tenant/alpha/**"], "seconds": 0.1})
        robot_of(served).measure("sensor/speed", 0.1)
        (item,) = await until(admin, lambda found: [i for i in found if i["state"] == "kept"])
        assert item["name"] == "short"


@pytest.mark.parametrize(
    "body",
    [
        {},
        {"stop": "nothing"},
        {"start": {"name": "always", "paths": ["/tenant/**"]}},
        {"start": {"name": "../up", "paths": ["/tenant/**"]}},
        {"start": {"name": "a", "paths": ["nonsense"]}},
        {"start": {"name": "a", "paths": ["/tenant/**"]}, "stop": "a"},
        {"pin": "../../passwords"},
    ],
)
async def test_a_wrong_request_is_refused_and_says_what_to_do(
    gateway: Open, body: dict[str, Any]
) -> None:
    async with gateway() as served:
        reply = await served.client(ADMIN).request("execute", PATH, body=body)
        assert reply["error"]["remedy"], reply


async def test_what_mentions_another_path_is_cut(gateway: Open, folder: Path) -> None:
    async with gateway(paths=["/tenant/alpha/action/go"]) as served:
        made, admin = robot_of(served), served.client(ADMIN)

        async def tell(_value: Any, progress: Any) -> None:
            raise RuntimeError("/tenant/alpha/sensor/secret")

        made.behaviours["action/go"] = tell
        await admin.request("execute", "/tenant/alpha/action/go", body=0.5)
    steps = values(lines(*of(folder, "always")), "/tenant/alpha/action/go/commands")
    assert steps[-1]["status"] == "failed"
    assert b"secret" not in b"".join(json.dumps(step).encode() for step in steps)


async def test_leases_and_states_are_recorded_as_notices(gateway: Open, folder: Path) -> None:
    async with gateway(paths=["/tenant/*/actuator/**"]) as served:
        made, admin = robot_of(served), served.client(ADMIN)
        drive = {"scope": "/tenant/alpha/actuator/drive"}
        body = {"do": "acquire"} | drive
        lease = await admin.request("execute", "/system/leases", body=body)
        assert lease["status"] == "completed", lease
        await until(admin, lambda found: [i for i in found if i["messages"] >= 2])
        made.host.report("the battery is empty, see /tenant/alpha/sensor/secret")
        await until(admin, lambda found: [i for i in found if i["messages"] >= 3])
        await admin.request("execute", "/system/leases", body={"do": "release"} | drive)
    notices = values(lines(*of(folder, "always")), NOTICES)
    assert [(one["did"], one["scope"]) for one in notices if one["what"] == "lease"] == [
        ("acquire", drive["scope"]),
        ("release", drive["scope"]),
    ]
    states = [one for one in notices if one["what"] == "state"]
    assert [one["state"] for one in states] == ["ready", "degraded"]
    assert "message" not in states[-1]  # which mentions what is not recorded


async def test_a_recording_that_is_stopped_has_what_was_told_just_before(
    gateway: Open, folder: Path
) -> None:
    async with gateway() as served:
        admin = served.client(ADMIN)
        await do(admin, start={"name": "drive", "paths": ["/tenant/alpha/**"]})
        body = {"do": "acquire", "scope": "/tenant/alpha/actuator/drive"}
        lease = await admin.request("execute", "/system/leases", body=body)
        assert lease["status"] == "completed", lease
        await do(admin, stop="drive")
        await until(admin, lambda found: [i for i in found if i["state"] == "kept"])
    notices = values(lines(*of(folder, "drive")), NOTICES)
    assert [one["did"] for one in notices if one["what"] == "lease"] == ["acquire"]


async def test_a_recording_of_nothing_but_notices_is_its_tenants(
    gateway: Open, folder: Path
) -> None:
    async with gateway(paths=["/tenant/*/sensor/**"]) as served:
        admin, alfred = served.client(ADMIN), served.client(ALPHA)
        found = await until(admin, lambda found: len(found) == 2 and found)
        assert [item["tenant"] for item in await recordings(alfred)] == ["alpha"]
        (hidden,) = [item["path"] for item in found if item["tenant"] == "beta"]
        assert (await do(alfred, pin=hidden))["error"]["code"] == "invalid_value"


async def test_patterns_that_match_no_robot_are_refused(gateway: Open) -> None:
    with pytest.raises(ConfigError, match="matches no robot"):
        async with gateway(paths=["/sensor/**"]):
            pass


class TestBlackBox:
    BOX: ClassVar = {"seconds": 30, "after": 0.1, "paths": ["/tenant/**"]}

    async def test_an_estop_writes_what_was_before_and_what_follows(
        self, gateway: Open, folder: Path
    ) -> None:
        box = self.BOX | {"after": 0.6}  # long enough for what is told of the robot
        async with gateway(table("features.recorder.black_box", **box)) as served:
            made, admin = robot_of(served), served.client(ADMIN)
            for number in range(5):
                made.measure("sensor/speed", number / 10)
            body = {"reason": "smoke", "scope": "/tenant/alpha"}
            stop = await admin.request("execute", "/system/estop", body=body)
            assert stop["status"] == "completed", stop
            made.measure("sensor/speed", 0.9)
            (item,) = await until(admin, lambda found: [i for i in found if i["state"] == "kept"])
        assert item["name"] == "incident"
        assert item["robot"] == "/tenant/alpha"
        assert "smoke" in item["reason"]
        found = lines(*of(folder, "incident"))
        assert values(found, "/tenant/alpha/sensor/speed") == [0.0, 0.1, 0.2, 0.3, 0.4, 0.9]
        assert values(found, "/tenant/alpha/estops")[0]["reason"] == "smoke"
        assert not of(folder, "incident", "beta")
        # What is told of the robot as a whole is in it too, and where to look at it.
        notices = values(found, NOTICES)
        (begin,) = [one for one in notices if one["what"] == "incident"]
        assert (begin["robot"], "smoke" in begin["reason"]) == ("/tenant/alpha", True)
        held = [one["estop"] for one in notices if "estop" in one]
        assert held[0]["reason"] == "smoke"
        assert held[0]["by"] == "admin"
        assert [one["outcome"] for one in notices if one["what"] == "stop"] == ["confirmed"]
        assert item["start"] < item["at"] < item["end"]
        assert item["link"] == f"#/log?at={item['at']}&robot=/tenant/alpha"

    async def test_a_lost_link_is_an_incident(self, gateway: Open, folder: Path) -> None:
        async with gateway(table("features.recorder.black_box", **self.BOX)) as served:
            made, admin = robot_of(served), served.client(ADMIN)
            made.measure("sensor/speed", 0.3)
            made.host.report("no message received for 4.2 s", down=True)
            (item,) = await until(admin, lambda found: [i for i in found if i["state"] == "kept"])
        assert item["reason"].startswith("link lost")
        assert values(lines(*of(folder, "incident")), "/tenant/alpha/sensor/speed") == [0.3]

    async def test_memory_is_bounded_by_time_and_bytes(self, gateway: Open, folder: Path) -> None:
        box = self.BOX | {"mb": 0.005}
        async with gateway(table("features.recorder.black_box", **box)) as served:
            made, admin = robot_of(served), served.client(ADMIN)
            for number in range(100):
                made.measure("sensor/speed", number / 100)
            await admin.request("execute", "/system/estop", body={})
            await until(admin, lambda found: [i for i in found if i["state"] == "kept"])
        kept = values(lines(*of(folder, "incident")), "/tenant/alpha/sensor/speed")
        assert kept[-1] == 0.99
        assert 10 < len(kept) < 30
