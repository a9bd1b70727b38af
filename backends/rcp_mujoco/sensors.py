"""The model's sensors as typed values; related sensors form one resource."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from rcp_kernel.clock import iso
from rcp_kernel.types import (
    AngularVelocity,
    LaserScan,
    LinearAcceleration,
    Point,
    PoseStamped,
    Quaternion,
    quantity,
)
from rcp_mujoco.bindings import mujoco
from rcp_mujoco.joints import distinct, plain
from rcp_mujoco.messages import Force, Imu, Torque, Wrench

__all__ = ["Reading", "Sensors"]

_Kind = mujoco.mjtSensor
_FLAT = 1e-3  # component of a beam's direction out of the plane
_EVEN = 1e-3  # rad, tolerance of the angle between beams
_FEW = 3  # minimum number of beams of a scan
_UNITS: dict[Any, str] = {
    _Kind.mjSENS_TOUCH: "N",
    _Kind.mjSENS_RANGEFINDER: "m",
    _Kind.mjSENS_VELOCIMETER: "m/s",
    _Kind.mjSENS_ACCELEROMETER: "m/s2",
    _Kind.mjSENS_GYRO: "rad/s",
    _Kind.mjSENS_FORCE: "N",
    _Kind.mjSENS_TORQUE: "N.m",
    _Kind.mjSENS_MAGNETOMETER: "T",
    _Kind.mjSENS_FRAMEPOS: "m",
    _Kind.mjSENS_FRAMELINVEL: "m/s",
    _Kind.mjSENS_FRAMEANGVEL: "rad/s",
    _Kind.mjSENS_FRAMELINACC: "m/s2",
    _Kind.mjSENS_FRAMEANGACC: "rad/s2",
    _Kind.mjSENS_SUBTREECOM: "m",
    _Kind.mjSENS_SUBTREELINVEL: "m/s",
    _Kind.mjSENS_CLOCK: "s",
    _Kind.mjSENS_E_KINETIC: "J",
    _Kind.mjSENS_E_POTENTIAL: "J",
}
_BY_JOINT = {
    _Kind.mjSENS_JOINTPOS: ("rad", "m"),
    _Kind.mjSENS_JOINTVEL: ("rad/s", "m/s"),
    _Kind.mjSENS_JOINTACTFRC: ("N.m", "N"),
    _Kind.mjSENS_JOINTLIMITPOS: ("rad", "m"),
    _Kind.mjSENS_JOINTLIMITVEL: ("rad/s", "m/s"),
    _Kind.mjSENS_JOINTLIMITFRC: ("N.m", "N"),
}
_BY_ACTUATOR = {  # of its own length: without a gear these are the joint's
    _Kind.mjSENS_ACTUATORPOS: ("rad", "m"),
    _Kind.mjSENS_ACTUATORVEL: ("rad/s", "m/s"),
    _Kind.mjSENS_ACTUATORFRC: ("N.m", "N"),
}


class Reading(NamedTuple):
    """One resource read from sensors of the model."""

    name: str
    description: str
    value: Any
    """Its type."""
    read: Callable[[int], Any]
    """Returns its value; the argument is the time of the value, ns."""
    is_scan: bool = False


class _Sensor(NamedTuple):
    """A sensor of the model."""

    name: str
    kind: Any
    on: tuple[int, int]
    """Type and index of the object it is attached to."""
    at: slice
    cutoff: float


class Sensors:
    """Groups the sensors of a model, and reads them with noise."""

    def __init__(self, model: Any, data: Any, seed: int) -> None:
        self._model, self._data = model, data
        self._noise = np.repeat(model.sensor_noise, model.sensor_dim)
        self._noisy = bool(self._noise.any())
        self.seed(seed)
        self.readings: list[Reading] = []
        self._taken: set[str] = set()
        left = {sensor.name: sensor for sensor in map(self._sensor, range(model.nsensor))}
        for group in (self._imus, self._scans, self._poses, self._wrenches, self._contacts):
            for reading, used in group(list(left.values())):
                self.readings.append(reading)
                for sensor in used:
                    del left[sensor.name]
        self.readings += map(self._plain, left.values())

    def seed(self, seed: int) -> None:
        """Restart the noise."""
        self._random = np.random.default_rng(seed)
        self._heard_at = -1.0
        self._heard = self._data.sensordata

    @property
    def values(self) -> Any:
        """The measurements of the last step; the same ones until the next step."""
        if not self._noisy:
            return self._data.sensordata
        if self._heard_at != self._data.time:
            self._heard_at = self._data.time
            noise = self._random.standard_normal(len(self._noise)) * self._noise
            self._heard = self._data.sensordata + noise
        return self._heard

    def _sensor(self, index: int) -> _Sensor:
        model = self._model
        first, count = int(model.sensor_adr[index]), int(model.sensor_dim[index])
        return _Sensor(
            distinct(plain(model.sensor(index).name) or f"sensor_{index}", self._taken),
            _Kind(model.sensor_type[index]),
            (int(model.sensor_objtype[index]), int(model.sensor_objid[index])),
            slice(first, first + count),
            float(model.sensor_cutoff[index]),
        )

    def _named(self, on: tuple[int, int]) -> str:
        return plain(mujoco.mj_id2name(self._model, on[0], on[1]) or f"object_{on[1]}")

    # Groups

    def _imus(self, sensors: Sequence[_Sensor]) -> list[tuple[Reading, list[_Sensor]]]:
        gyros = {s.on: s for s in sensors if s.kind == _Kind.mjSENS_GYRO}
        quats = {s.on: s for s in sensors if s.kind == _Kind.mjSENS_FRAMEQUAT}
        pairs = [
            (s, gyros[s.on], quats.get(s.on))
            for s in sensors
            if s.kind == _Kind.mjSENS_ACCELEROMETER and s.on in gyros
        ]
        found: list[tuple[Reading, list[_Sensor]]] = []
        for accelerometer, gyro, quat in pairs:
            site = self._named(accelerometer.on)
            name = "sensor/imu" if len(pairs) == 1 else f"sensor/imu/{site}"

            def read(
                now: int, a: _Sensor = accelerometer, g: _Sensor = gyro, q: _Sensor | None = quat
            ) -> Imu:
                values = self.values
                return Imu(
                    AngularVelocity(*values[g.at].tolist()),
                    LinearAcceleration(*values[a.at].tolist()),
                    None if q is None else quaternion(values[q.at].tolist()),
                    self._named(a.on),
                    iso(now),
                )

            text = f"Angular rate and acceleration at '{site}', in its frame."
            used = [accelerometer, gyro, *([quat] if quat else [])]
            found.append((Reading(name, text, Imu, read), used))
        return found

    def _scans(self, sensors: Sequence[_Sensor]) -> list[tuple[Reading, list[_Sensor]]]:
        by_body: dict[int, list[tuple[float, _Sensor]]] = {}
        for sensor in sensors:
            if sensor.kind != _Kind.mjSENS_RANGEFINDER or sensor.at.stop - sensor.at.start != 1:
                continue
            if sensor.on[0] != int(mujoco.mjtObj.mjOBJ_SITE):
                continue
            angle = self._bearing(sensor.on[1])
            if angle is not None:
                body = int(self._model.site_bodyid[sensor.on[1]])
                by_body.setdefault(body, []).append((angle, sensor))
        fans = {b: sorted(beams, key=lambda beam: beam[0]) for b, beams in by_body.items()}
        fans = {body: beams for body, beams in fans.items() if _is_even(beams)}
        return [
            (self._scan(body, beams, alone=len(fans) == 1), [sensor for _, sensor in beams])
            for body, beams in fans.items()
        ]

    def _bearing(self, site: int) -> float | None:
        """Return the direction of a beam in the plane of its body; None if it is not in the plane."""
        axis = np.zeros(3)
        mujoco.mju_rotVecQuat(axis, np.array([0.0, 0.0, 1.0]), self._model.site_quat[site])
        return None if abs(axis[2]) > _FLAT else math.atan2(axis[1], axis[0])

    def _scan(self, body: int, beams: list[tuple[float, _Sensor]], *, alone: bool) -> Reading:
        frame = plain(self._model.body(body).name) or "laser"
        order = np.array([sensor.at.start for _, sensor in beams])
        cutoff = beams[0][1].cutoff or math.inf
        reach = cutoff if math.isfinite(cutoff) else 1000.0
        first, step = beams[0][0], (beams[-1][0] - beams[0][0]) / (len(beams) - 1)

        def read(now: int) -> LaserScan:
            ranges = self.values[order]
            exact = self._data.sensordata[order]
            none = (exact < 0) | (exact >= cutoff)
            ranges = np.where(none, np.inf, np.maximum(ranges, 0.0))
            return LaserScan(first, step, 0.0, reach, ranges.tolist(), frame, iso(now))

        name = "sensor/scan" if alone else f"sensor/scan/{frame}"
        text = "One sweep of the range finder; a beam without a return is Infinity."
        return Reading(name, text, LaserScan, read, is_scan=True)

    def _poses(self, sensors: Sequence[_Sensor]) -> list[tuple[Reading, list[_Sensor]]]:
        quats = {s.on: s for s in sensors if s.kind == _Kind.mjSENS_FRAMEQUAT}
        found: list[tuple[Reading, list[_Sensor]]] = []
        for place in sensors:
            if place.kind != _Kind.mjSENS_FRAMEPOS or place.on not in quats:
                continue
            turn = quats[place.on]
            name = self._named(place.on)

            def read(now: int, p: slice = place.at, q: slice = turn.at) -> PoseStamped:
                values = self.values
                return PoseStamped(
                    Point(*values[p].tolist()), quaternion(values[q].tolist()), "map", iso(now)
                )

            text = f"Position and orientation of '{name}' in the world."
            reading = Reading(f"sensor/pose/{name}", text, PoseStamped, read)
            found.append((reading, [place, turn]))
        return found

    def _wrenches(self, sensors: Sequence[_Sensor]) -> list[tuple[Reading, list[_Sensor]]]:
        torques = {s.on: s for s in sensors if s.kind == _Kind.mjSENS_TORQUE}
        found: list[tuple[Reading, list[_Sensor]]] = []
        for force in sensors:
            if force.kind != _Kind.mjSENS_FORCE or force.on not in torques:
                continue
            torque, site = torques[force.on], self._named(force.on)

            def read(
                now: int, f: slice = force.at, t: slice = torque.at, site: str = site
            ) -> Wrench:
                values = self.values
                return Wrench(
                    Force(*values[f].tolist()), Torque(*values[t].tolist()), site, iso(now)
                )

            text = f"Force and torque at '{site}', in its frame."
            found.append((Reading(f"sensor/wrench/{site}", text, Wrench, read), [force, torque]))
        return found

    def _contacts(self, sensors: Sequence[_Sensor]) -> list[tuple[Reading, list[_Sensor]]]:
        return [
            (self._plain(sensor, f"sensor/contact/{sensor.name}", "Contact force on"), [sensor])
            for sensor in sensors
            if sensor.kind == _Kind.mjSENS_TOUCH
        ]

    def _plain(self, sensor: _Sensor, name: str | None = None, what: str = "Sensor") -> Reading:
        type_: Any = quantity(self._unit(sensor), may_be_nonfinite=True)
        at, first = sensor.at, sensor.at.start
        text = f"{what} '{sensor.name}' of the model."
        name = name or f"sensor/{sensor.name}"
        if at.stop - first == 1:
            return Reading(name, text, type_, lambda _: float(self.values[first]))
        return Reading(name, text, list[type_], lambda _: self.values[at].tolist())

    def _unit(self, sensor: _Sensor) -> str:
        if sensor.kind in _BY_JOINT:
            return _BY_JOINT[sensor.kind][self._slides(sensor.on[1])]
        if sensor.kind in _BY_ACTUATOR:
            return self._unit_of_actuator(sensor)
        return _UNITS.get(sensor.kind, "1")

    def _unit_of_actuator(self, sensor: _Sensor) -> str:
        model, index = self._model, sensor.on[1]
        on_joint = model.actuator_trntype[index] == int(mujoco.mjtTrn.mjTRN_JOINT)
        if not on_joint or abs(model.actuator_gear[index][0]) != 1.0:
            return "1"
        slides = self._slides(int(model.actuator_trnid[index][0]))
        return _BY_ACTUATOR[sensor.kind][slides]

    def _slides(self, joint: int) -> bool:
        return bool(self._model.jnt_type[joint] == int(mujoco.mjtJoint.mjJNT_SLIDE))


def quaternion(wxyz: Sequence[float]) -> Quaternion:
    """Convert MuJoCo's quaternion, which starts with w."""
    w, x, y, z = wxyz
    return Quaternion(x, y, z, w)


def _is_even(beams: list[tuple[float, _Sensor]]) -> bool:
    if len(beams) < _FEW:
        return False
    step = (beams[-1][0] - beams[0][0]) / (len(beams) - 1)
    angles = [angle for angle, _ in beams]
    return all(abs(b - a - step) < _EVEN for a, b in itertools.pairwise(angles))
