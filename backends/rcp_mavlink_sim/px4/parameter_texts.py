"""What the parameters of the simulated PX4 mean, in our own words."""

from __future__ import annotations

import msgspec

__all__ = ["GROUPS", "TEXTS", "Text"]


class Text(msgspec.Struct, frozen=True):
    """The meaning of one parameter."""

    text: str
    unit: str | None = None
    least: float | None = None
    most: float | None = None
    values: dict[int, str] = {}


GROUPS = {
    "BAT": "Battery Calibration", "CAL_": "Sensor Calibration", "COM_": "Commander", "EKF2_": "EKF2",
    "FLW_": "Follow target", "GF_": "Geofence", "LND_": "Land Detector", "MAV_": "MAVLink",
    "MC_": "Multicopter Attitude Control", "MIS_": "Mission", "MNT_": "Mount",
    "MPC_": "Multicopter Position Control", "NAV_": "Navigator", "RC_": "Radio Calibration",
    "RTL_": "Return Mode", "SDLOG_": "SD Logging", "SYS_": "System", "UAVCAN_": "UAVCAN",
}  # fmt: skip
"""By the beginnings of their names."""
_ACTIONS = {0: "None", 1: "Warning", 2: "Hold mode", 3: "Return mode", 4: "Terminate", 5: "Land mode"}  # fmt: skip
TEXTS: dict[str, Text] = {
    "BAT1_CAPACITY": Text("Charge that the full battery 1 holds", "mAh", -1, 100_000),
    "BAT1_N_CELLS": Text("Cells in series of battery 1"),
    "BAT1_V_CHARGED": Text("Voltage of a full cell without load", "V"),
    "BAT1_V_EMPTY": Text("Voltage of an empty cell under load", "V"),
    "BAT_CRIT_THR": Text("Charge below which the battery is critical", "norm", 0.05, 0.5),
    "BAT_EMERGEN_THR": Text("Charge below which the battery is an emergency", "norm", 0.03, 0.5),
    "BAT_LOW_THR": Text("Charge below which the battery is low", "norm", 0.12, 0.5),
    "COM_DISARM_LAND": Text("Time after a landing until the motors stop", "s"),
    "COM_DISARM_PRFLT": Text("Time on the ground after arming until the motors stop", "s"),
    "COM_DL_LOSS_T": Text("Silence after which the ground station counts as lost", "s", 5, 300),
    "COM_LOW_BAT_ACT": Text("What a low battery causes", values={0: "Warning", 2: "Land mode", 3: "Return at critical level, land at emergency level"}),
    "COM_OF_LOSS_T": Text("Silence after which set-points count as lost", "s", 0, 60),
    "COM_RC_LOSS_T": Text("Silence after which the sticks count as lost", "s", 0, 35),
    "FLW_TGT_DST": Text("Distance from the target that it follows", "m", 1),
    "FLW_TGT_FA": Text("Side of the target on which it stays, from its course", "deg", -180, 180),
    "FLW_TGT_HT": Text("Height at which it follows", "m", 8),
    "GF_ACTION": Text("What leaving the geofence causes", values=_ACTIONS),
    "GF_MAX_HOR_DIST": Text("Farthest from home, 0 for no limit", "m", 0, 10_000),
    "GF_MAX_VER_DIST": Text("Highest above home, 0 for no limit", "m", 0, 10_000),
    "MIS_DIST_1WP": Text("Farthest first waypoint of a mission", "m", -1, 100_000),
    "MIS_TAKEOFF_ALT": Text("Height of a take-off that names none", "m", 0, 80),
    "MPC_ACC_HOR": Text("Acceleration to the sides", "m/s^2", 2, 15),
    "MPC_JERK_AUTO": Text("Change of the acceleration in modes that fly by themselves", "m/s^3", 1, 80),
    "MPC_LAND_SPEED": Text("Speed of the last metres of a landing", "m/s", 0.6),
    "MPC_THR_HOVER": Text("Thrust that holds the height", "norm", 0.1, 0.8),
    "MPC_TILTMAX_AIR": Text("Most that it leans in the air", "deg", 20, 89),
    "MPC_TKO_SPEED": Text("Speed of a take-off", "m/s", 1, 5),
    "MPC_XY_CRUISE": Text("Usual speed over the ground in modes that fly by themselves", "m/s", 3, 20),
    "MPC_XY_VEL_MAX": Text("Highest speed over the ground", "m/s", 0, 20),
    "MPC_Z_VEL_MAX_DN": Text("Fastest descent", "m/s", 0.5, 4),
    "MPC_Z_VEL_MAX_UP": Text("Fastest climb", "m/s", 0.5, 8),
    "NAV_ACC_RAD": Text("Distance at which a waypoint counts as reached", "m", 0.05, 200),
    "NAV_DLL_ACT": Text("What the loss of the ground station causes", values={0: "Disabled", 1: "Hold mode", 2: "Return mode", 3: "Land mode", 5: "Terminate"}),
    "NAV_LOITER_RAD": Text("Radius of a circle that it waits on", "m", 25, 1000),
    "RTL_DESCEND_ALT": Text("Height above home at which the return waits before it lands", "m", 0),
    "RTL_LAND_DELAY": Text("Time that the return waits before it lands, -1 without end", "s", -1, 300),
    "RTL_RETURN_ALT": Text("Height above home of the return", "m", 0),
}  # fmt: skip
