"""In mjlab, on the CPU: the reward term gives what hts gives, and the bound is held while the return moves."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[3]
HTS = os.environ.get("HTS_PYTHON", str(ROOT / ".venv/bin/python"))
"""A Python that has hts: what mjlab needs of MuJoCo and what hts needs cannot be in one environment."""
MODELS = ("linear", "lstm", "drive_train", "drive_train_late")
STEPS, INSTANCES = 120, 3


def hts(*arguments: str | Path) -> None:
    """Run `hts_side.py` where hts is."""
    if shutil.which(HTS) is None:
        pytest.skip(f"{HTS} is not there: `make install` makes it, or name a Python that has hts in HTS_PYTHON")
    places = os.pathsep.join(str(ROOT / place) for place in ("", "plugins/power", "plugins/noise", "robots/go1"))
    command = [HTS, str(Path(__file__).with_name("hts_side.py")), *map(str, arguments)]
    done = subprocess.run(
        command, env={**os.environ, "PYTHONPATH": places}, capture_output=True, text=True, check=False, timeout=500
    )
    assert done.returncode == 0, done.stderr


@pytest.fixture(scope="module")
def models(tmp_path_factory) -> Path:
    """A folder with models as hts saves them, and exported."""
    folder = tmp_path_factory.mktemp("models")
    hts("write", folder)
    return folder


def term(path: Path, **params):
    from mjlab.managers.reward_manager import RewardTermCfg

    from hts_rsl_rl.mjlab import MeasuredReward

    return RewardTermCfg(func=MeasuredReward, weight=2.0, params={"model": str(path), "entity": "cartpole", **params})


def test_the_reward_term_gives_in_mjlab_what_hts_gives_on_the_same_channels(models, tmp_path):
    import cartpole

    terms = {name: term(models / f"{name}.exported.safetensors", centring=None) for name in MODELS}
    task = cartpole.env(INSTANCES, **terms)
    task.reset()
    data, names = task.scene["cartpole"].data, list(task.scene["cartpole"].joint_names)
    order = [names.index(name) for name in ("hinge_1", "slider")]  # of the recordings; mjlab has them the other way
    assert order != sorted(order)
    rows: dict[str, list[torch.Tensor]] = {"joint_torque": [], "joint_velocity": [], "ended": []}
    got: dict[str, list[torch.Tensor]] = {name: [] for name in MODELS}
    compute = task.reward_manager.compute

    def watched(dt):  # the channels as they are when rewards are computed, before episodes begin anew
        found = compute(dt)
        rows["joint_torque"].append(data.qfrc_actuator[:, order].clone())
        rows["joint_velocity"].append(data.joint_vel[:, order].clone())
        for name in MODELS:
            column = task.reward_manager.active_terms.index(name)
            got[name].append(task.reward_manager._step_reward[:, column].clone() / 2.0)  # without its weight
        return found

    task.reward_manager.compute = watched
    random = torch.Generator().manual_seed(0)
    for _ in range(STEPS):
        _, _, terminated, truncated, _ = task.step(2.0 * torch.randn(INSTANCES, 1, generator=random))
        rows["ended"].append((terminated | truncated).to(torch.uint8))
    channels = {name: torch.stack(values).contiguous() for name, values in rows.items()}
    assert channels["ended"].sum() >= INSTANCES and channels["joint_torque"].std() > 0.1
    save_file(channels, tmp_path / "channels.safetensors")
    hts("answer", models, tmp_path / "channels.safetensors")
    for name in MODELS:
        wanted = load_file(models / f"{name}.answer.safetensors")["reward"]
        found = torch.stack(got[name])
        print(f"{name}: largest difference {(found - wanted).abs().max():.2g} of rewards to {wanted.abs().max():.2f}")
        torch.testing.assert_close(found, wanted, atol=1e-5, rtol=1e-5)
    late, instant = (torch.stack(got[name]) for name in ("drive_train_late", "drive_train"))
    assert (late - instant).abs().max() > 0.1  # the sensor's delay is in one and not in the other


def test_a_term_that_does_not_fit_the_env_is_refused_in_a_line(models, tmp_path):
    import cartpole

    from hts_rsl_rl import ModelFileError
    from hts_rsl_rl.reward import term_of

    path = str(models / "linear.exported.safetensors")
    task = cartpole.env(2)
    fields = {"joint_torque": "qfrc_actuator", "joint_velocity": "joint_vel"}

    def refused(given=fields, **params) -> str:
        with pytest.raises(ModelFileError) as error:
            term_of({"model": path, "entity": "cartpole", **params}, task, given)(task)
        assert "\n" not in str(error.value)
        return str(error.value)

    assert "joint 'a' is not in this env, which has slider, hinge_1" in refused(joint_names=("a", "slider"))
    assert "reads 'joint_torque', and nothing says where" in refused({"joint_velocity": "joint_vel"})
    one = {"joint_torque": lambda env: env.scene["cartpole"].data.qfrc_actuator[:, :1]}
    assert "'joint_torque' has 2 numbers, this env gives 1" in refused(channels=one)
    broken = {"joint_torque": lambda env: torch.tensor([[0.0, 0.0], [0.0, torch.nan]])}
    assert "the reward of env instance 1 is nan" in refused(channels=broken)
    task.cfg.decimation = 2
    assert "predicts at 50 Hz, this env steps at 25 Hz" in refused()


def steps_upright(runner, algorithm) -> float:
    """Mean steps from one fall to the next of the exploring policy, over 100 steps of every instance."""
    observations, ends, steps = runner.env.reset()[0], 0.0, 100
    with torch.inference_mode():
        for _ in range(steps):
            actions = algorithm(observations, stochastic_output=True)
            observations, _, dones, _ = runner.env.step(actions)
            ends += float(dones.sum())
    return steps * runner.env.num_envs / max(ends, 1.0)


def test_the_bound_is_held_while_the_return_moves(tmp_path):
    """A first policy of three batches, then AnchoredPPO in mjlab's own runner. Every step upright is rewarded, so the
    steps from one fall to the next stand for the return. No projection."""
    import cartpole

    from hts_rsl_rl.mjlab import AnchoredPpoCfg

    bound, batches = 0.05, 80
    task = cartpole.env(64)
    first = cartpole.runner(task)
    first.learn(3, init_at_random_ep_len=True)
    first.save(str(tmp_path / "model_3.pt"))

    settings = AnchoredPpoCfg(anchor_checkpoint=str(tmp_path / "model_3.pt"), kl_bound=bound, multiplier_rate=0.2)
    runner = cartpole.runner(task, settings, schedule="fixed")
    before = steps_upright(runner, runner.alg.anchor)
    update, kl, widened = runner.alg.update, [], []

    def watched():
        for group in runner.alg.optimizer.param_groups:
            group["lr"] = 1e-3 * max(0.05, 1.0 - len(kl) / batches)
        found = update()
        kl.append(found["kl_to_anchor"])
        widened.append(found["sigma_over_anchor"])
        return found

    runner.alg.update = watched
    runner.learn(batches, init_at_random_ep_len=True)
    after, held = steps_upright(runner, runner.alg.actor), sum(kl[-20:]) / 20
    low, high = min(kl[-20:]) / bound, max(kl[-20:]) / bound
    print(f"KL of the last 20 batches {held / bound:.3f} c, single ones {low:.2f} to {high:.2f} c", end="; ")
    print(f"sigma {widened[-1]:.3f} of the anchor's; {before:.0f} -> {after:.0f} steps upright")
    assert 0.9 * bound <= held <= 1.1 * bound
    assert after > 1.5 * before
