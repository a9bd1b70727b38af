"""The cameras of a vehicle and the gimbals that turn them."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from rcp_kernel.model import Resource
from rcp_kernel.spi import Progress
from rcp_mavlink.camera_controls import CameraControls
from rcp_mavlink.camera_list import CameraList
from rcp_mavlink.cameras import Cameras
from rcp_mavlink.commands import Commands
from rcp_mavlink.files import Files
from rcp_mavlink.gimbal_list import GimbalList
from rcp_mavlink.gimbals import Gimbals
from rcp_mavlink.hub import Hub
from rcp_mavlink.intervals import Intervals
from rcp_mavlink.photofiles import PhotoFiles
from rcp_mavlink.regions import Regions
from rcp_mavlink.vehicle import Vehicle

__all__ = ["Imaging"]


class Imaging:
    """The cameras and gimbals of one vehicle."""

    def __init__(
        self, hub: Hub, vehicle: Vehicle, commands: Commands, intervals: Intervals, files: Files
    ) -> None:
        gimbal_list = GimbalList(hub, vehicle, commands)
        gimbals = Gimbals(hub, vehicle, commands, intervals, gimbal_list)
        cameras = Cameras(hub, vehicle, commands, PhotoFiles(hub, vehicle, files))
        self._parts = (
            gimbal_list,
            gimbals,
            Regions(vehicle, commands, gimbals, gimbal_list),
            CameraList(hub, vehicle, commands),
            CameraControls(hub, vehicle, commands, cameras),
        )

    def verbs(self) -> dict[str, Callable[[Any, Progress], Awaitable[Any]]]:
        """Return the handler of each path."""
        return {name: verb for part in self._parts for name, verb in part.verbs().items()}

    @staticmethod
    def resources() -> list[Resource]:
        """List what it serves."""
        return [
            *GimbalList.resources(),
            *Gimbals.resources(),
            *Regions.resources(),
            *CameraList.resources(),
            *CameraControls.resources(),
        ]
