"""What hts does beside the tests of this package, in hts's own environment; started by them as a program.

python hts_side.py write FOLDER            fits models to made-up recordings of a cart and its pole, exports each
python hts_side.py answer FOLDER CHANNELS  what hts gives for channels that were written down in mjlab, in its own
                                           transform for training envs: FOLDER/NAME.answer.safetensors
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file, save_file

from hts.channels import Channel
from hts.contracts import ModelContext
from hts.measurement import files
from hts.measurement.export_command import export_measurement_model
from hts.measurement.transform import MeasurementTransform
from hts.plugins import load
from hts.recordings.recording import Series
from hts.testing.known_signals import known_heat

RATE, SECONDS = 50.0, 20.0
MODELS = {
    "linear": ("linear", {}),
    "lstm": ("lstm", {"hidden": 8, "products": True}),
    "drive_train": ("drive_train", {}),
    "drive_train_late": ("drive_train", {"instant": False}),
}
"""Name of the files -> measurement model and its settings."""


class Cart:
    """As much of a robot as an export asks for."""

    joint_names = ("hinge_1", "slider")  # not the order that mjlab has


def recording(seed: int):
    """Two joints whose squared torque and power a current follows, late."""
    random = np.random.default_rng(seed)
    count = round(SECONDS * RATE)
    swing = np.sin(np.arange(count)[:, None] / np.array([7.0, 11.0]) + seed) + random.normal(0, 0.3, (count, 2))
    torque, velocity = 3.0 * swing, np.roll(swing, 5, 0)
    instant = 2.0 + 0.2 * (torque**2).sum(1) + (torque * velocity).sum(1)
    current = np.convolve(instant, np.full(5, 0.2))[:count]
    channels = {
        "joint_torque": Series(Channel("joint_torque", "N*m", (2,)), torque),
        "joint_velocity": Series(Channel("joint_velocity", "rad/s", (2,)), velocity),
        "battery_current": Series(Channel("battery_current", "A"), current),
    }
    return known_heat(
        seed, seconds=SECONDS, channels=channels, joint_names=Cart.joint_names, kp=(1.0,) * 2, kd=(0.1,) * 2,
        idle={"battery_current": 2.0},
    )  # fmt: skip


def write(folder: Path) -> None:
    """Each model as hts saves it, and exported."""
    from hts.measurement.data import recorded_signals

    registry, recordings = load(), [recording(seed) for seed in range(3)]
    objective = registry.make_objective("power")
    for name, (model_name, settings) in MODELS.items():
        context = ModelContext(recorded_signals(objective, recordings[0]))
        model = registry.make_measurement_model(model_name, settings, context)
        model.fit(recordings, epochs=2)
        saved = files.save(model, folder / name, {"objective": objective.name})
        export_measurement_model(None, str(saved), folder / f"{name}.exported.safetensors", Cart(), registry)


def answer(folder: Path, channels: Path) -> None:
    """channels: joint_torque and joint_velocity (T, W, 2) in the robot's order of joints, ended (T, W)."""
    given, registry = load_file(channels), load()
    inputs = torch.cat((given["joint_torque"], given["joint_velocity"]), -1)
    for name in MODELS:
        transform = MeasurementTransform.of(registry.make_objective("power"), files.load(folder / name))
        transform.prepare(inputs.shape[1], torch.device("cpu"))
        rewards = []
        for now, over in zip(inputs, given["ended"].bool(), strict=True):
            rewards.append(transform.evaluate(now)["real_reward", "power"].squeeze(-1))
            transform.forget(over)
        save_file({"reward": torch.stack(rewards)}, folder / f"{name}.answer.safetensors")


if __name__ == "__main__":
    if sys.argv[1] == "write":
        write(Path(sys.argv[2]))
    else:
        answer(Path(sys.argv[2]), Path(sys.argv[3]))
