"""The gimbals of a vehicle: which managers have which, what they can do, and who controls them."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Annotated, Any, NamedTuple

from msgspec import Meta, Struct

from rcp_kernel.errors import OutOfRange, RcpError
from rcp_kernel.model import READS, Resource
from rcp_kernel.spi import Progress
from rcp_mavlink.commands import Command, Commands
from rcp_mavlink.frames import Frame, text_of
from rcp_mavlink.hub import Hub
from rcp_mavlink.vehicle import Vehicle

__all__ = ["GimbalKey", "GimbalList"]

_REQUEST = 512
_MANAGER, _STATUS = "GIMBAL_MANAGER_INFORMATION", "GIMBAL_MANAGER_STATUS"
_DEVICE = "GIMBAL_DEVICE_INFORMATION"
_TYPES = (18, 26, 30)  # MAV_TYPE: onboard computer, gimbal, camera
_MOST = 16
_REST = 0.2  # s within which a manager tells of its other gimbals: it does not say how many it has
_BY_COMPONENT = 7  # device ids from here on are component ids; those below belong to a manager

Component = Annotated[int, Meta(ge=1, le=255, extra_json_schema={"unit": "1"})]
Angle = Annotated[float, Meta(extra_json_schema={"unit": "rad"})]


class Controller(Struct, frozen=True):
    """Who controls a gimbal."""

    system: Annotated[int, Meta(extra_json_schema={"unit": "1"})]
    component: Annotated[int, Meta(extra_json_schema={"unit": "1"})]


class Gimbal(Struct, frozen=True):
    """One gimbal, and how far it turns."""

    gimbal: Annotated[int, Meta(extra_json_schema={"unit": "1"})]
    """Its device id, by which the commands name it."""
    manager: Component
    """The component that manages it."""
    vendor: str
    model: str
    pitch_min: Angle
    pitch_max: Angle
    yaw_min: Angle
    """Relative to the vehicle; the same as `yaw_max` where it does not say."""
    yaw_max: Angle
    controller: Controller | None
    """Who has primary control; null if nobody has, or the manager does not tell."""
    in_control: bool
    """Whether this gateway has."""


class GimbalKey(NamedTuple):
    """What tells a gimbal from the others."""

    manager: int
    device: int


class GimbalList:
    """The gimbals of one vehicle with the gimbal protocol v2."""

    def __init__(self, hub: Hub, vehicle: Vehicle, commands: Commands) -> None:
        self._hub, self._vehicle, self._commands = hub, vehicle, commands
        self._found: dict[GimbalKey, dict[str, Any]] = {}
        """The fields of GIMBAL_MANAGER_INFORMATION."""
        self._asked_again = False

    def verbs(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return the handler of each path."""
        return {"service/gimbal/list": self.list}

    @staticmethod
    def resources() -> list[Resource]:
        """List what it serves."""
        return [
            Resource(name="service/gimbal/list", meta=READS, description="List the gimbals that a gimbal manager reports: how far they turn, and who controls them.", output=list[Gimbal], timeout=60),
        ]  # fmt: skip

    async def list(self, _: None, __: Progress) -> list[Gimbal]:
        """Ask every component that may manage gimbals, twice: a manager does not say how many it has."""
        await self._search()
        await self._search()
        return [await self._gimbal(key) for key in sorted(self._found)]

    async def find(self, gimbal: int | None, manager: int | None) -> GimbalKey | None:
        """Return the gimbal that is meant, by default the first of the autopilot or of the first manager.

        None: no manager reports any, and none was named.
        :raises OutOfRange: it is not there, or two managers have one of that id.
        """
        matches = self._matching(gimbal, manager)
        if not matches:
            await self._search()
            matches = self._matching(gimbal, manager)
        if gimbal is None and manager is None:
            if matches and not self._own() and not self._asked_again:
                self._asked_again = True  # the autopilot's answer may have been lost
                await self._search()
            return next(iter(self._own() or matches), None)
        if not matches:
            raise OutOfRange(
                f"no manager reports such a gimbal: {_named(gimbal, manager)}",
                details={"pointer": "/manager" if gimbal is None else "/gimbal"},
                remedy="Name one that service/gimbal/list has.",
            )
        if gimbal is not None and len(matches) > 1:
            managers = ", ".join(str(key.manager) for key in matches)
            raise OutOfRange(
                f"components {managers} each have a gimbal {gimbal}",
                details={"pointer": "/manager"},
                remedy="Give its `manager` too.",
            )
        return matches[0]

    def information(self, key: GimbalKey) -> dict[str, Any]:
        """Return the fields of GIMBAL_MANAGER_INFORMATION of a gimbal that was found."""
        return self._found[key]

    def reports(self, key: GimbalKey, frame: Frame, device: int) -> bool:
        """Return whether a message with a device id (0 if it has none) is about a gimbal.

        A gimbal that is a component of its own reports itself without an id; so do older managers
        of a single gimbal.
        """
        if device:
            return device == key.device and frame.component in (key.manager, key.device)
        if key.device >= _BY_COMPONENT and frame.component == key.device:
            return True
        alone = sum(other.manager == key.manager for other in self._found) == 1
        return alone and frame.component == key.manager

    def _own(self) -> list[GimbalKey]:
        return self._matching(None, self._vehicle.component)

    def _matching(self, gimbal: int | None, manager: int | None) -> list[GimbalKey]:
        return [
            key
            for key in sorted(self._found)
            if gimbal in (None, key.device) and manager in (None, key.manager)
        ]

    async def _search(self) -> None:
        vehicle = self._vehicle
        if _MANAGER not in self._hub.dialect.by_name:
            return
        parts = [n for n, type_ in vehicle.components.items() if type_ in _TYPES]

        def take(frame: Frame) -> None:
            fields = frame.fields()
            key = GimbalKey(frame.component, fields["gimbal_device_id"])
            if key.device and (key in self._found or len(self._found) < _MOST):
                self._found[key] = fields

        with vehicle.listening(_MANAGER, take, anybody=True):
            for component in [vehicle.component, *parts][:_MOST]:
                await self._ask(component)

    async def _ask(self, component: int) -> None:
        """Have one component tell of its gimbals; one that does not answer has none."""
        before = {key for key in self._found if key.manager == component}
        number = float(self._hub.dialect.by_name[_MANAGER].id)
        request = Command(_REQUEST, (number, 0.0, 0.0, 0.0), component=component)
        try:
            await self._commands.send(request, f"request for {_MANAGER}")
        except RcpError:
            self._vehicle.check()
            return
        if not before:
            first = lambda: any(key.manager == component for key in self._found)  # noqa: E731
            await self._vehicle.until(first, self._hub.config.timeout)
        await self._vehicle.until(lambda: False, min(_REST, self._hub.config.timeout))

    async def _gimbal(self, key: GimbalKey) -> Gimbal:
        info = self._found[key]
        device = await self._told(key, _DEVICE, self.component(key)) or {}
        status = await self.status(key)
        controller = None
        if status is not None and status["primary_control_sysid"]:
            controller = Controller(
                status["primary_control_sysid"], status["primary_control_compid"]
            )
        return Gimbal(
            gimbal=key.device,
            manager=key.manager,
            vendor=text_of(bytes(device.get("vendor_name", b""))),
            model=text_of(bytes(device.get("model_name", b""))),
            pitch_min=info["pitch_min"],
            pitch_max=info["pitch_max"],
            yaw_min=info["yaw_min"],
            yaw_max=info["yaw_max"],
            controller=controller,
            in_control=self.controls(status),
        )

    def component(self, key: GimbalKey) -> int:
        """Return the component that reports a gimbal: its own if it has one, or its manager's."""
        apart = key.device >= _BY_COMPONENT and key.device in self._vehicle.components
        return key.device if apart else key.manager

    def controls(self, status: dict[str, Any] | None) -> bool:
        """Return whether this gateway has primary control, by GIMBAL_MANAGER_STATUS."""
        config = self._hub.config
        return status is not None and (
            status["primary_control_sysid"],
            status["primary_control_compid"],
        ) == (config.source_system, config.source_component)

    async def status(self, key: GimbalKey) -> dict[str, Any] | None:
        """Return GIMBAL_MANAGER_STATUS of a gimbal; None if the manager does not send it."""
        return await self._told(key, _STATUS, key.manager)

    async def _told(self, key: GimbalKey, message: str, component: int) -> dict[str, Any] | None:
        definition = self._hub.dialect.by_name.get(message)
        if definition is None:
            return None
        found: list[dict[str, Any]] = []

        def take(frame: Frame) -> None:
            fields = frame.fields()
            if self.reports(key, frame, fields.get("gimbal_device_id", 0)):
                found.append(fields)

        request = Command(_REQUEST, (float(definition.id), 0.0, 0.0, 0.0), component=component)
        with self._vehicle.listening(message, take, anybody=True):
            try:
                await self._commands.send(request, f"request for {message}")
            except RcpError:
                self._vehicle.check()
                return None
            await self._vehicle.until(lambda: bool(found), self._hub.config.timeout)
        return found[-1] if found else None


def _named(gimbal: int | None, manager: int | None) -> str:
    device = "any" if gimbal is None else f"number {gimbal}"
    return device if manager is None else f"{device} of component {manager}"
