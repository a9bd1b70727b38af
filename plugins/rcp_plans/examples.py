"""Example plans for discovery, one in each notation."""

from __future__ import annotations

from typing import Any

__all__ = ["EXAMPLES"]

EXAMPLES: tuple[dict[str, Any], ...] = (
    {
        "steps": [
            {"do": "read", "path": "/sensor/pose", "id": "start"},
            {
                "do": "execute",
                "path": "/action/move_to",
                "value": {"position": {"x": 1.0, "y": 2.0}},
                "deadline": 60,
                "retry": {"times": 2, "delay": 1},
                "fallback": [
                    {
                        "do": "execute",
                        "path": "/action/move_to",
                        "value": {"position": {"$result": "start/position"}},
                    }
                ],
            },
            {"do": "wait", "until": "sensor.battery.percentage > 0.2", "deadline": 10},
        ]
    },
    {"symbolic": "(move_to alpha 1.0 2.0)\n(dock alpha)"},
    {"lines": "write /param/speed_limit 0.5\nexecute /action/dock"},
)
