"""Forward and inverse kinematics of the tool, by damped least squares."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from rcp_kernel.errors import DeviceRejected
from rcp_mujoco.arm import Arm
from rcp_mujoco.bindings import mujoco
from rcp_mujoco.simulation import Simulation

__all__ = ["Kinematics", "ToolPose"]

_DAMPING = 0.05
_ROUNDS = 200
_RESTARTS = 8
_STEP = 0.3  # rad, maximum step of an iteration
_NEAR = 1e-3  # m
_ALIGNED = 5e-3  # rad
_UNREACHED = "the tool cannot reach this pose: no joint positions within their ranges were found"


class ToolPose(NamedTuple):
    """Position and quaternion (w first)."""

    position: Any
    quaternion: Any


class Kinematics:
    """The tool of an arm, relative to the arm's base."""

    def __init__(self, arm: Arm, simulation: Simulation) -> None:
        model = simulation.model
        self._model = model
        self._data = simulation.data
        self._site = int(model.site(arm.config.tool).id)
        self._base = int(model.body(arm.config.base).id)
        self._joints = arm.joints
        self._qpos = [joint.qpos for joint in arm.joints]
        self._dofs = [joint.dof for joint in arm.joints]
        self._low = np.array([joint.low for joint in arm.joints])
        self._high = np.array([joint.high for joint in arm.joints])
        self._reach = self._longest()

    def check_reach(self, position: Any) -> None:
        """Refuse a position in the frame of the base that is farther than the arm is long.

        :raises DeviceRejected: it is.
        """
        if float(np.linalg.norm(position)) > self._reach:
            raise DeviceRejected(_UNREACHED)

    def _longest(self) -> float:
        """Return a bound of the distance between base and tool: all links in a line."""
        model = self._model
        length = float(np.linalg.norm(model.site_pos[self._site]))
        body = int(model.site_bodyid[self._site])
        while body not in (0, self._base):
            length += float(np.linalg.norm(model.body_pos[body]))
            first = int(model.body_jntadr[body])
            for joint in range(first, first + int(model.body_jntnum[body])):
                if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
                    length += float(np.abs(model.jnt_range[joint]).max()) or np.inf
                else:
                    length += 2 * float(np.linalg.norm(model.jnt_pos[joint]))
            body = int(model.body_parentid[body])
        return length

    def tool(self, data: Any = None) -> ToolPose:
        """Return the tool's pose in the frame of the base."""
        data = self._data if data is None else data
        back, offset = np.zeros(4), np.zeros(3)
        position, turn, site = np.zeros(3), np.zeros(4), np.zeros(4)
        mujoco.mju_negPose(offset, back, data.xpos[self._base], data.xquat[self._base])
        mujoco.mju_mat2Quat(site, data.site_xmat[self._site])
        mujoco.mju_mulPose(position, turn, offset, back, data.site_xpos[self._site], site)
        return ToolPose(position, turn)

    def world(self, pose: ToolPose) -> ToolPose:
        """Transform a pose from the frame of the base to the world."""
        data, position, turn = self._data, np.zeros(3), np.zeros(4)
        base = (data.xpos[self._base], data.xquat[self._base])
        mujoco.mju_mulPose(position, turn, *base, pose.position, pose.quaternion)
        return ToolPose(position, turn)

    def local(self, pose: ToolPose) -> ToolPose:
        """Transform a pose from the world to the frame of the base."""
        data, back, offset = self._data, np.zeros(4), np.zeros(3)
        position, turn = np.zeros(3), np.zeros(4)
        mujoco.mju_negPose(offset, back, data.xpos[self._base], data.xquat[self._base])
        mujoco.mju_mulPose(position, turn, offset, back, pose.position, pose.quaternion)
        return ToolPose(position, turn)

    def solve(self, qpos: Any, position: Any, quaternion: Any | None) -> Any:
        """Return joint positions for a tool pose in the frame of the base.

        Uses only the model of the running simulation, so that any thread may call it; `qpos` is a
        copy of the current state.

        :raises DeviceRejected: there are none within the joints' ranges.
        """
        data = mujoco.MjData(self._model)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, data)
        target = self._in_world(data, position, quaternion)
        chance = np.random.default_rng(0)
        low, high = np.maximum(self._low, -np.pi), np.minimum(self._high, np.pi)
        for attempt in range(_RESTARTS + 1):
            if attempt:
                data.qpos[:] = qpos
                data.qpos[self._qpos] = chance.uniform(low, high)
            if self._descend(data, *target):
                return data.qpos[self._qpos].copy()
        raise DeviceRejected(_UNREACHED)

    def _in_world(self, data: Any, position: Any, quaternion: Any | None) -> tuple[Any, Any | None]:
        place, turn = np.zeros(3), np.zeros(4)
        base = (data.xpos[self._base], data.xquat[self._base])
        given = np.array([1.0, 0.0, 0.0, 0.0]) if quaternion is None else quaternion
        mujoco.mju_mulPose(place, turn, *base, position, given)
        return place, None if quaternion is None else turn

    def _descend(self, data: Any, position: Any, quaternion: Any | None) -> bool:
        model, dofs = self._model, self._dofs
        linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
        for _ in range(_ROUNDS):
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            off = position - data.site_xpos[self._site]
            turned = self._off(data, quaternion)
            if np.linalg.norm(off) < _NEAR and np.linalg.norm(turned) < _ALIGNED:
                return True
            mujoco.mj_jacSite(model, data, linear, angular, self._site)
            jacobian, error = linear[:, dofs], off
            if quaternion is not None:
                jacobian = np.vstack((jacobian, angular[:, dofs]))
                error = np.concatenate((off, turned))
            square = jacobian @ jacobian.T + _DAMPING**2 * np.eye(len(error))
            step = jacobian.T @ np.linalg.solve(square, error)
            step *= min(1.0, _STEP / max(1e-9, float(np.abs(step).max())))
            joints = data.qpos[self._qpos] + step
            data.qpos[self._qpos] = np.clip(joints, self._low, self._high)
        return False

    def _off(self, data: Any, quaternion: Any | None) -> Any:
        """Return the remaining rotation, rad about the axes of the world."""
        off = np.zeros(3)
        if quaternion is None:
            return off
        site, back, left = np.zeros(4), np.zeros(4), np.zeros(4)
        mujoco.mju_mat2Quat(site, data.site_xmat[self._site])
        mujoco.mju_negQuat(back, site)
        mujoco.mju_mulQuat(left, quaternion, back)
        mujoco.mju_quat2Vel(off, left, 1.0)
        return off
