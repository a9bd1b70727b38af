"""A device described by a DBC file: received messages are sensors, sent messages are actuators."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any

import cantools
import msgspec

from rcp_can.binding import Part
from rcp_can.bus import Bus, Route
from rcp_can.config_device import DeviceConfig
from rcp_can.device_types import message_type
from rcp_can.drive import KEPT
from rcp_kernel.errors import AdapterUnavailable, ConfigError, InvalidValue, RcpError
from rcp_kernel.model import Resource
from rcp_kernel.spi import Host, check_fence
from rcp_kernel.values import to_plain

if TYPE_CHECKING:
    import can
    from cantools.database.can import Message

__all__ = ["DevicePart"]

_MISSED = 3  # periods after which a message is stale


class DevicePart(Part):
    """The messages of one device.

    :raises ConfigError: the file cannot be read, or has no such message.
    """

    def __init__(self, name: str, config: DeviceConfig, bus: Bus, host: Host) -> None:
        self._name, self._config, self._bus, self._host = name, config, bus, host
        messages = self._load()
        for wanted in (*config.read, *config.write):
            if wanted not in messages:
                raise ConfigError(
                    f"devices.{name}: {config.dbc} has no message {wanted!r}; "
                    f"it has {', '.join(messages)}"
                )
        shown = config.read or [each for each in messages if each not in config.write]
        self._sensors = {f"sensor/{name}/{each}": messages[each] for each in shown}
        self._actuators = {f"actuator/{name}/{each}": messages[each] for each in config.write}
        self._types = {
            path: message_type(message, bounded=path in self._actuators)
            for path, message in (self._sensors | self._actuators).items()
        }
        for path, message in self._sensors.items():
            mask = 0x1FFFFFFF if message.is_extended_frame else 0x7FF
            route = Route(message.frame_id, mask, message.is_extended_frame)
            bus.listen(self._listener(path, message), route, whose=name)

    def _load(self) -> dict[str, Message]:
        try:
            database: Any = cantools.database.load_file(self._config.dbc)
        except Exception as error:
            raise ConfigError(f"devices.{self._name}.dbc: {self._config.dbc}: {error}") from error
        return {message.name: message for message in database.messages}

    def _listener(self, path: str, message: Message) -> Any:
        type_ = self._types[path]

        def take(frame: can.Message) -> None:
            try:
                values: Any = message.decode(bytes(frame.data), decode_choices=False)
                value = type_(**values)
            except Exception as error:
                raise ValueError(str(error)) from error
            self._host.publish(path, value, int(frame.timestamp * 1e9) or None)

        return take

    @property
    def bus(self) -> str:
        """The name of its bus."""
        return self._bus.name

    def resources(self) -> list[Resource]:
        """List its messages as resources."""
        found: list[Resource] = []
        for path, message in self._sensors.items():
            period = message.cycle_time
            found.append(
                Resource(
                    name=path,
                    description=_sentence(message),
                    value=self._types[path],
                    live=True,
                    deadline=_MISSED * period / 1000 if period else None,
                    meta=self._meta(message),
                )
            )
        for path, message in self._actuators.items():
            safe = self._config.safe.get(message.name)
            if safe is not None:
                self._check(path, safe)
            found.append(
                Resource(
                    name=path,
                    description=_sentence(message),
                    value=self._types[path],
                    safe=safe,
                    valid_for=None if safe is None else self._config.valid_for,
                    meta=self._meta(message),
                )
            )
        return found

    def _check(self, path: str, safe: dict[str, Any]) -> None:
        try:
            msgspec.convert(safe, self._types[path])
        except msgspec.ValidationError as error:
            raise ConfigError(f"devices.{self._name}.safe: {path}: {error}") from error

    def _meta(self, message: Message) -> dict[str, Any]:
        found = {"bus": self._bus.name, "id": message.frame_id, "message": message.name}
        choices = {
            signal.name: {str(key): str(name) for key, name in signal.choices.items()}
            for signal in message.signals
            if signal.choices
        }
        return {**found, "choices": choices} if choices else found

    async def read(self, name: str) -> Any:
        """Refuse: a message cannot be requested from its sender.

        :raises AdapterUnavailable: always.
        """
        raise AdapterUnavailable(f"no {name} received yet")

    async def write(self, name: str, value: Any) -> None:
        """Send a message; one that waits is not sent after its safe value, nor when it is no longer valid.

        Without a safe value, that is when whoever sent it has been told otherwise.
        """
        message = self._actuators[name]
        data = self._encode(message, value)
        check_fence()
        safe = self._safe_data(message)
        lifetime = KEPT if safe is None else None if data == safe else self._config.valid_for
        self._bus.send(
            message.frame_id,
            data,
            extended=message.is_extended_frame,
            fd=message.is_fd,
            lifetime=lifetime,
            sender=(self, message.frame_id),
        )

    @staticmethod
    def _encode(message: Message, value: Any) -> bytes:
        values = {key: each for key, each in to_plain(value).items() if each is not None}
        try:
            return message.encode(values, strict=True)
        except Exception as error:
            raise InvalidValue(f"{message.name} cannot encode this value: {error}") from error

    async def halt(self) -> None:
        """Send all safe values, whether or not anything was sent before."""
        for identifier, data, extended, fd in self.safe_frames():
            sender = self, identifier
            self._bus.send(identifier, data, extended=extended, fd=fd, urgent=True, sender=sender)

    async def hold(self, reason: RcpError) -> None:
        """Send the safe values; `reason` is not used."""
        await self.halt()

    def hold_stop(self) -> None:
        """Send the safe values again: another node may have sent something else."""
        with suppress(RcpError):  # the bus state reports it, and this is called again soon
            for identifier, data, extended, fd in self.safe_frames():
                self._bus.send(identifier, data, extended=extended, fd=fd)

    def safe_frames(self) -> list[tuple[int, bytes, bool, bool]]:
        """List the frames of `safe`: identifier, payload, extended, CAN FD."""
        found: list[tuple[int, bytes, bool, bool]] = []
        for message in self._actuators.values():
            data = self._safe_data(message)
            if data is not None:
                found.append((message.frame_id, data, message.is_extended_frame, message.is_fd))
        return found

    def _safe_data(self, message: Message) -> bytes | None:
        safe = self._config.safe.get(message.name)
        if safe is None:
            return None
        type_ = self._types[f"actuator/{self._name}/{message.name}"]
        return self._encode(message, msgspec.convert(safe, type_))


def _sentence(message: Message) -> str:
    comment: Any = message.comment or ""
    text = " ".join(str(comment).split()) or f"CAN message {message.name}"
    return text if text.endswith(".") else text + "."
