"""A robot around somebody else's environment: the walker of docs/examples, from its task to the end of a run."""

from __future__ import annotations

import ast
import importlib
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import EnvBase
from torchrl.envs.utils import check_env_specs

from hts.channels import Channel
from hts.config import EnvConfig
from hts.contracts import WorldContext
from hts.envs.folded import FoldedEnv
from hts.errors import ConfigError, WorldError
from hts.policies.files import load_policy
from hts.policies.layout import layout_of
from hts.testing.packages import write_package

EXAMPLE = Path(__file__).resolve().parents[2] / "docs/examples/dm_control_walker"
CHANNELS = ("joint_torque", "joint_velocity", "base_velocity", "projected_gravity")


@pytest.fixture(scope="module")
def walker() -> Iterator[None]:
    """The example's modules can be imported, and are gone afterwards."""
    before = set(sys.modules)
    sys.path.insert(0, str(EXAMPLE))
    yield
    sys.path.remove(str(EXAMPLE))
    for name in set(sys.modules) - before:
        if name.startswith("hts_walker") or name == "make_policy":
            del sys.modules[name]


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> list[Path]:
    """What to put on the path for the example to be installed: its folder, and an entry point as pip would leave it."""
    folder = tmp_path_factory.mktemp("installed")
    return [EXAMPLE, write_package(folder, "hts-example-walker", {}, {"walker": "hts_walker.plugin"})]


@pytest.fixture
def robot(walker):
    module = importlib.import_module("hts_walker.robot")
    return module.Walker(module.Settings())


def make(robot, candidates: int, worlds: int, seeds: list[int]):
    return robot.make_env("mujoco", candidates, worlds, EnvConfig(episode_seconds=0.5), CHANNELS, seeds)


# ------------------------------------------------------------------------------------------------- the environment


def test_the_env_keeps_the_promises_that_torchrl_checks(robot):
    env = make(robot, 2, 2, [0, 1])
    check_env_specs(env)
    assert env.batch_size == (2, 2)
    env.close()


def test_the_task_is_the_suites_own_and_its_reward_becomes_a_rate(robot):
    from dm_control import suite

    env = make(robot, 1, 1, [3])
    task = suite.load("walker", "walk", task_kwargs={"random": 3 * 1_000_003})
    task.reset()
    state = env.reset()
    for step in range(5):
        action = torch.full((1, 1, 6), 0.5 - 0.2 * step)
        state["action"] = action
        state = env.step(state)["next"]
        there = task.step(action[0, 0].numpy())
        seen = np.concatenate(
            [np.atleast_1d(there.observation[name]) for name in ("orientations", "height", "velocity")]
        )
        assert state["observation"][0, 0].numpy() == pytest.approx(seen, abs=1e-5)
        assert float(state["reward"]) == pytest.approx(there.reward * 0.025, abs=1e-7)
        np.testing.assert_allclose(
            state["channels", "joint_torque"][0, 0], action[0, 0] * torch.tensor([100.0, 50.0, 20.0] * 2)
        )
        assert float(state["channels", "projected_gravity"].norm()) == pytest.approx(1.0, abs=1e-5)
        assert float(state["channels", "projected_gravity"][0, 0, 2]) == pytest.approx(
            -task.physics.torso_upright(), abs=1e-5
        )
    env.close()


def test_a_candidates_worlds_are_the_same_alone_and_in_a_crowd(robot):
    alone, crowd = make(robot, 1, 2, [7]), make(robot, 3, 2, [5, 7, 7])
    first, all_of_them = alone.reset()["observation"], crowd.reset()["observation"]
    assert torch.equal(first[0], all_of_them[1])
    assert torch.equal(all_of_them[1], all_of_them[2])
    assert not torch.equal(all_of_them[0], all_of_them[1])
    alone.close()
    crowd.close()


def test_a_world_that_times_out_begins_again_and_the_others_go_on(robot):
    env = make(robot, 1, 2, [0])
    state = env.reset()
    for _ in range(20):  # 0.5 s at 40 Hz
        state["action"] = torch.zeros(1, 2, 6)
        data, state = env.step_and_maybe_reset(state)
    assert bool(data["next", "truncated"].all()) and not bool(data["next", "terminated"].any())
    kept = state["observation"][0, 1].clone()
    state["_reset"] = torch.tensor([[[True], [False]]])
    again = env.reset(state)
    assert torch.equal(again["observation"][0, 1], kept)
    assert not torch.equal(again["observation"][0, 0], data["next", "observation"][0, 0])
    env.close()


def test_a_second_counts_where_the_walker_is_about_as_fast_as_the_suite_wants(robot):
    task = robot.task()
    assert task.set_points == () and not any(
        key in (EXAMPLE / "walker.yaml").read_text() for key in ("speed:", "speeds:", "vx:")
    )
    assert task.done(np.array([0.5, 0.95, 3.0]), 0.0, 0.1).tolist() == [False, True, True]


def test_the_fast_task_of_the_pretraining_is_the_suites_task(robot):
    pretraining = importlib.import_module("make_policy")
    slow = make(robot, 1, 3, [0])
    fast = pretraining.FastWalkerEnv(pretraining.suite_model(), (1, 3), 25.0, [0], threads=1)
    state = slow.reset()
    fast.reset()
    physics = [one._env.physics.data for one in slow.inner._envs]
    qpos, qvel = (
        torch.tensor(np.stack([getattr(data, name) for data in physics])).float() for name in ("qpos", "qvel")
    )
    fast.engine.reset(torch.ones(3, dtype=torch.bool), qpos, qvel)
    generator = torch.Generator().manual_seed(0)
    for _ in range(12):
        state["action"] = 2 * torch.rand(1, 3, 6, generator=generator) - 1
        here, there = slow.step(state)["next"], fast.step(state.select("action"))["next"]
        assert torch.allclose(here["observation"], there["observation"], atol=1e-3)
        assert torch.allclose(here["reward"], there["reward"], atol=3e-4)  # of at most 0.025; a sensor is 2.5 ms older
        state = here
    slow.close()
    fast.close()


def test_the_script_that_made_the_policy_still_makes_one(robot, tmp_path, capsys):
    importlib.import_module("make_policy").main(tmp_path, steps=64, num_envs=2)
    made = load_policy(tmp_path / "pretrained", robot.spec).card
    shipped = load_policy(robot.pretrained_policy(), robot.spec).card
    assert made.observation == shipped.observation and made.hidden == shipped.hidden
    assert made.made["command"] == "python make_policy.py OUT" and made.made["steps"] == 64
    assert str(tmp_path / "pretrained.safetensors") in capsys.readouterr().out


class Counting(EnvBase):
    """A task of no library: world w counts its steps from 10 w, and ends when it has counted far enough."""

    def __init__(self, worlds: int, far: int = 3) -> None:
        super().__init__(batch_size=[worlds])
        self.start, self.far = 10.0 * torch.arange(worlds).unsqueeze(-1), far
        groups = {"actor": Unbounded((worlds, 2)), "critic": Unbounded((worlds, 3))}
        self.observation_spec = Composite(**groups, shape=(worlds,))
        self.action_spec = Unbounded((worlds, 1), dtype=torch.float64)
        self.reward_spec = Unbounded((worlds, 1))
        flag = Binary(1, (worlds, 1), dtype=torch.bool)
        self.done_spec = Composite({n: flag.clone() for n in ("done", "terminated", "truncated")}, shape=(worlds,))

    def _set_seed(self, seed):
        pass

    def _shown(self, **more) -> TensorDict:
        parts = {"actor": self.now.repeat(1, 2), "critic": self.now.repeat(1, 3)}
        return TensorDict({**parts, **more}, self.batch_size)

    def _reset(self, tensordict=None, **kwargs):
        mask = torch.ones_like(self.start, dtype=torch.bool)
        if tensordict is not None and "_reset" in tensordict.keys():  # noqa: SIM118
            mask = tensordict["_reset"]
        self.now = torch.where(mask, self.start, getattr(self, "now", self.start))
        no = torch.zeros_like(mask)
        return self._shown(done=no, terminated=no.clone(), truncated=no.clone())

    def _step(self, tensordict):
        self.now = self.now + tensordict["action"].float()
        over = self.now - self.start >= self.far
        return self._shown(
            reward=self.now.clone(), done=over, terminated=over.clone(), truncated=torch.zeros_like(over)
        )


def folded(**changes):
    return FoldedEnv(
        Counting(6),
        2,
        dt=0.5,
        observation=["actor"],
        critic_observation=["critic"],
        channels={"twice": Channel("twice", "1", ()), "sent": Channel("sent", "1", (1,))},
        values=lambda after, action: {"twice": 2 * after["actor"][:, 0], "sent": action},
        **changes,
    )


def test_world_n_of_candidate_p_is_world_p_times_n_of_the_inner_env():
    env = folded(action_limit=1.0)
    check_env_specs(env)
    state = env.reset()
    assert state["observation"][:, :, 0].tolist() == [[0.0, 10.0, 20.0], [30.0, 40.0, 50.0]]
    assert state["critic_observation"].shape == (2, 3, 3)
    state["action"] = torch.tensor([[[1.0], [0.5], [9.0]], [[0.0], [0.0], [0.0]]])
    after = env.step(state)["next"]
    assert after["observation"][:, :, 0].tolist() == [[1.0, 10.5, 21.0], [30.0, 40.0, 50.0]]
    assert after["reward"][0, :, 0].tolist() == [0.5, 5.25, 10.5]  # the inner reward times dt
    assert after["channels", "twice"][0].tolist() == [2.0, 21.0, 42.0]
    assert after["channels", "sent"][0, :, 0].tolist() == [1.0, 0.5, 1.0]  # clipped
    assert env.observation_layout == [{"name": "actor", "size": 2}]


def test_a_task_that_rewards_per_second_keeps_its_reward():
    env = folded(reward_scale=1.0)
    state = env.reset().set("action", torch.zeros(2, 3, 1))
    assert env.step(state)["next", "reward"][1, :, 0].tolist() == [30.0, 40.0, 50.0]


def test_only_the_world_that_ended_begins_again():
    env = folded()
    state = env.reset()
    action = torch.zeros(2, 3, 1)
    action[1, 2] = 3.0
    state["action"] = action
    data, state = env.step_and_maybe_reset(state)
    assert data["next", "terminated"].flatten().tolist() == [False] * 5 + [True]
    assert data["next", "observation"][1, 2, 0] == 53.0 and state["observation"][1, 2, 0] == 50.0


def test_worlds_that_cannot_be_shared_out_are_refused_in_one_line():
    with pytest.raises(ConfigError, match=r"batch size \[6\] cannot be folded for 4 candidates"):
        FoldedEnv(Counting(6), 4, dt=0.5, observation=["actor"], channels={}, values=lambda after, action: {})


def test_an_env_without_a_layout_and_one_that_is_not_asked_for_it_are_told_apart():
    plain, silent = Counting(2), folded()
    plain.observation_layout = [{"name": "actor", "size": 2}]
    with pytest.raises(ConfigError, match="'own', a Counting, does not derive from hts.rl.TaskEnv"):
        layout_of(plain, "own")
    silent.observation_layout = None
    with pytest.raises(ConfigError, match="'own', a FoldedEnv, does not say what a policy sees.*Give it observation_l"):
        layout_of(silent, "own")
    assert layout_of(folded(), "own") == [{"name": "actor", "size": 2}]


# ------------------------------------------------------------------------------------------------------- the lab


def lab(settings: dict, robot: str = "dm_walker"):
    module = importlib.import_module("hts_walker.lab")
    return module.WalkerLab(module.Settings(**settings), WorldContext(robot, {}, {"effort": {}}, 0, Path("nowhere")))


@pytest.fixture
def exported(robot, tmp_path) -> Path:
    from hts.policies.export import to_onnx

    return to_onnx(load_policy(robot.pretrained_policy(), robot.spec), tmp_path / "pretrained.onnx")


def test_the_shipped_policy_walks_in_the_lab(robot, exported):
    world = lab({"warmup_seconds": 2.0})
    (recording,) = world.collect([exported], robot.task().schedule(0.0, 5.0))
    speed = recording.values("base_velocity")[:, 0].reshape(5, 40).mean(1)
    assert np.all((speed > 0.9) & (speed < 2.7))
    assert recording.values("projected_gravity")[:, 2].max() < -0.5


def test_the_lab_repeats_itself(robot, exported):
    schedule = robot.task().schedule(0.0, 1.0)
    first, second = (lab({"warmup_seconds": 0.5}).collect([exported], schedule)[0] for _ in range(2))
    assert np.array_equal(first.values("motor_power"), second.values("motor_power"))


def test_the_meter_of_a_walker_that_does_nothing_shows_the_idle_level(exported):
    machine = importlib.import_module("hts_walker.lab").Machine
    settings = importlib.import_module("hts_walker.lab").Settings(idle_watts=15.0, copper=0.01, meter_seconds=1 / 40)
    one = machine(settings, 0)
    assert one._meter(np.zeros(6), np.ones(6)) == 15.0
    # 10 N*m at 2 rad/s is 20 W of work and 0.01 * 100 = 1 W of heat; braking joints give nothing back.
    assert one._meter(np.array([10.0, 0, 0, 0, 0, 0]), np.full(6, 2.0)) == pytest.approx(36.0)
    assert one._meter(np.array([10.0, 0, 0, 0, 0, 0]), np.full(6, -2.0)) == pytest.approx(16.0)


def test_the_lab_has_one_kind_of_machine(walker):
    with pytest.raises(WorldError, match="has a walker and no 'other'"):
        lab({}, robot="other")


def test_learning_does_not_see_the_lab():
    for name in ("robot", "env", "channels"):
        tree = ast.parse((EXAMPLE / f"hts_walker/{name}.py").read_text())
        imported = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        assert "hts_walker.lab" not in imported


# -------------------------------------------------------------------------------------------------- through hts


@pytest.mark.slow
def test_the_example_runs_from_command_to_report(hts_here, installed, tmp_path):
    folder = tmp_path / "run"
    done = hts_here(
        *("run", "--objective", "effort", "--robot", "dm_walker", "--world", "walker_lab", "--preset", "smoke"),
        *("--config", EXAMPLE / "smoke.yaml", "--out", folder),
        path=installed,
    )
    assert done.returncode == 0, done.stderr
    summary = json.loads((folder / "summary.json").read_text())
    assert [summary[key] for key in ("objectives", "robot", "world")] == [["effort"], "dm_walker", "walker_lab"]
    (iteration,) = summary["iterations"]
    assert [row["weights"] for row in iteration["candidates"]] == [{"effort": 0.1}, {"effort": 0.5}]
    assert all(0.0 <= row["kl"] <= 0.55 for row in iteration["candidates"])
    (tested,) = [row for row in iteration["candidates"] if row["elite"]]
    (numbers,) = tested["real"]["effort"].values()
    assert summary["task"] == {"velocity": False, "quantity": "forward speed", "unit": "m/s", "commanded": False}
    assert list(tested["real"]["effort"]) == ["0.0"] and numbers["mean_speed"] > 0.9
    assert math.isfinite(numbers["improvement"]) and numbers["falls"] == 0
    assert set(numbers["metrics"]) == {"joule_per_metre"}
    assert (folder / "report.html").is_file()
    card = json.loads((folder / "iterations/00/candidates/00-00.json").read_text())
    assert [part["name"] for part in card["observation"]] == ["orientations", "height", "velocity"]


@pytest.mark.slow
def test_the_example_keeps_every_demand_of_the_kit(hts_here, installed):
    done = hts_here("check", "hts-example-walker", path=installed)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_an_env_that_cannot_save_its_state_is_trained_in_without_checkpoints(robot, tmp_path, monkeypatch):
    from hts.config import FinetuneConfig, PPOConfig
    from hts.training import finetune
    from hts.training.sweep import Candidate

    monkeypatch.setattr(finetune, "CHECKPOINT_SECONDS", 0.0)
    config = FinetuneConfig(num_envs=1, steps=64, ppo=PPOConfig(horizon=16, minibatches=1, epochs=1))
    anchors = {"pretrained": load_policy(robot.pretrained_policy(), robot.spec)}
    tuned, steps = finetune.finetune(
        robot,
        "mujoco",
        config,
        [Candidate("one", "pretrained", {}, 1.0)],
        anchors,
        list,
        ("joint_torque",),
        seed=0,
        checkpoint=tmp_path / "checkpoint",
    )
    assert len(tuned) == 1 and steps >= 64
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_policy_can_be_pretrained_in_somebody_elses_env(robot, tmp_path):
    from hts.config import PPOConfig, PretrainConfig
    from hts.training.pretrain import pretrain_policy

    config = PretrainConfig(
        engine="mujoco", num_envs=2, steps=32, hidden=(8,), ppo=PPOConfig(horizon=16, minibatches=2)
    )
    path = pretrain_policy(robot, config, tmp_path)
    card = load_policy(path, robot.spec).card
    assert [(part["name"], part["size"]) for part in card.observation] == [
        ("orientations", 14),
        ("height", 1),
        ("velocity", 9),
    ]
