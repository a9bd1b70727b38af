"""A gateway that freezes or dies while a robot moves: the guard stops the robot, in real processes."""

from __future__ import annotations

import asyncio
import json
import os
import random
import signal
from typing import Any

import pytest

from plugins.guard.bench import SEEN, SOON, WITHIN, Bench, bench, by_udp, child, gone, lives
from timing import Load, in_one_of_three_attempts, in_time_under, measured_load

pytestmark = [pytest.mark.anyio, pytest.mark.paired]
FREEZES = ("SIGSTOP", "SIGKILL", "loop", "gil", "regex")


async def told(scene: Bench, how: str, by: str = "udp") -> tuple[float, Load]:
    """Freeze the gateway; return the seconds until the device was told to stop, and their load."""
    with measured_load() as load:
        at = await scene.freeze(how)
        seconds = await scene.stopped(by) - at
    print(f"{by}, {how}: told to stop after {seconds:.3f} s, {load.lost:.3f} s lost")  # noqa: T201 - the measured time
    return seconds, load


@pytest.mark.parametrize("how", FREEZES)
@in_one_of_three_attempts
async def test_a_gateway_that_stands_still_has_its_robot_stopped(how: str) -> None:
    async with bench(by_udp) as scene:
        await scene.guard()
        await scene.drive()
        seconds, load = await told(scene, how)
        in_time_under(load, seconds, WITHIN)
        if how == "SIGKILL":
            in_time_under(load, seconds, SEEN)  # the end of the process is seen at once


@in_one_of_three_attempts
async def test_stops_are_repeated_up_to_the_bound_and_the_guard_then_ends() -> None:
    async with bench(by_udp, "[safety]\nguard_bound = 1.5\n") as scene:
        pid = (await scene.guard())["pid"]
        await scene.drive()
        with measured_load() as load:
            await scene.freeze("SIGKILL")
            await gone(pid)
        times = [fact["at"] for fact in scene.stops()]
        span = times[-1] - times[0]
        assert len(times) <= 31  # every 50 ms for 1.5 s
        in_time_under(load, (31 - len(times)) * 0.05, 0.5)  # left out, or come later
        in_time_under(load, 1.5 - span, 0.2)
        in_time_under(load, span, 1.6)


@in_one_of_three_attempts
async def test_a_service_manager_that_ends_all_processes_still_gets_the_robot_stopped() -> None:
    async with bench(by_udp, "") as scene:
        pid = (await scene.guard())["pid"]
        await scene.drive()
        with measured_load() as load:
            await scene.freeze("SIGKILL")
            for number in (signal.SIGTERM, signal.SIGABRT, signal.SIGHUP, signal.SIGINT):
                os.kill(pid, number)
            await gone(pid)
        times = [fact["at"] for fact in scene.stops()]
        in_time_under(load, 1.0 - (times[-1] - times[0]), 0.2)
        in_time_under(load, times[-1] - times[0], 1.2)


async def test_signals_to_the_gateways_group_do_not_reach_the_guard() -> None:
    async with bench(by_udp) as scene:
        pid = (await scene.guard())["pid"]
        gateway = scene.gateway.process.pid
        assert os.getpgid(gateway) == os.getpgid(0)
        assert os.getsid(pid) == os.getpgid(pid) == pid
        assert os.getsid(pid) != os.getsid(gateway)


async def test_a_frozen_loop_under_a_latch_has_its_robot_kept_stopped() -> None:
    async with bench(by_udp) as scene:
        await scene.guard()
        await scene.drive()
        await scene.gateway.ask("reply", do="estop")
        await scene.device.until(lambda fact: fact.get("told") == "v 0")
        await scene.freeze("SIGSTOP")
        await scene.device.until(lambda fact: fact.get("told") == "STOP")


@in_one_of_three_attempts
async def test_a_loop_that_freezes_in_the_first_write_is_covered() -> None:
    async with bench(by_udp) as scene:
        await scene.guard()
        with measured_load() as load:
            scene.gateway.say(do="drive_and_hang")
            frozen = await scene.gateway.until(lambda fact: "frozen" in fact)
            await scene.device.until(lambda fact: fact.get("velocity") == 1.0)
            stopped = await scene.stopped()
        in_time_under(load, stopped - frozen["at"], WITHIN)


async def test_after_a_freeze_the_gateway_rests_the_robot_and_says_so() -> None:
    async with bench(by_udp) as scene:
        await scene.guard()
        scene.gateway.say(do="go")
        await scene.device.until(lambda fact: fact.get("velocity") == 0.5)
        scene.gateway.say(do="hang", how="loop 1.5")
        await scene.device.until(lambda fact: fact.get("told") == "STOP")
        ended = await scene.gateway.until(lambda fact: fact.get("status") == "cancelled")
        assert "the guard stopped the robot" in ended["error"]["message"]
        await scene.device.until(lambda fact: fact.get("told") == "v 0")
        facts = await scene.guard()
        assert facts["guard"]["stops"] == 1
        assert {"guard_stopped_robot", "loop_stood_still"} <= set(facts["warnings"])
        metrics = {name: float(text) for name, text in facts["metrics"]}
        assert metrics["rcp_guard_stops_total"] == 1.0
        assert metrics["rcp_event_loop_lag_max_seconds"] > 1.0
        await quiet(scene)
        await scene.drive(0.7)  # and it can be driven again
        await quiet(scene)


async def test_nothing_moves_the_robot_while_the_gateway_brings_it_to_rest_after_the_guard() -> (
    None
):
    async with bench(by_udp) as scene:
        await scene.guard()
        await scene.drive()
        scene.gateway.say(do="confirm", on=False)
        scene.gateway.say(do="hang", how="loop 1.5")
        await scene.device.until(lambda fact: fact.get("told") == "STOP")
        stopped = len(scene.device.facts)
        await scene.device.until(lambda fact: fact.get("told") == "v 0", stopped)
        while (code := await refusal(scene, 0.7)) == "stale_command":
            pass  # sent before the gateway came to, for all that it knows
        assert code == "already_running"
        scene.gateway.say(do="go")
        ended = await scene.gateway.until(lambda fact: (fact.get("path") or "").endswith("/go"))
        assert ended["error"]["code"] == "already_running"
        assert await refusal(scene, 0.0) is None  # what brings it to rest passes
        assert {fact["velocity"] for fact in scene.device.facts[stopped:]} == {0.0}
        scene.gateway.say(do="confirm", on=True)
        while (code := await refusal(scene, 0.7)) is not None:
            assert code == "already_running"
        await scene.device.until(lambda fact: fact.get("velocity") == 0.7)


async def refusal(scene: Bench, velocity: float) -> str | None:
    """Drive; return the code with which the gateway refused it, or None."""
    since = len(scene.gateway.facts)
    scene.gateway.say(do="drive", velocity=velocity)
    reply = await scene.gateway.until(lambda fact: fact.get("reply") == "write", since)
    return reply["error"] and reply["error"]["code"]


async def quiet(scene: Bench, seconds: float = 1.0) -> None:
    """See that the guard sends nothing, once it has let go."""
    async with asyncio.timeout(60):
        while True:
            before = len(scene.stops())
            await asyncio.sleep(seconds)
            if len(scene.stops()) == before:
                return


async def test_a_loop_that_is_only_late_triggers_nothing() -> None:
    # By 60 % of what the guard tolerates, of so many seconds that a busy machine adds no 40 %.
    async with bench(by_udp, "[safety]\nguard_after = 3.0\nguard_bound = 1.0\n") as scene:
        await scene.guard()
        await scene.drive()
        for _ in range(2):
            await scene.gateway.ask("frozen", do="hang", how="loop 1.8")
            await scene.gateway.ask("guard", do="guard")
        await asyncio.sleep(1.0)
        assert scene.stops() == []


async def test_nothing_is_sent_when_a_gateway_dies_that_moves_nothing() -> None:
    async with bench(by_udp) as scene:
        pid = (await scene.guard())["pid"]
        await scene.gateway.ask("reply", do="label")  # moves nothing
        await scene.freeze("SIGKILL")
        await gone(pid)
        assert scene.stops() == []


async def test_a_robot_that_came_to_rest_is_not_armed_any_more() -> None:
    async with bench(by_udp) as scene:
        pid = (await scene.guard())["pid"]
        await scene.drive()
        assert (await scene.guard())["guard"]["armed"]
        scene.gateway.say(do="drive", velocity=0.0)
        await scene.guard(armed=False)
        await scene.freeze("SIGKILL")
        await gone(pid)
        assert scene.stops() == []


async def test_a_gateway_that_closes_in_order_has_no_stop_sent() -> None:
    async with bench(by_udp) as scene:
        pid = (await scene.guard())["pid"]
        await scene.drive()
        scene.gateway.say(do="close")
        await scene.gateway.until(lambda fact: "closed" in fact)
        assert not lives(pid)
        assert scene.stops() == []
        assert scene.device.facts[-1]["velocity"] == 0.0  # by the gateway's own halt


@in_one_of_three_attempts
async def test_a_guard_that_dies_is_started_again_and_does_its_work() -> None:
    async with bench(by_udp) as scene:
        pid = (await scene.guard())["pid"]
        await scene.drive()
        os.kill(pid, signal.SIGKILL)
        facts = await scene.other_guard(pid)
        assert "guard_ended" in facts["warnings"]
        seconds, load = await told(scene, "SIGSTOP")
        in_time_under(load, seconds, WITHIN)


@in_one_of_three_attempts
async def test_a_guard_that_hangs_is_started_again() -> None:
    async with bench(by_udp) as scene:
        pid = (await scene.guard())["pid"]
        os.kill(pid, signal.SIGSTOP)
        await scene.other_guard(pid)
        assert not lives(pid)
        await scene.drive()
        seconds, load = await told(scene, "SIGSTOP")
        in_time_under(load, seconds, WITHIN)


@in_one_of_three_attempts
async def test_a_gateway_that_is_started_again_is_not_hindered_by_the_guard_of_the_one_before() -> (
    None
):
    async with bench(by_udp, "[safety]\nguard_bound = 60\n") as scene:
        first = (await scene.guard())["pid"]
        await scene.drive()
        await scene.freeze("SIGKILL")
        await scene.stopped()  # a busy machine may start the next gateway before the guard has run
        port = scene.device.facts[0]["port"]
        asked = {"plan": by_udp(port), "port": port, "more": SOON}
        async with child("gateway.py", json.dumps(asked)) as gateway:
            again = Bench(scene.device, gateway)
            await again.guard()
            await gone(first)
            times = [fact["at"] for fact in scene.stops()]
            assert len(times) > 3  # it was told again and again until the other was there
            await again.drive(0.9)
            await asyncio.sleep(0.5)
            assert len(scene.stops()) == len(times)
            with measured_load() as load:
                at = await again.freeze("SIGSTOP")
                since = scene.device.facts.index(scene.stops()[-1]) + 1
                stop = await scene.device.until(lambda fact: fact.get("told") == "STOP", since)
            in_time_under(load, stop["at"] - at, WITHIN)


async def test_a_plan_whose_sender_cannot_work_is_a_warning() -> None:
    def strange(_port: int) -> dict[str, Any]:
        data = {
            "domain_id": 0,
            "publishers": [{"topic": "/x", "type": "no_such/msg/T", "data": ""}],
        }
        return {"sender": "ros2", "data": data}

    async with bench(strange) as scene:
        facts = await scene.guard("degraded")
        (plan,) = facts["guard"]["plans"]
        assert plan["state"] == "missing"
        assert "no_such/msg/T" in plan["detail"]
        assert "guard_sender" in facts["warnings"]


async def test_without_a_plan_there_is_no_guard_and_watchdogs_are_told() -> None:
    async with bench(lambda _port: None) as scene:
        facts = await scene.guard("idle")
        assert facts["pid"] is None
        (watchdog,) = facts["guard"]["watchdogs"]
        assert (watchdog["backend"], watchdog["within"]) == ("cart", None)


async def test_it_can_be_switched_off() -> None:
    async with bench(by_udp, "[safety]\nguard = false\n") as scene:
        assert (await scene.guard("off"))["pid"] is None


@pytest.mark.parametrize("how", ["SIGSTOP", "SIGKILL"])
@in_one_of_three_attempts
async def test_can_frames_stop_a_device_on_a_bus(how: str) -> None:
    pytest.importorskip("can")
    group = f"239.{random.randrange(64, 128)}.{random.randrange(256)}.{random.randrange(1, 255)}"
    frames = [{"id": 0x123, "data": "0007", "extended": False, "fd": False, "brs": False}]
    plan = {
        "sender": "can",
        "data": {"bus": {"interface": "udp_multicast", "channel": group}, "frames": frames},
        "period": 0.05,
    }
    async with bench(lambda _port: plan, device=("can", group)) as scene:
        await scene.device.until(lambda fact: fact.get("by") == "can")
        await scene.guard()
        await scene.drive()
        seconds, load = await told(scene, how, "can")
        in_time_under(load, seconds, WITHIN)
