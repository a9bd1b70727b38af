"""One DroneCAN node: its state, what it is, its sensors, parameters and restart."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Any

from msgspec import Meta, Struct

from rcp_can.axis import Axis
from rcp_can.binding import Part
from rcp_can.bus import Bus
from rcp_can.config_dronecan import DronecanConfig
from rcp_can.dronecan.identity import read_info, version_of
from rcp_can.dronecan.library import make, text_of
from rcp_can.dronecan.node_status import (
    HEALTH,
    MODES,
    OFFLINE,
    Healthy,
    NodeMode,
    Uptime,
    health_fault,
)
from rcp_can.dronecan.parameters import Parameter, Parameters, parameter_type
from rcp_can.dronecan.port import NODE_STATUS, Port
from rcp_can.dronecan.sensors import SENSORS
from rcp_can.dronecan.transfers import Assembler, message_route
from rcp_can.health import Health
from rcp_kernel.errors import (
    AdapterUnavailable,
    DeviceRejected,
    DeviceTimeout,
    ModeForbids,
    RcpError,
)
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host, Progress, check_fence
from rcp_profiles import claim
from rcp_protocol.timeouts import timeout

if TYPE_CHECKING:
    import can

__all__ = ["DronecanPart", "NodeInfo", "NodeState", "Restarted"]

_MAGIC = 0xACCE551B1E  # of a request to restart
_OPCODES = {"save_parameters": 0, "reset_parameters": 1}
_REBOOT = 15.0  # s a node may need until it is back
_SERVICE = 20.0  # s a service may take
_AGAIN = 5.0  # s between two attempts to list the parameters
_NOT_IN_A_PATH = re.compile(r"[^A-Za-z0-9_.-]")

Seconds = Annotated[int, Meta(ge=0, extra_json_schema={"unit": "s"})]
Code = Annotated[int, Meta(ge=0, le=0xFFFF, extra_json_schema={"unit": "1"})]


class NodeState(Struct, frozen=True, kw_only=True):
    """What the node reports of itself each second."""

    mode: NodeMode
    """`offline`: no report for 3 s, or it said so; `unknown`: no report yet."""
    health: Healthy | None = None
    uptime: Seconds | None = None
    code: Code | None = None
    """A number of its vendor."""


class NodeInfo(Struct, frozen=True, kw_only=True):
    """What the node is."""

    name: str
    firmware: str
    """Version, and the commit if it tells it."""
    hardware: str
    serial: str
    """Its unique number, hexadecimal."""


class Restarted(Struct, frozen=True, kw_only=True):
    """The node has restarted: its uptime began anew."""

    uptime: Seconds
    before: Seconds


Declares = Callable[[Part, Sequence[Resource], Sequence[str]], None]
"""Declares more resources of a part at run time, and withdraws others by name."""


class DronecanPart(Part):
    """The resources of one node."""

    def __init__(
        self,
        name: str,
        config: DronecanConfig,
        bus: Bus,
        host: Host,
        health: Health,
        axes: Sequence[Axis],
    ) -> None:
        """`axes` are the motors that this node drives."""
        self._name, self._config, self._host, self._health = name, config, host, health
        self._axes = axes
        self._bus, self._uptime = bus, Uptime()
        self._port = bus.shared(Port, Port)
        self._parameters = Parameters(self._port, config.node)
        self._listed: dict[str, Parameter] = {}
        self._state, self._info = NodeState(mode="unknown"), f"sensor/{name}/info"
        self._path = f"sensor/{name}/state"
        place = "" if config.as_robot else f"{name}/"
        self._sensors = {
            SENSORS[each].type_id: (SENSORS[each].name.replace("/", f"/{place}", 1), SENSORS[each])
            for each in config.sensors
        }
        self._declare: Declares = _nowhere
        self._missing: asyncio.TimerHandle | None = None
        self._asking: asyncio.Task[None] | None = None
        self._back = asyncio.Event()
        self._assembler = Assembler((NODE_STATUS, *self._sensors))
        types = (NODE_STATUS, *self._sensors)
        routes = (message_route(each, config.node) for each in types)
        bus.listen(self._take, *routes, whose=name)

    def start(self, declare: Declares) -> None:
        """Begin to expect its reports."""
        self._declare = declare
        self._expect()

    async def close(self) -> None:
        """Expect nothing any longer."""
        if self._missing is not None:
            self._missing.cancel()
        if self._asking is not None:
            self._asking.cancel()
            await asyncio.wait((self._asking,))

    def resources(self) -> list[Resource]:
        """List what any node has, and its sensors."""
        name, node = self._name, self._config.node
        meta = {"bus": self._config.bus, "node": node}
        own = [
            Resource(
                name=self._path,
                description=f"Mode, health and uptime of DroneCAN node {node}.",
                value=NodeState,
                live=True,
                deadline=OFFLINE,
                meta=meta,
            ),
            Resource(
                name=self._info,
                description=f"Name, versions and serial number of DroneCAN node {node}.",
                value=NodeInfo,
                live=True,
                meta=meta,
            ),
            Resource(
                name=f"event/{name}/restarted",
                description=f"DroneCAN node {node} has restarted.",
                value=Restarted,
                live=True,
            ),
            self._service("restart", "Restart the node; completes when it is back."),
        ]
        if self._config.parameters:
            own += [
                self._service("save_parameters", "Let the node store its parameters."),
                self._service("reset_parameters", "Let the node take the defaults of all."),
            ]
        return [*own, *self._sensor_resources()]

    def _service(self, verb: str, text: str) -> Resource:
        return Resource(
            name=f"service/{self._name}/{verb}",
            description=f"DroneCAN node '{self._name}': {text}",
            timeout=_SERVICE,
        )

    def _sensor_resources(self) -> list[Resource]:
        kinds = [kind for _, kind in self._sensors.values()]
        if not kinds:
            return []
        profiles = list(dict.fromkeys(each for kind in kinds for each in kind.profiles))
        made = [
            Resource(
                name=kind.name,
                description=kind.description,
                value=kind.value,
                live=True,
                deadline=kind.deadline,
                meta={"bus": self._config.bus, "node": self._config.node},
            )
            for kind in kinds
        ]
        return claim(profiles, *made, place=None if self._config.as_robot else self._name)

    # Reports

    def _take(self, message: can.Message) -> None:
        received = self._assembler.take(message)
        if received is None:
            return
        if received.type_id == NODE_STATUS:
            self._take_state(received.payload, self._bus.received_at(message))
            return
        path, kind = self._sensors[received.type_id]
        if kind.name == SENSORS["battery"].name and not self._is_own_battery(received.payload):
            return
        stamp = int(message.timestamp * 1e9) or None
        self._host.publish(path, kind.convert(received.payload), stamp)

    def _is_own_battery(self, payload: Any) -> bool:
        return self._config.battery_id in (None, payload.battery_id)

    def _take_state(self, state: Any, at: float) -> None:
        before, self._state = self._state, _state_of(state)
        was, uptime = self._uptime.last, state.uptime_sec
        restarted = self._uptime.has_restarted(uptime, at)
        if restarted and was is not None:
            event = Restarted(uptime=uptime, before=was)
            self._host.publish(f"event/{self._name}/restarted", event)
            self._back.set()
        self._host.publish(self._path, self._state)
        fault = health_fault(state.health, state.vendor_specific_status_code)
        self._complain(None if fault is None else fault.text)
        if self._state.mode == "offline":  # it says that it leaves
            self._lose()
            return
        self._expect()
        if restarted or before.mode in ("unknown", "offline"):
            self._ask()

    def _expect(self) -> None:
        if self._missing is not None:
            self._missing.cancel()
        self._missing = asyncio.get_running_loop().call_later(OFFLINE, self._lose)

    def _lose(self) -> None:
        self._state = NodeState(mode="offline", uptime=self._state.uptime)
        self._host.publish(self._path, self._state)
        self._complain("has sent no report of its state for 3 s")

    def _complain(self, text: str | None) -> None:
        whole = f"DroneCAN node {self._config.node} ('{self._name}'): {text}"
        self._health.report(f"dronecan {self._name}", None if text is None else whole)

    # What it is, and its parameters

    def _ask(self) -> None:
        if self._asking is not None:
            self._asking.cancel()
        self._asking = asyncio.create_task(self._learn(), name=f"can {self._name}")

    async def _learn(self) -> None:
        """Ask what the node is and has, again until it answers."""
        while True:
            with suppress(RcpError):
                self._host.publish(self._info, await self._read_info())
                if self._config.parameters:
                    self._list(await self._parameters.list())
                return
            await asyncio.sleep(_AGAIN)

    async def _read_info(self) -> NodeInfo:
        info = await read_info(self._port, self._config.node)
        hardware = info.hardware_version
        return NodeInfo(
            name=text_of(info.name),
            firmware=version_of(info.software_version),
            hardware=f"{hardware.major}.{hardware.minor}",
            serial=bytes(hardware.unique_id).hex(),
        )

    def _list(self, parameters: list[Parameter]) -> None:
        paths = {
            f"param/{self._name}/{_NOT_IN_A_PATH.sub('_', each.name)}": each for each in parameters
        }
        gone = [path for path in self._listed if path not in paths]
        self._listed = paths
        resources = [
            Resource(
                name=path,
                description=f"Parameter {each.name} of DroneCAN node '{self._name}'.",
                value=parameter_type(each),
                meta={"parameter": each.name, "default": each.default},
            )
            for path, each in paths.items()
        ]
        self._declare(self, resources, gone)

    # Operations

    async def read(self, name: str) -> Any:
        """Ask the node; its state is the last one that it has sent."""
        if name == self._path:
            return self._state
        if name == self._info:
            self._check_link()
            return await self._read_info()
        if name in self._listed:
            self._check_link()
            return await self._parameters.read(self._listed[name].name)
        return await super().read(name)

    async def write(self, name: str, value: Any) -> Any:
        """Write a parameter; return the value that the node has afterwards."""
        parameter = self._listed[name]
        taken = await self._parameters.write(
            parameter.name, parameter.kind, value, self._check_allowed
        )
        self._host.publish(name, taken)
        return taken

    def foresee(self, name: str, value: Any) -> None:
        """Refuse what `execute` would refuse now."""
        self._check_idle()

    async def execute(self, name: str, value: Any, progress: Progress) -> None:
        """Restart the node, or let it store or reset its parameters."""
        verb = name.rpartition("/")[2]
        if verb == "restart":
            self._check_allowed()
            await self._restart()
            return
        request = make("protocol.param.ExecuteOpcode.Request", opcode=_OPCODES[verb])
        # Once, as a write of a parameter: by the time of a second request its motor may turn.
        response = await self._port.request(
            self._config.node, request, f"to {verb}", attempts=1, before=self._check_allowed
        )
        if not response.ok:
            raise DeviceRejected(
                f"DroneCAN node {self._config.node} refused {verb}",
                details={"argument": response.argument},
            )
        if verb == "reset_parameters":
            self._ask()

    async def _restart(self) -> None:
        node = self._config.node
        if not self._state.uptime:
            raise ModeForbids(f"DroneCAN node {node} has only just started", remedy="Wait 1 s.")
        self._back.clear()
        request = make("protocol.RestartNode.Request", magic_number=_MAGIC)
        with suppress(DeviceTimeout):  # it may restart before it answers
            response = await self._port.request(node, request, "to restart", attempts=1)
            if not response.ok:
                raise DeviceRejected(f"DroneCAN node {node} refused to restart")
        try:
            async with timeout(_REBOOT):
                await self._back.wait()
        except TimeoutError:
            raise DeviceTimeout(
                f"DroneCAN node {node} did not report a restart within {_REBOOT:g} s"
            ) from None

    def _check_link(self) -> None:
        if self._state.mode in ("unknown", "offline"):
            raise AdapterUnavailable(
                f"DroneCAN node {self._config.node} ('{self._name}') does not respond",
                remedy="Check its supply, cable and node id; the gateway allocates no ids.",
            )

    def _check_allowed(self) -> None:
        self._check_idle()
        check_fence()

    def _check_idle(self) -> None:
        """Check that the node is there, and turns no motor.

        :raises AdapterUnavailable: it is not.
        :raises ModeForbids: a motor of it is in use.
        """
        self._check_link()
        for axis in self._axes:
            if axis.online and (axis.status.energised is not False or not axis.resting):
                raise ModeForbids(
                    f"motor '{axis.name}' of DroneCAN node {self._config.node} is {axis.state}",
                    remedy=f"Execute service/{axis.name}/disable, and wait until it is at rest.",
                )


def _nowhere(*_: Any) -> None:
    """Declare nothing: the node has not been started."""


def _state_of(state: Any) -> NodeState:
    return NodeState(
        mode=MODES[state.mode],
        health=HEALTH[state.health],
        uptime=state.uptime_sec,
        code=state.vendor_specific_status_code,
    )
