"""`hts bench fit`: how many samples per second a measurement model learns from."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import torch

from hts.bench.setup import find
from hts.config import Command, ScheduleConfig
from hts.contracts import Objective, Robot
from hts.measurement.fit import fit
from hts.recordings.recording import Recording, Series

RECORDINGS, SECONDS_EACH = 5, 60.0


def bench_fit(robot: str | None, objective: str | None, seconds: float = 10.0) -> dict[str, Any]:
    """Fitting to made-up recordings of the robot's channels, for at least `seconds`. Keys: samples_per_s (samples
    times epochs over seconds, validation included), samples, epochs, …"""
    machine, chosen = find(robot, objective)
    recordings = [made_up(chosen, machine, seed) for seed in range(RECORDINGS)]
    config = chosen.measurement_model()
    fit(config, recordings[:1], epochs=1)  # the first call also pays for loading libraries
    start = time.perf_counter()
    report = fit(config, recordings, epochs=10_000, patience=10_000, max_seconds=seconds).report
    spent = time.perf_counter() - start
    return {
        "bench": "fit", "samples_per_s": report["samples"] * report["epochs"] / spent, "samples": report["samples"],
        "epochs": report["epochs"], "seconds": spent, "robot": machine.spec.name, "objective": chosen.name,
        "hidden": config.hidden, "recordings": "made up: slow sines and noise on the robot's channels",
        "torch": str(torch.__version__),
    }  # fmt: skip


def made_up(objective: Objective, robot: Robot, seed: int) -> Recording:
    """A recording of the right shape: each input a sine with noise, the target the mean square of all of them."""
    rng, rate = np.random.default_rng(seed), robot.spec.control_rate_hz
    time_axis = np.arange(round(SECONDS_EACH * rate)) / rate
    known, channels, sums = robot.channels(), {}, np.zeros(len(time_axis))
    for name in objective.inputs:
        size = known[name].shape
        phase, hertz = rng.uniform(0, 2 * np.pi, size), rng.uniform(0.5, 3.0, size)
        angle = 2 * np.pi * hertz * time_axis.reshape(-1, *(1,) * len(size)) + phase
        values = np.sin(angle) + 0.1 * rng.standard_normal(angle.shape)
        channels[name] = Series(known[name], values)
        sums += np.square(values).reshape(len(time_axis), -1).mean(1)
    channels[objective.target.name] = Series(objective.target, sums.reshape(-1, *objective.target.shape))
    return Recording(
        robot=robot.spec.name, world="made up", policy_hash="", iteration=0, joint_names=robot.spec.joint_names,
        kp=robot.spec.kp, kd=robot.spec.kd, rate_hz=rate, clock="simulated", time=time_axis, channels=channels,
        schedule=ScheduleConfig(commands=(Command(seconds=SECONDS_EACH, vx=0.0),)), idle={objective.target.name: 0.0},
    )  # fmt: skip
