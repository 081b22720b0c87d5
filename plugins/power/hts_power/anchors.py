"""What is publicly known of a robot's battery power, without anything about fine-tuned policies.

idle share   of gross battery power with the policy to start from: 0.310, 0.248, 0.198 at 0.5, 0.8, 1.1 m/s
             (Table I of arXiv 2502.10956: gross and net reductions give 1 - P_idle/P_gross)
standing     53 to 65 W (manual 1.4 "about 1 h" from 133 Wh at most down to 2.5 h; statics give 49-62 (N m)^2)
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hts.contracts import Fact, Reading

ROBOT = "go1"
IDLE_SHARE = {0.5: 0.310, 0.8: 0.248, 1.1: 0.198}
STANDING_WATTS = (53.0, 65.0)
PLAUSIBLE = 0.25  # a reality's idle share may be off by this; rows of the table themselves differ by about 10 %


def facts(robot: str) -> tuple[Fact, ...]:
    """Those of this robot; none if nothing is known of it."""
    if robot != ROBOT:
        return ()
    table = "Table I of arXiv 2502.10956"
    shares = tuple(
        Fact(
            f"idle share at {speed:g} m/s",
            speed,
            (1 - PLAUSIBLE) * share,
            (1 + PLAUSIBLE) * share,
            "1",
            table,
            idle_share,
        )
        for speed, share in IDLE_SHARE.items()
    )
    return (Fact("standing", 0.0, *STANDING_WATTS, "W", "manual 1.4, statics", gross_power), *shares)


def gross_power(channels: Mapping[str, np.ndarray], idle: Mapping[str, float]) -> float:
    """Mean of current times voltage as the gauge shows them, W."""
    return float((channels["battery_current"].astype(float) * channels["battery_voltage"]).mean())


def idle_power(channels: Mapping[str, np.ndarray], idle: Mapping[str, float]) -> float:
    """Idle current times idle voltage, W."""
    return idle["battery_current"] * idle["battery_voltage"]


def net_power(channels: Mapping[str, np.ndarray], idle: Mapping[str, float]) -> float:
    """Gross less idle, W."""
    return gross_power(channels, idle) - idle_power(channels, idle)


GAUGED = ("battery_current", "battery_voltage")
READINGS = (
    Reading("idle power", "W", GAUGED, idle_power, idle=True),
    Reading("gross power", "W", GAUGED, gross_power),
    Reading("net power", "W", GAUGED, net_power),
)
"""What a lab's own recordings show of its robot's battery."""


def idle_share(channels: Mapping[str, np.ndarray], idle: Mapping[str, float]) -> float:
    return idle["battery_current"] * idle["battery_voltage"] / gross_power(channels, idle)
