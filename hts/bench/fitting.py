"""`hts bench fit`: reading recordings from a store, and how fast a measurement model learns from them."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from hts.bench.setup import RECURRENT, find
from hts.config import Command, ScheduleConfig
from hts.contracts import MODEL, Objective, Robot, chosen_model
from hts.cores import available
from hts.measurement.fit_command import new_model
from hts.recordings.gravity import GRAVITY
from hts.recordings.recording import Recording, Series
from hts.recordings.store import RecordingStore

SAMPLES = 15_000
SHORT, LONG = 60.0, 160.0  # s of a recording: five of the one are the default; the other is the paper's length


def bench_fit(
    robot: str | None, objective: str | None, seconds: float = 10.0, samples: int = SAMPLES, epochs: int = 0
) -> dict[str, Any]:
    """Fitting to made-up recordings of the robot's channels, read from a store first.

    epochs: 0 for as many as fit into `seconds`; otherwise a whole fit of so many, as `hts fit` does it. Keys:
    samples_per_s (samples times epochs over seconds, validation included), samples, epochs, seconds; read_seconds of
    the channels that are fitted, checksums compared; name_seconds: of hashing every array for the dataset's name, which
    a fit does too; …
    """
    machine, chosen = find(robot, objective)
    length = SHORT if samples <= SAMPLES else LONG
    count = max(1, round(samples / (length * machine.spec.control_rate_hz)))
    recordings, reading = from_store([made_up(chosen, machine, seed, length) for seed in range(count)], chosen)
    choice = chosen_model(chosen, {MODEL: RECURRENT})  # a model that learns by passes over the data
    patience = epochs or 10_000
    model = new_model(chosen, recordings[0], {MODEL: {"name": choice.name, **choice.settings, "patience": patience}})
    model.fit(recordings[:1], epochs=1)  # the first call also pays for loading libraries
    start = time.perf_counter()
    report = model.fit(recordings, epochs=patience, max_seconds=math.inf if epochs else seconds)
    spent = time.perf_counter() - start
    return {
        "bench": "fit",
        "samples_per_s": report["samples"] * report["epochs"] / spent,
        "samples": report["samples"],
        "epochs": report["epochs"],
        "seconds": spent,
        **reading,
        "recordings_read": len(recordings),
        "robot": machine.spec.name,
        "objective": chosen.name,
        "model": choice.name,
        "hidden": model.settings["hidden"],
        "cores": available(),
        "recordings": "made up: slow sines and noise on the robot's channels",
        "torch": str(torch.__version__),
    }


def from_store(recordings: Sequence[Recording], objective: Objective) -> tuple[list[Recording], dict[str, float]]:
    """The recordings as a store gives them back, and how long that took: read_seconds, name_seconds, store_megabytes.

    The files were written just before, so the disk's own speed is not in it.
    """
    wanted = (*objective.inputs, objective.target.name)
    with tempfile.TemporaryDirectory() as folder:
        store = RecordingStore(Path(folder) / "data.zarr", create=True)
        ids = [store.write(recording) for recording in recordings]
        start = time.perf_counter()
        store.dataset(ids)
        middle = time.perf_counter()
        read = [store.read(name, wanted) for name in ids]
        end = time.perf_counter()
        size = sum(file.stat().st_size for file in Path(folder).rglob("*") if file.is_file())
    return read, {"read_seconds": end - middle, "name_seconds": middle - start, "store_megabytes": size / 1e6}


def made_up(objective: Objective, robot: Robot, seed: int, seconds: float = SHORT) -> Recording:
    """A recording of the right shape, with every channel of the robot: each a sine with noise, the target the mean
    square of the objective's inputs."""
    rng, rate = np.random.default_rng(seed), robot.spec.control_rate_hz
    time_axis = np.arange(round(seconds * rate)) / rate
    known, channels, sums = robot.channels(), {}, np.zeros(len(time_axis))
    for name in dict.fromkeys((*objective.inputs, *known)):
        size = known[name].shape
        phase, hertz = rng.uniform(0, 2 * np.pi, size), rng.uniform(0.5, 3.0, size)
        angle = 2 * np.pi * hertz * time_axis.reshape(-1, *(1,) * len(size)) + phase
        values = np.sin(angle) + 0.1 * rng.standard_normal(angle.shape)
        if name == GRAVITY:
            values /= np.linalg.norm(values, axis=1, keepdims=True)
        channels[name] = Series(known[name], values)
        if name in objective.inputs:
            sums += np.square(values).reshape(len(time_axis), -1).mean(1)
    channels[objective.target.name] = Series(objective.target, sums.reshape(-1, *objective.target.shape))
    return Recording(
        robot=robot.spec.name,
        world="made up",
        policy_hash="",
        iteration=0,
        joint_names=robot.spec.joint_names,
        kp=robot.spec.kp,
        kd=robot.spec.kd,
        rate_hz=rate,
        clock="simulated",
        time=time_axis,
        channels=channels,
        schedule=ScheduleConfig(commands=(Command(seconds=seconds, vx=0.0),)),
        idle={objective.target.name: 0.0},
    )
