"""The physics of one robot: steps, brakes, expiry of commands, and faults.

Used by one thread; never blocks. All times are simulation time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Protocol

import numpy as np

from rcp_kernel.errors import DeviceRejected, PreconditionFailed
from rcp_mujoco.bindings import mujoco
from rcp_mujoco.joints import Drive, drives, joints, robot_dofs

__all__ = ["Controller", "Simulation"]

_SLOW = {"rad": 0.02, "m": 0.01}  # rad/s, m/s: below it a joint is at rest
_FREE_SLOW = (0.01, 0.01, 0.01, 0.03, 0.03, 0.03)  # m/s and rad/s of a floating base
_BALL_SLOW = (0.03, 0.03, 0.03)
_SETTLED = 0.05  # s below these speeds to count as at rest
_BRAKE = 2.0  # times the maximum force of the actuators
_HARD = 0.9999  # impedance of applied brakes: softer ones would creep under a load
_STOPPING = 200.0  # rad/s2 or m/s2, of a brake if the actuator has no maximum force
_SPOILED = {
    mujoco.mjtWarning.mjWARN_BADQPOS: "a position",
    mujoco.mjtWarning.mjWARN_BADQVEL: "a velocity",
    mujoco.mjtWarning.mjWARN_BADQACC: "an acceleration",
    mujoco.mjtWarning.mjWARN_BADCTRL: "a control",
}
_DOUBTFUL = {
    mujoco.mjtWarning.mjWARN_INERTIA: "the inertia matrix is nearly singular",
    mujoco.mjtWarning.mjWARN_CONTACTFULL: "there are more contacts than fit in memory",
    mujoco.mjtWarning.mjWARN_CNSTRFULL: "there are more constraints than fit in memory",
}


class Controller(Protocol):
    """A part of the robot that sets controls before each step."""

    def control(self, dt: float) -> None:
        """Set the controls for the next `dt` seconds."""
        ...

    def stop(self, reason: str) -> None:
        """End its motion; the brakes or a held position do the rest."""
        ...

    def kept(self) -> Sequence[int]:
        """List the actuators whose force is kept during a stop, such as a grip."""
        ...

    def reset(self) -> None:
        """Restart from the robot's current position."""
        ...


class Simulation:
    """A model in motion."""

    def __init__(self, model: Any, *, keyframe: str | None = None) -> None:
        self.model = model
        self.data = mujoco.MjData(model)
        self.dt = float(model.opt.timestep)
        """Length of a step, s."""
        self.joints = joints(model)
        self.drives = drives(model)
        self.controllers: list[Controller] = []
        self.fault: str | None = None
        """Why it has stopped; only `reset` restarts it."""
        self.doubt: str | None = None
        """Non-fatal warnings of MuJoCo."""
        self.braking = False
        self.elapsed = 0.0
        """Seconds simulated since its creation, across resets."""
        self.resets = 0
        self.lapsed: list[str] = []
        """Commands that have expired since this was last cleared."""
        self._due: dict[str, tuple[float, Callable[[], None]]] = {}
        self._dofs = robot_dofs(model, self.drives)
        self._slow = _thresholds(model)[self._dofs]
        self._friction = model.dof_frictionloss.copy()
        self._softness = model.dof_solimp.copy()
        self._brakes = _brakes(model, self.drives)
        self._key = model.key(keyframe).id if keyframe is not None else 0 if model.nkey else None
        self._warnings = self.data.warning.number
        """MuJoCo's own counters, not a copy of them."""
        self._held: set[int] = set()
        """Position actuators whose set-point under the brakes is fixed."""
        self._slow_since = 0.0
        self._place()

    @property
    def time(self) -> float:
        """Seconds simulated since the last reset."""
        return float(self.data.time)

    @property
    def at_rest(self) -> bool:
        """Whether the robot is measured at rest, for long enough."""
        if self.fault is not None or not self._is_slow():
            return False
        return self.time - self._slow_since >= _SETTLED - 1e-9

    @property
    def commanded(self) -> bool:
        """Whether a non-zero velocity or force is commanded."""
        return any(d.safe is not None and self.data.ctrl[d.number] != 0 for d in self.drives)

    @property
    def speed(self) -> float:
        """The highest joint velocity of the robot, m/s or rad/s."""
        return float(np.abs(self.data.qvel[self._dofs]).max(initial=0.0))

    # Commands

    def need_whole(self) -> None:
        """Refuse motion after the simulation has diverged.

        :raises PreconditionFailed: it has.
        """
        if self.fault is not None:
            raise PreconditionFailed(
                f"the simulation has stopped: {self.fault}",
                remedy="Execute service/reset to start it again.",
            )

    def command(self, drive: Drive, value: float, valid_for: float | None) -> None:
        """Set the control of an actuator; a velocity or force expires after `valid_for` seconds."""
        self.need_whole()
        self.release()
        self.data.ctrl[drive.number] = value
        if drive.safe is None or value == drive.safe or valid_for is None:
            self.forget(drive.name)
        else:
            self.lapse(drive.name, valid_for, lambda: self.neutral(drive))

    def neutral(self, drive: Drive) -> None:
        """Set the velocity or force of an actuator to zero."""
        self.forget(drive.name)
        self.data.ctrl[drive.number] = 0.0

    def lapse(self, name: str, seconds: float, stop: Callable[[], None]) -> None:
        """Let a command expire after a number of seconds of simulation time."""
        self._due[name] = (self.time + seconds, stop)
        with suppress(ValueError):
            self.lapsed.remove(name)  # an earlier one, which is told no more

    def forget(self, name: str) -> bool:
        """Cancel the expiry of a command; return whether there was one."""
        return self._due.pop(name, None) is not None

    def brake(self, reason: str) -> None:
        """Apply the brakes of every driven joint and end the controllers' motions."""
        self._due.clear()
        kept = [index for controller in self.controllers for index in controller.kept()]
        for controller in self.controllers:
            controller.stop(reason)
        for drive in self.drives:
            if drive.safe is not None:
                self.data.ctrl[drive.number] = 0.0
        if not self.braking:
            self.braking = True
            self._held = set(kept)
            np.maximum(self._friction, self._brakes, out=self.model.dof_frictionloss)
            self.model.dof_solimp[self._brakes > 0, :2] = _HARD

    def release(self) -> None:
        """Release the brakes; position actuators keep holding."""
        if self.braking:
            self._hold_positions()
            self.braking = False
            self.model.dof_frictionloss[:] = self._friction
            self.model.dof_solimp[:] = self._softness

    def reset(self) -> None:
        """Restore the initial state, at rest and without a fault; applied brakes stay applied."""
        self._due.clear()
        for controller in self.controllers:
            controller.stop("the simulation was reset")
        mujoco.mj_resetData(self.model, self.data)
        self.fault = self.doubt = None
        self.resets += 1
        self._place()
        for controller in self.controllers:
            controller.reset()

    def _place(self) -> None:
        if self._key is not None:
            mujoco.mj_resetDataKeyframe(self.model, self.data, self._key)
            for drive in self.drives:
                if drive.safe is not None:  # nobody commanded it, and it would never expire
                    self.data.ctrl[drive.number] = 0.0
        else:
            self._hold_here()
        self._held = set()
        mujoco.mj_forward(self.model, self.data)
        self._slow_since = self.time - _SETTLED

    def _hold_here(self) -> None:
        for drive in self.drives:
            if drive.mode == "position" and drive.joint is not None:
                here = float(self.data.qpos[drive.joint.qpos])
                self.data.ctrl[drive.number] = drive.control(here)

    # Time

    def step(self) -> None:
        """Advance by one step, unless there is a fault."""
        if self.fault is not None:
            return
        dt = self.dt
        self._end_lapsed()
        for controller in self.controllers:
            controller.control(dt)
        if self.braking:
            self._keep_braking()
        try:
            mujoco.mj_step(self.model, self.data)
        except mujoco.FatalError as error:
            self.fault = f"MuJoCo failed: {error}"
            return
        self.elapsed += dt
        self._judge()
        if not self._is_slow():
            self._slow_since = self.time

    def _end_lapsed(self) -> None:
        if self._due:
            over = [name for name, (due, _) in self._due.items() if self.time >= due - 1e-9]
            for name in over:
                self._due.pop(name)[1]()
                self.lapsed.append(name)

    def _keep_braking(self) -> None:
        """Override all other controls, at each step."""
        self._hold_positions()
        for drive in self.drives:
            if drive.safe is not None:
                self.data.ctrl[drive.number] = 0.0

    def _hold_positions(self) -> None:
        """Let each position actuator hold the position where its joint comes to rest."""
        data = self.data
        for drive in self.drives:
            joint = drive.joint
            if drive.mode != "position" or joint is None or drive.number in self._held:
                continue
            data.ctrl[drive.number] = drive.control(float(data.qpos[joint.qpos]))
            if abs(data.qvel[joint.dof]) < _SLOW[joint.unit]:
                self._held.add(drive.number)

    def _judge(self) -> None:
        data = self.data
        if self._warnings.any():
            for warning, what in _SPOILED.items():
                if data.warning[warning].number:
                    where = self._culprit(warning, int(data.warning[warning].lastinfo))
                    self.fault = (
                        f"{what} of {where} is not a number, or too large, at {self.time:.3f} s"
                    )
                    return
            found = [text for warning, text in _DOUBTFUL.items() if data.warning[warning].number]
            self.doubt = found[0] if found else None
        if not np.isfinite(data.qvel).all():
            self.fault = f"the state is not a number at {self.time:.3f} s"

    def _culprit(self, warning: Any, index: int) -> str:
        model = self.model
        if warning == mujoco.mjtWarning.mjWARN_BADCTRL:
            return f"actuator '{model.actuator(index).name}'"
        if warning == mujoco.mjtWarning.mjWARN_BADQPOS:
            joint = int(np.searchsorted(model.jnt_qposadr, index, side="right")) - 1
        else:
            joint = int(model.dof_jntid[index])
        return f"joint '{model.joint(joint).name or joint}'"

    def _is_slow(self) -> bool:
        return bool((np.abs(self.data.qvel[self._dofs]) < self._slow).all())

    # Names

    def drive(self, name: str) -> Drive:
        """Return an actuator by its name.

        :raises DeviceRejected: there is none.
        """
        for drive in self.drives:
            if drive.name == name:
                return drive
        raise DeviceRejected(f"the model has no actuator '{name}'")


def _thresholds(model: Any) -> Any:
    found = np.zeros(model.nv)
    for index in range(model.njnt):
        dof = model.jnt_dofadr[index]
        match mujoco.mjtJoint(model.jnt_type[index]):
            case mujoco.mjtJoint.mjJNT_FREE:
                found[dof : dof + 6] = _FREE_SLOW
            case mujoco.mjtJoint.mjJNT_BALL:
                found[dof : dof + 3] = _BALL_SLOW
            case mujoco.mjtJoint.mjJNT_SLIDE:
                found[dof] = _SLOW["m"]
            case _:
                found[dof] = _SLOW["rad"]
    return found


def _brakes(model: Any, driven: list[Drive]) -> Any:
    """Return the friction of applied brakes for each degree of freedom, N.m or N."""
    found = np.zeros(model.nv)
    free = {
        int(model.jnt_dofadr[i]) + k
        for i in range(model.njnt)
        if model.jnt_type[i] == int(mujoco.mjtJoint.mjJNT_FREE)
        for k in range(6)
    }
    for drive in driven:
        strongest = _STOPPING * float(max(model.dof_M0[list(drive.dofs)], default=0.0))
        if model.actuator_forcelimited[drive.number]:
            strongest = float(np.abs(model.actuator_forcerange[drive.number]).max())
        for dof in drive.dofs:
            if dof not in free:
                found[dof] = max(found[dof], _BRAKE * strongest)
    return found
