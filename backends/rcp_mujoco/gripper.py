"""A gripper: fingers that move to a width, or until they hold something."""

from __future__ import annotations

from collections.abc import Sequence

from rcp_kernel.errors import ConfigError, InvalidValue
from rcp_mujoco.config import GripperConfig
from rcp_mujoco.joints import Joint
from rcp_mujoco.simulation import Simulation

__all__ = ["Grip", "Gripper"]

_SPEED = 0.05  # m/s of the actuator
_SLOW = 0.002  # m/s
_STOPPED = 0.15  # s without motion after which the fingers have reached their limit
_NEAR = 0.002  # m of the width
_TOUCH = 0.5  # N above which an object counts as held


class Grip:
    """A motion of the fingers."""

    def __init__(self, width: float, force: float | None) -> None:
        self.width, self.force = width, force
        self.failure: str | None = None
        self.done = False
        self.still = 0.0

    @property
    def over(self) -> bool:
        """Whether it has ended, successfully or not."""
        return self.done or self.failure is not None


class Gripper:
    """The fingers.

    :raises ConfigError: the actuator is not a position actuator of a joint.
    :raises DeviceRejected: the model has no such actuator.
    """

    def __init__(self, config: GripperConfig, simulation: Simulation) -> None:
        self.config = config
        self._simulation = simulation
        self._drive = drive = simulation.drive(config.actuator)
        if drive.mode != "position" or drive.joint is None:
            raise ConfigError(
                f"gripper.actuator: '{drive.name}' is not a position actuator of a joint"
            )
        self._joint: Joint = drive.joint
        sensors = [simulation.model.sensor(name) for name in config.contacts]
        self._pads = [int(sensor.adr[0]) for sensor in sensors]
        self.grip: Grip | None = None

    @property
    def limits(self) -> tuple[float, float]:
        """The minimum and maximum width, m."""
        return 0.0, abs(self.config.open - self.config.closed) * self.config.width

    @property
    def width(self) -> float:
        """Distance between the fingers, m."""
        return abs(self._here - self.config.closed) * self.config.width

    @property
    def _here(self) -> float:
        """The control that would hold the fingers where they are."""
        joint = float(self._simulation.data.qpos[self._joint.qpos])
        return self._drive.ratio * joint + self._drive.offset

    @property
    def force(self) -> float | None:
        """The lowest force of all pads, N; None without touch sensors."""
        if not self._pads:
            return None
        return min(float(self._simulation.data.sensordata[pad]) for pad in self._pads)

    @property
    def holding(self) -> bool | None:
        """Whether an object is held; None if unknown."""
        force = self.force
        return None if force is None else force > _TOUCH and self.width > _NEAR

    def move(self, grip: Grip) -> None:
        """Start to move the fingers.

        :raises InvalidValue: the force is to be limited, and nothing measures it.
        """
        if grip.force is not None and not self._pads:
            raise InvalidValue(
                "the gripper has no touch sensors to limit its force by",
                details={"pointer": "/force"},
            )
        self._simulation.need_whole()
        self.stop("another motion was commanded")
        self._simulation.release()
        self.grip = grip

    def abandon(self, grip: Grip) -> None:
        """Stop the fingers where they are; a held object stays held."""
        if self.grip is grip:
            if not self.holding:
                self._hold()
            self.stop("cancelled")

    def stop(self, reason: str) -> None:
        """End the motion."""
        if self.grip is not None:
            self.grip.failure = reason
            self.grip = None

    def kept(self) -> Sequence[int]:
        """The finger actuator, if an object is held."""
        return (self._drive.number,) if self.holding else ()

    def reset(self) -> None:
        """Do nothing: no state is kept across a reset."""

    def control(self, dt: float) -> None:
        """Move the actuator towards the goal."""
        grip = self.grip
        if grip is None:
            return
        config, data = self.config, self._simulation.data
        sign = 1.0 if config.open > config.closed else -1.0
        goal = config.closed + sign * grip.width / config.width
        here = float(data.ctrl[self._drive.number])
        opening = (goal - here) * sign > 0
        force = self.force
        enough = grip.force is not None and force is not None and force >= grip.force
        if not (enough and not opening):
            most = _SPEED * dt
            data.ctrl[self._drive.number] = here + max(-most, min(most, goal - here))
        slow = abs(data.qvel[self._joint.dof]) < _SLOW
        grip.still = grip.still + dt if slow else 0.0
        if grip.still >= _STOPPED and (enough or here == goal):
            self._end(grip)

    def _end(self, grip: Grip) -> None:
        if abs(self.width - grip.width) <= _NEAR or self.holding:
            grip.done = True
            self.grip = None
        else:
            self.stop(f"the fingers stopped {self.width:.3f} m apart")

    def _hold(self) -> None:
        self._simulation.data.ctrl[self._drive.number] = self._here
