"""Through a gateway: steps, resets, divergence, a thread that hangs, two commanders, cameras."""

from __future__ import annotations

import asyncio
import base64
import struct
import threading
import zlib
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

import rcp_mujoco
from backends.mujoco.physics import ELBOW, PUCK, model_of
from rcp_gateway.testing import Served, eventually, serve_backend
from rcp_gateway.testing._serve import ADMIN, OPERATOR
from rcp_kernel.values import value_type

pytestmark = pytest.mark.anyio
KIND = next(iter(rcp_mujoco.rcp_backends()))
FAR = {"position": {"x": 5.0, "y": 0.0}}


class Gateway:
    """A gateway around one robot, with an operator."""

    def __init__(self, served: Served) -> None:
        self.served = served
        self.operator = served.client(OPERATOR)
        self.admin = served.client(ADMIN)
        self.device: Any = served.life.backend.device  # type: ignore[attr-defined]
        self.backend: Any = served.life.backend
        self.simulation: Any = self.device.robot.simulation

    async def ask(self, type_: str, name: str, body: Any = None, **fields: Any) -> Any:
        return await self.operator.request(type_, f"/tenant/t/{name}", body=body, **fields)

    async def good(self, type_: str, name: str, body: Any = None, **fields: Any) -> Any:
        reply = await self.ask(type_, name, body, **fields)
        assert reply["status"] == "completed", reply
        return reply.get("body")

    async def begin(self, name: str, body: Any) -> str:
        path = f"/tenant/t/{name}"
        id_ = await self.operator.send(type="execute", path=path, body=body)
        assert (await self.operator.reply(id_))["status"] == "accepted"
        return id_

    async def step(self, steps: int = 1, **controls: float) -> Any:
        return await self.good("execute", "service/step", {"steps": steps, "controls": controls})

    async def estop(self, **body: Any) -> Any:
        return await self.admin.request("execute", "/system/estop", body=body, deadline=1.0)

    @property
    def state(self) -> tuple[str, str]:
        return self.served.supervisor.state, self.served.supervisor.detail or ""

    async def reports(self, state: str, text: str = "") -> None:
        async def told() -> bool:
            return self.state[0] == state and text in self.state[1]

        await eventually(told, f"{state}, {text}", 20.0)


@asynccontextmanager
async def gateway(model: str = "rover", **config: Any) -> AsyncGenerator[Gateway]:
    table = {"model": model, "paused": True, "cameras": False, **config}
    async with serve_backend(KIND, table) as served:
        await asyncio.wait_for(served.supervisor.settled.wait(), 60)
        yield Gateway(served)


# Dry runs


@pytest.mark.parametrize(
    ("position", "frame", "refused"),
    [
        ({"x": 3.5, "y": 3.0}, "map", "crate_1"),
        ({"x": 3.5, "y": 2.52}, "map", "crate_1"),
        ({"x": 6.0, "y": 1.0}, "map", "wall_east"),
        ({"x": 3.5, "y": 3.0}, "base_link", "crate_1"),
        ({"x": 3.5, "y": 2.3}, "map", None),
        ({"x": 5.7, "y": 0.0}, "map", None),
    ],
)
async def test_a_goal_in_a_wall_is_refused_dry_or_not(
    position: dict[str, float], frame: str, refused: str | None
) -> None:
    async with gateway(paused=False) as found:
        body = {"position": position, "frame": frame}
        dry = await found.ask("execute", "action/move_to", body, dry_run=True)
        if refused is None:
            assert dry["status"] == "completed", dry
            return
        real = await found.ask("execute", "action/move_to", body)
        assert refused in dry["error"]["message"]
        assert dry["error"]["code"] == real["error"]["code"]
        assert dry["error"]["message"] == real["error"]["message"]
        assert real["status"] in ("rejected", "failed")


async def test_what_is_out_of_reach_of_an_arm_is_refused_dry_or_not() -> None:
    async with gateway("arm", paused=False) as found:
        for name, body in (
            ("action/move_tool", {"position": {"x": 2.0, "y": 0.0, "z": 0.3}}),
            ("action/move_tool", {"position": {"x": 0.4, "y": 0.0, "z": 0.3}, "frame": "moon"}),
            ("action/move_joints", {"positions": {}}),
        ):
            dry = await found.ask("execute", name, body, dry_run=True)
            real = await found.ask("execute", name, body)
            assert dry["error"]["code"] == real["error"]["code"], (dry, real)
            assert dry["error"]["message"] == real["error"]["message"]
        near = {"position": {"x": 0.4, "y": 0.2, "z": 0.3}}
        dry = await found.ask("execute", "action/move_tool", near, dry_run=True)
        assert dry["status"] == "completed", dry


# Steps


async def test_a_controller_steps_the_robot_and_reads_what_it_needs() -> None:
    async with gateway() as robot:
        first = await robot.step()
        for _ in range(50):
            seen = await robot.step(5, left_wheel=4.0, right_wheel=4.0)
        assert seen["time"] == pytest.approx(first["time"] + 50 * 5 * 0.002)
        assert seen["sensors"]["sensor/pose"]["position"]["x"] > 0.1
        assert len(seen["sensors"]["sensor/scan"]["ranges"]) == 180
        again = await robot.good("read", "sensor/simulation")
        assert again["time"] == seen["time"]  # and then time stands still


async def test_steps_need_a_pause_and_known_actuators_within_their_bounds() -> None:
    async with gateway(paused=False) as robot:
        refused = await robot.ask("execute", "service/step", {"steps": 1})
        assert refused["error"]["code"] == "precondition_failed"
        await robot.good("write", "param/paused", body=True)
        beyond = {"steps": 1, "controls": {"left_wheel": 1000.0}}
        refused = await robot.ask("execute", "service/step", beyond)
        assert refused["error"]["code"] == "out_of_range"
        unknown = {"steps": 1, "controls": {"rudder": 0.0}}
        refused = await robot.ask("execute", "service/step", unknown)
        assert refused["error"]["code"] == "invalid_value"


async def test_steps_that_are_cancelled_end() -> None:
    async with gateway() as robot:
        many = await robot.begin("service/step", {"steps": 100_000})
        await robot.good("cancel", "service/step")
        assert (await robot.operator.final(many))["status"] == "cancelled"
        await robot.step()
        assert robot.simulation.time < 100_000 * 0.002


async def test_time_stamps_go_on_over_a_reset_and_stand_still_in_a_pause() -> None:
    async with gateway() as robot:
        before = (await robot.step(100))["sensors"]["sensor/pose"]["timestamp"]
        assert (await robot.good("read", "sensor/pose"))["timestamp"] == before
        reset = await robot.good("execute", "service/reset")
        assert (reset["time"], reset["resets"]) == (0.0, 1)
        after = (await robot.step(100))["sensors"]["sensor/pose"]["timestamp"]
        assert after > before


async def test_time_passes_as_fast_as_it_is_told_to() -> None:
    async with gateway(paused=False) as robot:
        await robot.good("write", "param/real_time_factor", body=10.0)

        async def fast() -> bool:
            return (await robot.good("read", "sensor/simulation"))["time"] > 5.0

        await eventually(fast, "5 s of simulation time", 60.0)


@pytest.mark.parametrize("name", ["service/step", "action/move_to"])
async def test_what_is_cancelled_while_it_begins_does_not_go_on(name: str) -> None:
    async with gateway() as robot:
        bodies = {"service/step": {"steps": 100_000}, "action/move_to": FAR}
        type_ = value_type(robot.served.life.host.resources[name].input)
        begun = threading.Event()

        def note(_: Any) -> None:
            begun.set()

        task = asyncio.create_task(
            robot.backend.execute(name, type_.convert(bodies[name]), lambda *_, **__: None)
        )
        await asyncio.sleep(0)  # its job is submitted
        robot.device.post(note)
        assert begun.wait(20)  # and done; the loop, which stood still, does not know yet
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        await robot.step()
        assert robot.simulation.time < 100.0
        assert robot.device.robot.busy is None


# Lapsing


async def test_a_command_lapses_in_simulation_time_whatever_the_clock_says() -> None:
    async with gateway(valid_for=0.5) as robot:
        body = {"linear": {"x": 0.5}}
        await robot.good("write", "actuator/cmd_vel", body, valid_for=600.0)
        await robot.step(240)
        assert robot.device.robot.wheels.target == (0.5, 0.0)  # 0.48 s later, none of them passed
        seen = await robot.operator.subscribe("/tenant/t/actuator/cmd_vel", initial=False)
        await robot.step(20)
        told = await robot.operator.update(seen)
        assert told["body"]["linear"]["x"] == 0.0
        assert robot.device.robot.wheels.target == (0.0, 0.0)


async def test_the_gateways_dead_man_stops_a_robot_whose_time_stands_still() -> None:
    async with gateway(valid_for=0.5) as robot:
        await robot.good("write", "actuator/cmd_vel", {"linear": {"x": 0.5}}, valid_for=0.05)

        async def stopped() -> bool:
            return robot.device.robot.wheels.target == (0.0, 0.0)

        await eventually(stopped, "the command has lapsed", 20.0)
        assert robot.simulation.time == 0.0


async def test_a_zero_ends_a_trip_that_has_replaced_a_velocity() -> None:
    async with gateway() as robot:
        await robot.good("write", "actuator/cmd_vel", {"linear": {"x": 0.5}}, valid_for=600.0)
        trip = await robot.begin("action/move_to", FAR)
        await robot.step(100)
        await robot.good("write", "actuator/cmd_vel", {})
        await robot.step(100)
        assert (await robot.operator.final(trip))["status"] == "failed"
        assert robot.device.robot.wheels.trip is None


async def test_the_dead_man_of_a_velocity_does_not_end_the_trip_that_replaced_it() -> None:
    async with gateway() as robot:
        await robot.good("write", "actuator/cmd_vel", {"linear": {"x": 0.5}}, valid_for=0.05)
        await robot.begin("action/move_to", FAR)

        async def lapsed() -> bool:
            value = await robot.good("read", "actuator/cmd_vel")
            return value["linear"]["x"] == 0.0

        await eventually(lapsed, "the velocity has lapsed", 20.0)
        await robot.step(100)
        assert robot.device.robot.wheels.trip is not None


async def test_a_zero_for_one_wheel_is_not_overridden() -> None:
    async with gateway() as robot:
        await robot.good("write", "actuator/cmd_vel", {"linear": {"x": 0.5}}, valid_for=600.0)
        await robot.step(50)
        await robot.good("write", "actuator/left_wheel", 0.0)
        await robot.step(200)
        assert await robot.good("read", "actuator/left_wheel") == 0.0
        assert abs(robot.device.robot.wheels.velocity[0]) < 0.01


async def test_a_cancellation_is_told_at_rest_however_seldom_the_robot_reports() -> None:
    async with gateway(paused=False, rate=1.0) as robot:
        trip = await robot.begin("action/move_to", FAR)

        async def drives() -> bool:
            return robot.device.robot.wheels.velocity[0] > 0.3

        await eventually(drives, "it drives", 20.0)
        await robot.ask("cancel", "action/move_to")
        assert (await robot.operator.final(trip))["status"] == "cancelled"
        assert abs(robot.device.robot.wheels.velocity[0]) < 0.02


async def test_a_simulation_that_cannot_keep_up_reports_in_wall_clock_time() -> None:
    async with gateway(paused=False, real_time_factor=1000.0, rate=10.0) as robot:
        before = robot.device.snapshot.number

        async def told() -> bool:
            state = await robot.good("read", "sensor/simulation")
            return 0.0 < state["real_time_factor"] < 900.0

        await eventually(told, "the factor that is achieved", 30.0)
        seconds = robot.simulation.elapsed
        assert robot.device.snapshot.number - before > seconds / 100.0 + 1


# Two commanders


async def test_of_two_commanders_the_second_is_told_that_the_robot_is_on_its_way() -> None:
    async with gateway() as robot:
        trip = await robot.begin("action/move_to", FAR)
        other = robot.served.client(ADMIN)
        refused = await other.request("execute", "/tenant/t/action/move_to", body=FAR)
        assert refused["error"]["code"] == "already_running"
        body = {"linear": {"x": -0.5}}
        refused = await other.request("write", "/tenant/t/actuator/cmd_vel", body=body)
        assert refused["error"]["code"] == "mode_forbids"
        refused = await other.request("write", "/tenant/t/actuator/left_wheel", body=2.0)
        assert refused["error"]["code"] == "mode_forbids"
        await robot.step(500)
        assert robot.device.robot.wheels.pose[0] > 0.3
        await robot.good("cancel", "action/move_to")
        assert (await robot.operator.final(trip))["status"] == "cancelled"


# Resets


async def test_a_reset_during_an_action_ends_it() -> None:
    async with gateway() as robot:
        trip = await robot.begin("action/move_to", FAR)
        await robot.step(500)
        await robot.good("execute", "service/reset")
        final = await robot.operator.final(trip)
        assert (final["status"], final["error"]["code"]) == ("failed", "device_rejected")
        assert "the simulation was reset" in final["message"]
        seen = await robot.step(100)
        assert abs(seen["sensors"]["sensor/pose"]["position"]["x"]) < 0.01


async def test_a_reset_of_the_system_leaves_the_robot_where_it_is() -> None:
    async with gateway(paused=False) as robot:
        await robot.good("execute", "action/move_to", {"position": {"x": 0.3, "y": 0.0}}, within=60)
        await robot.good("write", "param/speed_limit", body=0.2)
        await robot.good("execute", "service/reset_system")
        assert (await robot.good("read", "sensor/pose"))["position"]["x"] > 0.2
        odometry = await robot.good("read", "sensor/odometry")
        assert abs(odometry["pose"]["position"]["x"]) < 0.02
        assert await robot.good("read", "param/speed_limit") == 1.0


# Divergence


async def test_a_diverged_robot_is_degraded_and_not_at_rest_until_an_operator_resets_it() -> None:
    async with gateway(paused=False) as robot:
        trip = await robot.begin("action/move_to", FAR)
        robot.device.post(lambda robot: robot.simulation.data.qvel.fill(float("nan")))
        final = await robot.operator.final(trip)
        assert final["status"] == "failed"
        assert "not a number" in final["message"]
        await robot.reports("degraded", "not a number")
        stop = await robot.estop(reason="it diverged")
        assert (stop["status"], stop["error"]["code"]) == ("failed", "device_timeout")
        motion = robot.backend.motion(None)
        assert motion.at_rest is False
        assert "not a number" in motion.detail
        assert robot.simulation.resets == 0
        unread = await robot.ask("read", "sensor/pose", {"fresh": True})
        assert unread["error"]["code"] == "adapter_unavailable"
        assert robot.served.supervisor.faults == 0  # nothing that is not a number was published
        await robot.good("execute", "service/reset")
        await robot.reports("ready")

        async def confirmed() -> bool:
            state = await robot.admin.request("read", "/system/estop")
            return {r["state"] for r in state["body"]["robots"].values()} == {"confirmed"}

        await eventually(confirmed, "the stop is confirmed", 20.0)
        assert robot.simulation.braking
        assert (await robot.estop(reset=True))["status"] == "completed"


async def test_steps_into_a_divergence_fail_with_the_reason() -> None:
    async with gateway() as robot:
        robot.device.post(lambda robot: robot.simulation.data.qpos.fill(float("nan")))
        failed = await robot.ask("execute", "service/step", {"steps": 1000})
        assert failed["status"] == "failed"
        assert "not a number" in failed["message"]
        again = await robot.ask("execute", "service/step", {"steps": 1})
        assert again["error"]["code"] == "precondition_failed"


async def test_what_mujoco_warns_of_is_told(tmp_path: Path) -> None:
    heap = "".join(
        f'<body pos="0 0 {0.01 * n}"><freejoint/><geom size="0.1"/></body>' for n in range(30)
    )
    small = PUCK.replace("<worldbody>", '<size memory="200K"/><worldbody>' + heap)
    async with gateway(model_of(small, tmp_path)) as robot:
        await robot.ask("execute", "service/step", {"steps": 5})
        await robot.reports("degraded", "than fit in memory")


# Stops


async def test_a_robot_that_moves_while_paused_is_not_confirmed_at_rest() -> None:
    async with gateway() as robot:
        await robot.step(200, left_wheel=5.0, right_wheel=5.0)
        stop = await robot.estop(reason="test")
        assert stop["status"] == "failed"
        refused = await robot.ask("execute", "service/step", {"steps": 1})
        assert refused["error"]["code"] == "estop_active"
        await robot.good("write", "param/paused", body=False)

        async def rests() -> bool:
            return bool(robot.backend.motion(None).at_rest)

        await eventually(rests, "at rest", 20.0)


async def test_a_thread_that_hangs_is_told_and_what_was_sent_meanwhile_does_not_move_it() -> None:
    async with gateway(paused=False, stalled_after=0.3) as robot:
        hanging = threading.Event()
        robot.device.post(lambda _: hanging.wait(60))
        write = asyncio.create_task(robot.backend.write("actuator/left_wheel", 5.0))
        await robot.reports("down", "stood still")
        assert robot.backend.motion(None).at_rest is None
        stop = await robot.estop(reason="it hangs")
        assert stop["status"] == "failed"
        hanging.set()
        await asyncio.gather(write, return_exceptions=True)
        await robot.reports("ready")

        async def confirmed() -> bool:
            state = await robot.admin.request("read", "/system/estop")
            return {r["state"] for r in state["body"]["robots"].values()} == {"confirmed"}

        await eventually(confirmed, "the stop is confirmed", 20.0)
        assert robot.simulation.data.ctrl[0] == 0.0


# Opening


@pytest.mark.parametrize(
    ("content", "state"), [(None, "down"), ("<mujoco>", "failed"), ("\0\0\0", "failed")]
)
async def test_a_damaged_model_stops_the_backend_for_good_a_missing_one_until_it_is_there(
    content: str | None, state: str, tmp_path: Path
) -> None:
    file = tmp_path / "model.xml"
    if content is not None:
        file.write_text(content)
    async with serve_backend(KIND, {"model": str(file)}) as served:
        await asyncio.wait_for(served.supervisor.settled.wait(), 60)
        assert served.supervisor.state == state
        assert str(file) in (served.supervisor.detail or "")


async def test_any_model_is_a_robot(tmp_path: Path) -> None:
    async with gateway(model_of(ELBOW, tmp_path), actuate="position") as robot:
        await robot.good("write", "actuator/elbow", body=0.3)
        seen = await robot.step(1000)
        (position,) = seen["sensors"]["sensor/joint_states"]["position"]
        assert position == pytest.approx(0.3, abs=0.05)
        refused = await robot.ask("write", "actuator/elbow", body=0.6)
        assert refused["error"]["code"] == "out_of_range"


# Cameras


def pixels(image: dict[str, Any]) -> bytes:
    """Unpack a PNG of ours."""
    data = base64.b64decode(image["data"])
    at, body = 8, b""
    while at < len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        if data[at + 4 : at + 8] == b"IDAT":
            body += data[at + 8 : at + 8 + length]
        at += 12 + length
    raw, wide = zlib.decompress(body), 3 * image["width"] + 1
    return b"".join(raw[row * wide + 1 : (row + 1) * wide] for row in range(image["height"]))


def opengl_works() -> bool:
    import mujoco

    try:
        context = mujoco.GLContext(16, 16)
    except Exception:
        return False
    context.free()
    return True


async def test_a_camera_sees_the_crate_in_front_of_it() -> None:
    if not opengl_works():
        pytest.skip("there is no OpenGL here")
    async with gateway(cameras=True, camera_width=64, camera_height=48) as robot:

        async def declared() -> bool:
            return "sensor/camera" in robot.served.life.host.resources

        await eventually(declared, "the camera is declared", 30.0)
        image = await robot.good("read", "sensor/camera", deadline=30.0)
        assert (image["width"], image["height"], image["format"]) == (64, 48, "png")
        drawn = pixels(image)
        crate = [(r, g, b) for r, g, b in zip(*(iter(drawn),) * 3, strict=True) if b > r + 30]
        assert len(crate) > 10
        watching = await robot.operator.subscribe("/tenant/t/sensor/camera")
        await robot.operator.update(watching, 30.0)


async def test_without_opengl_there_is_no_camera_and_the_status_says_why(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import mujoco

    def fails(*_: Any, **__: Any) -> None:
        raise RuntimeError("no display")

    monkeypatch.setattr(mujoco, "Renderer", fails)
    async with gateway(cameras=True) as robot:
        await robot.reports("degraded", "OpenGL does not work here: no display")
        assert "sensor/camera" not in robot.served.life.host.resources
        missing = await robot.ask("read", "sensor/camera")
        assert missing["error"]["code"] == "unknown_path"
        await robot.step()  # and all else works


@pytest.mark.parametrize(("model", "kind"), [("rover", "rover"), ("arm", "arm")])
async def test_the_inventory_tells_what_it_is(model: str, kind: str) -> None:
    async with gateway(model) as gate:
        (listed,) = (await gate.operator.request("read", "/system/robots"))["body"]
        assert listed["kind"] == kind
