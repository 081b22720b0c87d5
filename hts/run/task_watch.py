"""Is the task still done? The scale of λ from the first batch of fine-tuning, and elites that gave their task up.

λ is in task reward per second for one unit of the measured reward, so what is a small λ for one task is a huge one for
another. In the first batch every candidate still acts as its anchor, and there one sees how far both rewards spread
from step to step. λ = spread of the task's / spread of the measured one makes them weigh the same.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from typing import Any

from hts.policy_ids import PRETRAINED

TASK = "spread/task"
MEASURED = "spread/"
FAR = 10.0
"""A λ beyond that many times the equal one is worth a line before the candidates are tried."""
SHARES = (0.1, 0.3, 1.0)
"""Suggested λ, as shares of the equal one: the measured reward a nudge, a voice, a vote."""
GAVE_UP = 0.5
"""Below that share of the pretrained policy's task reward a candidate no longer does its task."""

Row = Mapping[str, Any]


def reward_scale(rows: Sequence[Row], objectives: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Per objective: spread of the task's reward and of the measured one, both per second, the λ at which they weigh
    the same, and suggested λ. rows: the candidates of finetune.json; medians over those that have a first batch."""
    first = [row["curve"][0] for row in rows if row.get("curve") and TASK in row["curve"][0]]
    scale = {}
    for name in objectives:
        pairs = [(one[TASK], one[MEASURED + name]) for one in first if MEASURED + name in one]
        pairs = [pair for pair in pairs if all(part is not None and math.isfinite(part) and part > 0 for part in pair)]
        if pairs:
            task, measured = (statistics.median(column) for column in zip(*pairs, strict=True))
            equal = task / measured
            scale[name] = {
                "task_spread": task,
                "measured_spread": measured,
                "equal_weight": equal,
                "suggested": [float(f"{share * equal:.2g}") for share in SHARES],
            }
    return scale


def scale_lines(scale: Mapping[str, Row], rows: Sequence[Row]) -> list[str]:
    """One line for each objective whose λ are far above that at which both rewards weigh the same."""
    lines = []
    for name, found in scale.items():
        tried = sorted({row["weights"].get(name, 0.0) for row in rows} - {0.0})
        if tried and tried[-1] > FAR * found["equal_weight"]:
            lines.append(
                f"λ of '{name}' may be too large for this task: in the first batch the task's reward spreads by "
                f"{found['task_spread']:.2g} per second and the measured one by {found['measured_spread']:.2g}, so "
                f"they weigh the same at λ = {found['equal_weight']:.2g}; tried: {_numbers(tried)}. Suggested: "
                f"{_setting(name, found)}"
            )
    return lines


def gave_up(elites: Sequence[str], simulated: Row) -> list[str]:
    """Elites that do not do their task in simulation, or earn less than half of the pretrained policy's task reward.

    Nobody where the pretrained policy itself does not do it by that test: then λ is not to blame.
    simulated: simulate.json.
    """
    if not simulated.get("pretrained_tracked"):
        return []
    rewards = simulated.get("task_rewards") or {}
    before = rewards.get(PRETRAINED)

    def earns_less(name: str) -> bool:
        now = rewards.get(name)
        return now is not None and before is not None and before > 0 and now < GAVE_UP * before

    return [name for name in elites if not simulated["tracked"][name] or earns_less(name)]


def gave_up_line(
    elites: Sequence[str], simulated: Row, scale: Mapping[str, Row], quantity: str, unit: str
) -> str | None:
    """One line about elites that gave their task up; None if there are none. quantity, unit: of the robot's task."""
    names = gave_up(elites, simulated)
    if not names:
        return None
    name, rewards = names[0], simulated["task_rewards"]
    means = [trial.get("mean_speed") for trial in simulated["trials"][name]]
    known = [mean for mean in means if mean is not None]
    achieved = f"{quantity} {_numbers(known)}{'' if unit == '1' else ' ' + unit}" if known else "every trial fell"
    reward = f"{_number(rewards[name])} of the pretrained policy's {_number(rewards[PRETRAINED])} per second"
    advice = "; ".join(
        f"both rewards of '{key}' weigh the same at λ = {found['equal_weight']:.2g}, try {_setting(key, found)}"
        for key, found in scale.items()
    )
    return (
        f"{len(names)} of {len(elites)} elites stopped doing the task in simulation ({name}: {achieved}, task reward "
        f"{reward}): what they save they save by that. Smaller λ or KL bounds keep the task"
        + (f": {advice}" if advice else ": --set sweep.weights.NAME=[…], --set sweep.kl_bounds=[…]")
    )


def _setting(name: str, found: Row) -> str:
    return f"--set sweep.weights.{name}=[{','.join(f'{one:g}' for one in found['suggested'])}]"


def _numbers(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.3g}" for value in values)


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2g}"
