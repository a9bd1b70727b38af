"""An arm: its joints follow a path, which completes when they are measured at the goal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from rcp_kernel.errors import ConfigError
from rcp_mujoco.config import ArmConfig
from rcp_mujoco.joints import Joint
from rcp_mujoco.paths import Path
from rcp_mujoco.simulation import Simulation

__all__ = ["Arm", "Motion"]

_SLOW = 0.02  # rad/s
_SETTLING = 2.0  # s for the joints to arrive after the end of the path
_BEHIND = 0.35  # rad, maximum tracking error
_BRAKING = 0.3  # s in which a cancelled path slows down to its end


class Motion:
    """A path being followed."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.seconds = 0.0
        """Seconds along the path."""
        self.error = 0.0
        """Maximum tracking error of all joints, rad."""
        self.left = float(np.abs(path.goal - path.at(0.0)).max())
        """Maximum distance of all joints from their goals, rad."""
        self.failure: str | None = None
        self.arrived = False
        self.rate = 1.0
        """Rate of time along the path; ramps down to zero after a cancellation."""
        self.abandoned = False
        self.settling = 0.0

    @property
    def over(self) -> bool:
        """Whether it has ended, successfully or not."""
        return self.arrived or self.failure is not None

    @property
    def time_left(self) -> float:
        """Seconds to the end of the path."""
        return max(0.0, self.path.duration - self.seconds)


class Arm:
    """The joints of an arm.

    :raises ConfigError: an actuator is not a position actuator of a joint, or there is no such site or body.
    """

    def __init__(self, config: ArmConfig, simulation: Simulation) -> None:
        self.config = config
        self._simulation = simulation
        drives = [simulation.drive(name) for name in config.joints]
        self.joints: list[Joint] = []
        for drive in drives:
            if drive.mode != "position" or drive.joint is None:
                raise ConfigError(
                    f"arm.joints: '{drive.name}' is not a position actuator of a joint"
                )
            self.joints.append(drive.joint)
        self._controls = [drive.number for drive in drives]
        self._ratio = np.array([drive.ratio for drive in drives])
        self._offset = np.array([drive.offset for drive in drives])
        self._qpos = [joint.qpos for joint in self.joints]
        self._dofs = [joint.dof for joint in self.joints]
        self.motion: Motion | None = None

    @property
    def names(self) -> list[str]:
        """The joints' names."""
        return [joint.name for joint in self.joints]

    @property
    def positions(self) -> Any:
        """The positions of the joints, rad."""
        return self._simulation.data.qpos[self._qpos]

    def follow(self, motion: Motion) -> None:
        """Start to follow a path from the current positions."""
        self._simulation.need_whole()
        self.stop("another motion was commanded")
        self._simulation.release()
        self.motion = motion

    def abandon(self, motion: Motion) -> None:
        """Brake along the path, then hold."""
        if self.motion is motion:
            motion.abandoned = True

    def stop(self, reason: str) -> None:
        """End the motion; the caller brakes or holds."""
        if self.motion is not None:
            self.motion.failure = reason
            self.motion = None

    def kept(self) -> Sequence[int]:
        """No actuators: the joints hold where they come to rest."""
        return ()

    def reset(self) -> None:
        """Do nothing: no state is kept across a reset."""

    def control(self, dt: float) -> None:
        """Set the joints' set-points for the next step."""
        motion = self.motion
        if motion is None:
            return
        self._advance(motion, dt)
        target = motion.path.at(motion.seconds)
        self._aim(target)
        here = self.positions
        off = np.abs(target - here)
        motion.error = float(off.max())
        motion.left = float(np.abs(motion.path.goal - here).max())
        if motion.error > _BEHIND:
            late = int(off.argmax())
            self._give_up(f"{self.names[late]} is {off[late]:.2f} rad behind its path", here)
        elif motion.abandoned and motion.rate == 0.0:
            if self._is_slow():
                self.stop("cancelled")
        elif motion.seconds >= motion.path.duration:
            self._arrive(motion, here, dt)

    def _advance(self, motion: Motion, dt: float) -> None:
        if motion.abandoned:
            motion.rate = max(0.0, motion.rate - dt / _BRAKING)
        motion.seconds += motion.rate * dt

    def _arrive(self, motion: Motion, here: Any, dt: float) -> None:
        if motion.left <= self.config.tolerance and self._is_slow():
            motion.arrived = True
            self.motion = None
            return
        motion.settling += dt
        if motion.settling > _SETTLING:
            off = np.abs(motion.path.goal - here)
            worst = int(off.argmax())
            self._give_up(f"{self.names[worst]} stopped {off[worst]:.3f} rad before its goal", here)

    def _give_up(self, reason: str, here: Any) -> None:
        """Hold the current position: pushing on would not help."""
        self._aim(here)
        self.stop(reason)

    def _aim(self, positions: Any) -> None:
        self._simulation.data.ctrl[self._controls] = self._ratio * positions + self._offset

    def _is_slow(self) -> bool:
        return bool((np.abs(self._simulation.data.qvel[self._dofs]) < _SLOW).all())
