"""All motors of a backend: created from the configuration and ticked at their rates."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Generator, Iterable
from contextlib import ExitStack, contextmanager, suppress

import msgspec
import structlog

from rcp_can.axis import Axis
from rcp_can.bus import Bus
from rcp_can.config import CanConfig
from rcp_can.facts import Facts
from rcp_can.health import Health
from rcp_can.profiles import profile
from rcp_can.ticker import Ticker
from rcp_kernel.errors import ConfigError, DeviceTimeout
from rcp_kernel.spi import Host

__all__ = ["by_rate", "make_axes", "run_axes", "shared_modes", "simulated", "wait_for_motors"]

log = structlog.get_logger("rcp.can")
_LATE = 0.1  # s: a longer gap counts as this, so that no ramp jumps
_COARSE = 100.0  # Hz above which the event loop's own timers are too coarse
_BROKEN = "profile_failed"
_HEALTH = 1.0  # s between two reports of temperatures and supply


def make_axes(
    config: CanConfig, buses: dict[str, Bus], host: Host, health: Health, facts: Facts
) -> dict[str, Axis]:
    """Create the motors.

    :raises ConfigError: a motor's node or options do not fit its profile, or its id is taken.
    """
    axes: dict[str, Axis] = {}
    for name, motor in config.motors.items():
        try:
            kind = profile(motor.profile)
        except ConfigError as error:
            raise ConfigError(f"motors.{name}.profile: {error}") from error
        if motor.node not in kind.nodes:
            raise ConfigError(
                f"motors.{name}.node: {motor.profile} has nodes {kind.nodes.start} to "
                f"{kind.nodes.stop - 1}, not {motor.node}"
            )
        if kind.fd and not buses[motor.bus].config.fd:
            raise ConfigError(
                f"motors.{name}: {motor.profile} needs CAN FD; set buses.{motor.bus}.fd = true"
            )
        try:
            options = msgspec.convert(motor.options, kind.options)
            drive = kind.drive(motor.node, options, buses[motor.bus])
        except (msgspec.ValidationError, ValueError) as error:
            raise ConfigError(f"motors.{name}.options: {error}") from error
        drive.watchdog, drive.rate = motor.watchdog or None, motor.rate
        if motor.position and not drive.places:
            raise ConfigError(f"motors.{name}.position: {motor.profile} reports no position")
        if motor.gravity:
            if not drive.offsets:
                raise ConfigError(
                    f"motors.{name}.gravity: {motor.profile} takes no torque beside a position"
                )
            drive.torque_offset = 0.0
        axes[name] = Axis(name, motor, drive, buses[motor.bus], host, health, facts)
    _introduce(axes)
    return axes


def _introduce(axes: dict[str, Axis]) -> None:
    """Tell each drive which others on its bus have ids that it cannot have.

    :raises ConfigError: it has one of them.
    """
    kinds = {name: profile(axis.config.profile) for name, axis in axes.items()}
    places = {
        name: (axis.bus.name, kinds[name].family or kinds[name]) for name, axis in axes.items()
    }
    for name, axis in axes.items():
        family = kinds[name].family
        axis.drive.neighbours = {
            other.drive.node: each
            for each, other in axes.items()
            if each != name and places[each] == places[name]
        }
        if family and (other := axis.drive.neighbours.get(axis.drive.node)) is not None:
            raise ConfigError(
                f"motors.{name}.node: {axis.drive.node} is already used by {other}, whose drive "
                "takes the same set-points"
            )


def by_rate(axes: Iterable[Axis]) -> list[list[Axis]]:
    """Group the motors that tick at the same rate."""
    groups: dict[float, list[Axis]] = {}
    for axis in axes:
        groups.setdefault(axis.config.rate, []).append(axis)
    return list(groups.values())


def shared_modes(axis: Axis, axes: Iterable[Axis]) -> set[str]:
    """Return the modes of a motor in which others with its rate take set-points too.

    These are sent in the same cycle, so they can be written as one.
    """
    others = [one for one in axes if one is not axis and one.config.rate == axis.config.rate]
    return {mode for mode in axis.drive.modes if any(mode in one.drive.modes for one in others)}


async def run_axes(axes: list[Axis]) -> None:
    """Tick motors at their rate until cancelled."""
    rate = axes[0].config.rate
    if rate > _COARSE:
        ticker = Ticker(rate)
        with ticker.running():
            await _run(axes, ticker.beat)
    else:
        await _run(axes, _sleeper(1 / rate))


def _sleeper(period: float) -> Callable[[], Awaitable[None]]:
    due = time.monotonic()

    async def beat() -> None:
        nonlocal due
        due += period
        now = time.monotonic()
        if due < now - _LATE:
            due = now
        await asyncio.sleep(max(0.0, due - now))

    return beat


async def _run(axes: list[Axis], beat: Callable[[], Awaitable[None]]) -> None:
    last = time.monotonic()
    shown = float("-inf")
    while True:
        await beat()
        now = time.monotonic()
        dt, last = min(now - last, _LATE), now
        for axis in axes:
            _tick(axis, dt)
        if now - shown >= _HEALTH:
            shown = now
            for axis in axes:
                with suppress(Exception):  # what it has of its profile failed, which `_tick` tells
                    axis.show_health()


def _tick(axis: Axis, dt: float) -> None:
    """Tick one motor; an error of its profile stops that one, and no other."""
    try:
        axis.tick(dt)
    except Exception as error:
        told = axis.stop_broken()  # whatever else of it fails
        text = f"its profile failed: {error!r}"
        with suppress(Exception):
            if axis.faults.get(_BROKEN) is None:
                log.exception("profile_failed", motor=axis.name)
                axis.fault(_BROKEN, text)
        how = (
            "it was stopped"
            if told
            else "its stop could not be sent; use the robot's own emergency stop"
        )
        with suppress(Exception):
            axis.forget(DeviceTimeout(f"motor '{axis.name}': {text}, and {how}"))


async def wait_for_motors(axes: Iterable[Axis], grace: float, health: Health) -> None:
    """Wait up to `grace` s for the first message of each motor; report missing motors."""
    axes = list(axes)
    waiting = [asyncio.ensure_future(axis.first.wait()) for axis in axes]
    if waiting:
        await asyncio.wait(waiting, timeout=grace)
    for axis, waiter in zip(axes, waiting, strict=True):
        waiter.cancel()
        axis.show()
        axis.show_health()
        if not axis.met:
            health.report(
                axis.name, f"motor '{axis.name}' (node {axis.drive.node}) does not respond"
            )


@contextmanager
def simulated(config: CanConfig) -> Generator[None]:
    """Run a twin for each motor and each DroneCAN node on a bus with `simulate`."""
    import can

    from rcp_can.sim import Bench, make_twin

    with ExitStack() as stack:
        for name, bus in config.buses.items():
            motors = [motor for motor in config.motors.values() if motor.bus == name]
            driven = {motor.node for motor in motors if motor.profile == "dronecan"}
            nodes = [node for node in config.dronecan.values() if node.bus == name]
            if not bus.simulate or not (motors or nodes):
                continue
            twins = [make_twin(m.profile, m.node, **m.options) for m in motors]
            twins += [
                make_twin("dronecan", node.node, sensors=node.sensors)
                for node in nodes
                if node.node not in driven
            ]
            protocol = can.CanProtocol.CAN_FD if bus.fd else can.CanProtocol.CAN_20
            line = can.Bus(bus.channel, "virtual", ignore_config=True, protocol=protocol)
            stack.enter_context(Bench(line, twins))
        yield
