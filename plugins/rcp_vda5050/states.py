"""What a robot says, in the words of each version: state, visualization, connection."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from msgspec import Struct

from rcp_vda5050.config import RobotConfig
from rcp_vda5050.faults import Fault
from rcp_vda5050.orders import Leg
from rcp_vda5050.performer import ActionState
from rcp_vda5050.work import Work

__all__ = ["Headers", "Senses", "connection", "state", "visualization"]

_FULL = {"2.1": "2.1.0", "3.0": "3.0.0"}


class Senses(Struct):
    """What the robot's sensors told last."""

    x: float | None = None
    y: float | None = None
    theta: float = 0.0
    vx: float | None = None
    vy: float = 0.0
    omega: float = 0.0
    charge: float | None = None
    """0 to 1."""
    has_battery: bool = False
    voltage: float | None = None
    charging: bool = False
    stopped: bool = False
    """Whether an e-stop is latched."""
    mode: str = "AUTOMATIC"

    @property
    def here(self) -> tuple[float, float] | None:
        """The position."""
        return None if self.x is None or self.y is None else (self.x, self.y)

    def pose(self, value: Mapping[str, Any] | None) -> None:
        """Take a PoseStamped; None: it is not known."""
        self.x = self.y = None
        if value is None:
            return
        position, q = value["position"], value.get("orientation") or {}
        x, y, z = (_finite(q.get(name, 0.0)) for name in "xyz")
        w = _finite(q.get("w", 1.0))
        self.theta = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        self.x, self.y = _finite(position["x"]), _finite(position["y"])

    def velocity(self, value: Mapping[str, Any] | None) -> None:
        """Take a Twist."""
        self.vx = None
        if value is None:
            return
        linear, angular = value["linear"], value.get("angular") or {}
        self.vy, self.omega = _finite(linear.get("y", 0.0)), _finite(angular.get("z", 0.0))
        self.vx = _finite(linear["x"])

    def battery(self, value: Mapping[str, Any] | None) -> None:
        """Take a BatteryState; a charge that is not known stays as it was."""
        if value is None:
            return
        self.has_battery = True
        if value.get("percentage") is not None:
            self.charge = _finite(value["percentage"])
        voltage = value.get("voltage")
        self.voltage = None if voltage is None else _finite(voltage)
        self.charging = bool(value.get("charging"))

    @property
    def percent(self) -> float:
        """The charge; without a battery that is full, with one that does not tell it empty."""
        if self.charge is not None:
            return round(100 * min(1.0, max(0.0, self.charge)), 1)
        return 0.0 if self.has_battery else 100.0


def _finite(value: Any) -> float:
    """Return a number.

    :raises ValueError: it is none, or not finite.
    """
    found = float(value)
    if not math.isfinite(found):
        raise ValueError(f"{found} is not finite")
    return found


class Headers:
    """Counts the messages of each topic of one robot."""

    def __init__(self, config: RobotConfig) -> None:
        self._config = config
        self._counts: dict[str, itertools.count[int]] = {}
        self._last_state = 0

    def header(self, topic: str) -> dict[str, Any]:
        """Return the header of the next message."""
        count = self._counts.setdefault(topic, itertools.count())
        now = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
        found: dict[str, Any] = {
            "headerId": next(count) & 0xFFFFFFFF,
            "timestamp": now,
            "version": _FULL[self._config.version],
            "manufacturer": self._config.manufacturer,
            "serialNumber": self._config.serial,
        }
        if topic == "state":
            self._last_state = found["headerId"]
        elif topic == "visualization" and self._config.version == "3.0":
            found["referenceStateHeaderId"] = self._last_state
        return found


def connection(how: str) -> dict[str, Any]:
    """Return the body of `connection`."""
    return {"connectionState": how}


def visualization(config: RobotConfig, senses: Senses) -> dict[str, Any]:
    """Return the body of `visualization`."""
    return _where(config, senses)


def state(
    config: RobotConfig, senses: Senses, work: Work, faults: Sequence[Fault]
) -> dict[str, Any]:
    """Return the body of `state`."""
    newer = config.version == "3.0"
    book = work.book
    stop = "NONE"
    if senses.stopped:
        stop = "REMOTE"
    safety = {"activeEmergencyStop" if newer else "eStop": stop, "fieldViolation": False}
    power: dict[str, Any] = {
        "stateOfCharge" if newer else "batteryCharge": senses.percent,
        "charging": senses.charging,
    }
    if senses.voltage is not None:
        power["batteryVoltage"] = senses.voltage
    states = list(work.states.values())
    instant = list(work.instant.values())
    found: dict[str, Any] = {
        "maps": [{"mapId": config.map, "mapVersion": config.map_version, "mapStatus": "ENABLED"}],
        "orderId": book.order_id,
        "orderUpdateId": book.update_id,
        "lastNodeId": book.last_node,
        "lastNodeSequenceId": book.last_sequence,
        "nodeStates": [_node(leg) for leg in book.legs],
        "edgeStates": [_edge(leg) for leg in book.legs if leg.edge is not None],
        "driving": work.driving,
        "paused": work.paused,
        "newBaseRequest": book.base_ends,
        "actionStates": [
            _action(each, newer=newer) for each in (states if newer else states + instant)
        ],
        "operatingMode": senses.mode,
        "errors": [fault.written(config.version) for fault in faults],
        "information": [],
        "safetyState": safety,
        "powerSupply" if newer else "batteryState": power,
    }
    if newer:
        found["instantActionStates"] = [_action(each, newer=True) for each in instant]
        found["zoneActionStates"] = [
            _action(each, newer=True) for each in work.zone_actions.states.values()
        ]
        found["zoneSets"] = work.zones.sets.listed()
        found["zoneRequests"] = work.zones.releases.listed()
        found["edgeRequests"] = []
    return found | _where(config, senses)


def _where(config: RobotConfig, senses: Senses) -> dict[str, Any]:
    found: dict[str, Any] = {}
    newer = config.version == "3.0"
    if senses.here is not None:
        found["mobileRobotPosition" if newer else "agvPosition"] = {
            "x": senses.x,
            "y": senses.y,
            "theta": senses.theta,
            "mapId": config.map,
            "localized" if newer else "positionInitialized": True,
        }
    if senses.vx is not None:
        found["velocity"] = {"vx": senses.vx, "vy": senses.vy, "omega": senses.omega}
    return found


def _node(leg: Leg) -> dict[str, Any]:
    node = leg.node
    found: dict[str, Any] = {
        "nodeId": node.node_id,
        "sequenceId": node.sequence_id,
        "released": node.released,
    }
    if (at := node.node_position) is not None:
        found["nodePosition"] = {"x": at.x, "y": at.y, "mapId": at.map_id}
        if at.theta is not None:
            found["nodePosition"]["theta"] = at.theta
    return found


def _edge(leg: Leg) -> dict[str, Any]:
    assert leg.edge is not None
    edge = leg.edge
    return {"edgeId": edge.edge_id, "sequenceId": edge.sequence_id, "released": edge.released}


def _action(each: ActionState, *, newer: bool) -> dict[str, Any]:
    found = {
        "actionId": each.action.action_id,
        "actionType": each.action.action_type,
        "actionStatus": each.status,
    }
    key = "actionResult" if newer else "resultDescription"
    return found | ({key: each.result} if each.result else {})
