"""Made-up recordings whose answer is known, to test statistics and selection against."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hts.channels import Channel
from hts.config import Command, ScheduleConfig
from hts.contracts import Comparison, Objective
from hts.evaluation.segments import Segments, cut
from hts.recordings.recording import Recording, Series

if TYPE_CHECKING:
    from torch import Tensor

COST = Channel("cost", "1", (), "what the known world charges for walking")


class CostObjective(Objective):
    """Lower `cost` is better; the improvement is the saved fraction of what is above idle."""

    name = "cost"
    unit = "1"
    inputs = ("base_velocity",)
    target = COST

    def reward(self, prediction: Tensor) -> Tensor:
        return -prediction

    def score(self, segments: Segments) -> Mapping[str, np.ndarray]:
        gross = segments.values("cost").mean(axis=1)
        return {"net_cost": gross - segments.idle("cost"), "gross_cost": gross}

    def compare(self, policy: Mapping[str, float], reference: Mapping[str, float]) -> Comparison:
        net = 1 - policy["net_cost"] / reference["net_cost"]
        return Comparison(net, net, {"gross_reduction": 1 - policy["gross_cost"] / reference["gross_cost"]})


def known_recording(
    cost: Sequence[float] | np.ndarray,
    *,
    speed: float | Sequence[float] | np.ndarray = 0.8,
    vx: float = 0.8,
    role: str = "policy",
    block: int = 0,
    session: str = "session-0",
    rate_hz: float = 10.0,
    idle: float = 0.0,
    fell_at: float | None = None,
    schedule: ScheduleConfig | None = None,
    start: float = 0.0,
) -> Recording:
    """A recording whose `cost` and forward speed are given per second (speed also as one number).

    fell_at: the trunk lies on its side from then on, s; start: first time stamp, s.
    """
    per_second = round(rate_hz)
    seconds = len(cost)
    samples = seconds * per_second
    velocity = np.zeros((samples, 3))
    velocity[:, 0] = np.repeat(np.broadcast_to(speed, (seconds,)), per_second)
    gravity = np.tile([0.0, 0.0, -1.0], (samples, 1))
    if fell_at is not None:
        gravity[round(fell_at * rate_hz) :] = [0.0, 1.0, 0.0]
    values = {"base_velocity": velocity, "projected_gravity": gravity, "cost": np.repeat(cost, per_second)}
    channels = {
        "base_velocity": Channel("base_velocity", "m/s", (3,)),
        "projected_gravity": Channel("projected_gravity", "1", (3,)),
        "cost": COST,
    }
    return Recording(
        robot="fake",
        world="known",
        policy_hash={"policy": "aa" * 32, "reference": "bb" * 32}.get(role, "cc" * 32),
        iteration=0,
        joint_names=("joint",),
        kp=(1.0,),
        kd=(0.1,),
        rate_hz=rate_hz,
        schedule=schedule or ScheduleConfig(commands=(Command(seconds=float(seconds), vx=vx),)),
        idle={"cost": idle},
        clock="simulated",
        time=start + np.arange(samples) / rate_hz,
        channels={name: Series(channels[name], values[name]) for name in channels},
        mass_kg=10.0,
        session=session,
        block=block,
        role=role,
        fell=fell_at is not None,
    )


def known_head_to_head(
    policy_cost: float,
    reference_cost: float,
    *,
    block_seconds: int = 40,
    order: str = "ABBA",
    scatter: float = 0.0,
    correlation: float = 0.0,
    drift: float = 0.0,
    seed: int = 0,
    vx: float = 0.8,
    idle: float = 0.0,
) -> list[Recording]:
    """Blocks of policy (A) and reference (B) in the given order, one after the other on one clock.

    The cost is the policy's own, times 1 + an AR(1) series of standard deviation `scatter` and lag-one `correlation`
    (per second, running on through all blocks), plus a linear drift of `drift` in all from first to last second.
    """
    from scipy.signal import lfilter

    total = block_seconds * len(order)
    shocks = np.random.default_rng(seed).standard_normal(total)
    shocks[1:] *= np.sqrt(1 - correlation**2)
    series = lfilter([1.0], [1.0, -correlation], shocks)
    drifting = drift * np.arange(total) / total
    recordings = []
    for block, letter in enumerate(order):
        part = slice(block * block_seconds, (block + 1) * block_seconds)
        cost = (policy_cost if letter == "A" else reference_cost) * (1 + scatter * series[part]) + drifting[part] + idle
        role = "policy" if letter == "A" else "reference"
        start = float(block * block_seconds)
        recordings.append(known_recording(cost, role=role, block=block, vx=vx, speed=vx, start=start, idle=idle))
    return recordings


def made_up_recording(
    sim: Mapping[str, Channel],
    real: Mapping[str, Channel],
    factors: Mapping[str, float] | None = None,
    *,
    seconds: float = 10.0,
    speed: float = 0.8,
    idle: float = 0.5,
    seed: int = 0,
    rate_hz: float = 50.0,
) -> Recording:
    """A straight walk of nobody in particular: random numbers in every channel, upright,
    at exactly the commanded speed.

    sim, real: channels by name; every value lies 0.5 to 1.5 above `idle` (real) or 0 (sim). factors: on what a real
    channel shows above idle.
    """
    rng = np.random.default_rng(seed)
    samples = round(seconds * rate_hz)
    values: dict[str, np.ndarray] = {}
    for name, channel in {**sim, **real}.items():
        values[name] = 0.5 + rng.random((samples, *channel.shape))
        if name in real:
            values[name] = idle + values[name] * (factors or {}).get(name, 1.0)
    values["base_velocity"] = np.tile([speed, 0.0, 0.0], (samples, 1))
    values["projected_gravity"] = np.tile([0.0, 0.0, -1.0], (samples, 1))
    known = {"base_velocity": Channel("base_velocity", "m/s", (3,)), **sim, **real}
    known.setdefault("projected_gravity", Channel("projected_gravity", "1", (3,)))
    return Recording(
        robot="nobody",
        world="made-up",
        policy_hash=f"{seed:02x}" * 32,
        iteration=0,
        joint_names=("joint",),
        kp=(1.0,),
        kd=(0.1,),
        rate_hz=rate_hz,
        schedule=ScheduleConfig(commands=(Command(seconds=seconds, vx=speed),)),
        idle=dict.fromkeys(real, idle),
        clock="simulated",
        time=np.arange(samples) / rate_hz,
        channels={name: Series(known[name], array) for name, array in values.items()},
        mass_kg=10.0,
    )


def known_segments(levels: Mapping[Channel, float], idle: float = 0.0, seconds: float = 10.0) -> Segments:
    """Segments of a walk in which real channels show constant levels, in their units:
    what a score should be, on paper. Raises TypeError for names in the place of channels."""
    named = next((one for one in levels if not isinstance(one, Channel)), None)
    if named is not None:
        raise TypeError(f"known_segments: found {named!r}, expected a Channel as key, such as the objective's target.")
    real = {channel.name: channel for channel in levels}
    recording = made_up_recording({}, real, idle=idle, seconds=seconds)
    series = {
        channel.name: Series(channel, np.full((recording.num_samples, *channel.shape), level))
        for channel, level in levels.items()
    }
    return cut([recording.replace(channels={**recording.channels, **series})])
