"""A task's own measure held at zero on average while something else is paid for."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Composite, Unbounded

from hts.config import CommandConfig, EnvConfig, FinetuneConfig, PPOConfig, RandomisationConfig
from hts.envs.commands import DRAWS, TRIMMED_AWAY, Commands
from hts.errors import SimulationError
from hts.policies.files import load_policy
from hts.rl.population import Population
from hts.training import finetune as module
from hts.training.held import Held, Holding
from hts.training.sweep import Candidate
from hts.training.trainer import SETTLING_SECONDS, STRENGTH, PopulationTrainer
from tests.training.test_trainer import SIZES, Target

CONFIG = PPOConfig(horizon=24, learning_rate=3e-3, epochs=4)


class Walk(Target):
    """("held", "sum") = sum of the action - 1, while being calm pays."""

    def _write(self, entries, real):
        made = super()._write(entries, real)
        made["held"] = TensorDict({"sum": self.error.unsqueeze(-1)}, batch_size=self.batch_size)
        return made

    def __init__(self, seeds):
        self.error = torch.zeros(len(seeds), 4)
        super().__init__(seeds)
        entry = Composite(sum=Unbounded((*self.batch_size, 1)), shape=self.batch_size)
        self.observation_spec["held"] = entry

    def _step(self, tensordict):
        self.error = tensordict["action"].sum(-1) - 1.0
        return super()._step(tensordict)


def learned(held) -> list[float]:
    ancestor = Population(SIZES, 1, init_std=0.3, seed=11).candidate(0)
    population = Population.from_candidates(SIZES, [ancestor])
    made = PopulationTrainer(
        Walk((1,)),
        population,
        CONFIG,
        seeds=(1,),
        names=["c1"],
        anchor=population.frozen(),
        bounds=torch.tensor([torch.inf]),
        weights={"calm": torch.tensor([5.0])},
        held=held,
    )
    sums = []
    for _ in range(90):
        data = made.collect()
        sums.append(float(data["next", "held", "sum"].mean()))
        made.learn(data)
    return sums


def test_doing_less_of_the_task_is_no_saving_where_it_is_held():
    free, held = learned(None), learned({"sum": 0.05})
    assert sum(free[-15:]) / 15 < -0.4  # it would rather keep still
    assert abs(sum(held[-15:]) / 15) < 0.1


class Starting(Walk):
    """What is held has no error, and rewards spread ten times as far in the first batch as afterwards."""

    def _step(self, tensordict):
        made = super()._step(tensordict)
        self.taken = getattr(self, "taken", 0) + 1
        made["real_reward", "calm"] *= 10.0 if self.taken <= CONFIG.horizon else 1.0
        made["held", "sum"] *= 0.0
        return made


def test_a_price_begins_at_what_pulls_once_instances_have_found_their_feet():
    population = Population(SIZES, 1, init_std=0.3, seed=11)
    made = PopulationTrainer(
        Starting((1,)),
        population,
        CONFIG,
        seeds=(1,),
        names=["c1"],
        weights={"calm": torch.tensor([5.0])},
        held={"sum": 0.05},
        prices={"sum": torch.tensor([2.0])},
    )
    length = CONFIG.horizon * made.dt
    assert (made.settling - 1) * length <= SETTLING_SECONDS < made.settling * length  # that batch is the first after it
    rows = [made.batch().values for _ in range(made.settling + 2)]
    strength = [row[STRENGTH][0] for row in rows]
    assert strength[0] > 3 * strength[made.settling - 1]
    begun = pytest.approx(2.0 * strength[made.settling - 1])
    assert [row["held/sum_multiplier"][0] for row in rows[made.settling - 1 :]] == [begun] * 3


def test_a_price_that_nobody_has_found_moves_from_the_first_batch_on():
    def integral(prices) -> float:
        made = PopulationTrainer(
            Walk((1,)),
            Population(SIZES, 1, init_std=0.3, seed=11),
            CONFIG,
            seeds=(1,),
            names=["c1"],
            weights={"calm": torch.tensor([5.0])},
            held={"sum": 0.05},
            prices=prices,
        )
        for _ in range(3):
            made.batch()
        return float(made.held["sum"].integral)

    assert integral({"sum": torch.zeros(1)}) == integral(None) != 0.0


@pytest.fixture
def robot():
    pytest.importorskip("hts_go1", reason="the robot of this test is not installed")
    from hts_go1.robot import Go1, Go1Settings

    return Go1(Go1Settings())


def tuned(robot, anchor=None, checkpoint=None, **changes):
    """Three batches of one candidate: as it ended, and as it was after the first."""
    config = FinetuneConfig(
        num_envs=4,
        steps=4 * 30 * 3,
        hold=True,
        also_at=(0.34,),
        average=0.6,
        ppo=PPOConfig(horizon=30, epochs=1, minibatches=1),
        env=EnvConfig(randomisation=RandomisationConfig(models=1), threads=1),
    ).model_copy(update=changes)
    anchors = {"pretrained": anchor or load_policy(robot.pretrained_policy(), robot.spec)}
    group = [Candidate("00-00", "pretrained", {}, 1.0)]
    return module.finetune(robot, "mujoco", config, group, anchors, list, (), seed=3, checkpoint=checkpoint)[0]


def test_prices_go_on_from_the_anchors_also_where_that_was_kept_on_the_way(robot):
    end, early = tuned(robot)
    assert (early.candidate.id, early.share) == ("00-00-34", 0.34)
    last = end.history[-1]
    assert end.prices["speed_error"] == pytest.approx(last["held/speed_error_multiplier"] / last["held/strength"])
    first = early.history[-1]
    assert len(early.history) == 1 and early.prices["speed_error"] == first["held/speed_error_multiplier"]
    policy = load_policy(robot.pretrained_policy(), robot.spec)
    anchor = replace(policy, card=replace(policy.card, made={"prices": {"speed_error": 3.0}}))
    begun = [tuned(robot, anchor, hold_from_anchor=so)[0].history[0] for so in (True, False)]
    assert [row["held/speed_error_multiplier"] for row in begun] == [3.0, 0.0]  # the first second has no error


def test_finetuning_holds_a_velocity_robots_speed_and_goes_on_from_a_checkpoint(robot, monkeypatch, tmp_path):
    def tune(checkpoint=None):
        return tuned(robot, checkpoint=checkpoint)

    whole, early = tune()
    errors = [row["held/speed_error"] for row in whole.history]
    assert errors[0] == 0.0 and all(error != 0.0 for error in errors[1:])  # the first second does not count
    assert whole.history[-1]["held/speed_error_multiplier"] * errors[-1] < 0

    def save_and_stop(*arguments, really=module.save_checkpoint):
        really(*arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "CHECKPOINT_SECONDS", 0.0)
    monkeypatch.setattr(module, "save_checkpoint", save_and_stop)
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            tune(tmp_path / "checkpoint")
    monkeypatch.undo()
    again, early_again = tune(tmp_path / "checkpoint")
    assert (again.history, again.prices) == (whole.history, whole.prices)
    assert again.kl == whole.kl and early_again.kl == early.kl
    for one, other in ((again, whole), (early_again, early)):
        assert all(torch.equal(one.tensors[name], tensor) for name, tensor in other.tensors.items())


def test_the_trend_tells_a_policy_that_walks_at_one_speed_whatever_it_is_told():
    commands = Commands(CommandConfig(vx=(0.2, 1.4)), (1, 5), 0.02, torch.device("cpu"))
    commands.value[0, :, 0] = torch.tensor([0.4, 0.85, 1.3, 0.85, 0.2])
    seconds = torch.tensor([[9.0, 9.0, 9.0, 0.5, 9.0]])  # the fourth has just been stood up, the fifth hardly moves
    same, held = torch.full((1, 5), 0.85), commands.value[..., 0].clone()
    error, trend = commands.speed_error(same, seconds), commands.speed_error_trend(same, seconds)
    assert error[0, 0] > 1.0 and error[0, 2] < -0.3
    places = torch.tensor([(0.4 - 0.85) / 0.55, 0.0, (1.3 - 0.85) / 0.55])
    torch.testing.assert_close(trend[0, :3], error[0, :3] * places)
    assert (trend[0, [0, 2]] < 0).all() and (trend[0, 3:] == 0).all()
    assert (commands.speed_error_trend(held, seconds).abs() < 1e-6).all()


def missed(speed_of, vx=(0.2, 1.5), seconds=6.0) -> tuple[torch.Tensor, torch.Tensor]:
    """Slow and fast channels [steps, 4] of robots that are told 0.2, 0.4, 0.6 and 1.2 m/s; speed_of: commands [4] and
    the time, s -> speeds [4]."""
    commands = Commands(CommandConfig(vx=vx), (1, 4), 0.02, torch.device("cpu"))
    commands.value[0, :, 0] = told = torch.tensor([0.2, 0.4, 0.6, 1.2])
    slow, fast = [], []
    for step in range(round(seconds / 0.02)):
        forward = speed_of(told, step * 0.02).view(1, 4)
        commands.watch(forward)
        slow.append(commands.speed_missed_slow(forward, torch.tensor(9.0)))
        fast.append(commands.speed_missed_fast(forward, torch.tensor(9.0)))
    return torch.cat(slow), torch.cat(fast)


def test_who_stands_at_slow_commands_misses_them_and_makes_up_for_it_nowhere():
    slow, fast = missed(lambda told, time: torch.where(told < 0.5, 0.0, told * 1.02))
    assert slow[-1, 1] == pytest.approx(1.0 - TRIMMED_AWAY, abs=1e-3) and slow[-1, 2] < 0.05 and fast[-1, 3] < 0.05
    assert (slow[:, [0, 3]] == 0).all() and (fast[:, :3] == 0).all()  # too slow to tell a share, or the other half
    assert (slow[: round(2 / 0.02)] == 0).all()  # settling, and a second to look at


def test_a_stride_misses_little_and_a_steady_speed_what_no_trimming_takes_away():
    slow, fast = missed(lambda told, time: told * (1 + 0.3 * math.sin(2 * math.pi * 2.5 * time)))
    assert slow[200:].mean() < 0.05 and fast[200:].mean() < 0.05
    for share, size in ((1.2, 0.0), (0.8, 0.0), (0.6, 0.15), (0.4, 0.35)):  # who crawls is told which way is better
        slow, fast = missed(lambda told, time, share=share: told * share)
        assert slow[-1, 1] == pytest.approx(size, abs=2e-3) and fast[-1, 3] == pytest.approx(size, abs=2e-3)
    assert missed(lambda told, time: told * 3)[1][-1, 3] == 1.0


def test_who_stands_and_hurries_in_turn_misses_though_no_average_says_so():
    slow, fast = missed(lambda told, time: told * (2.0 if time % 4.0 < 2.0 else 0.0), seconds=20.0)
    assert slow[400:, 1].mean() > 0.3 and fast[400:, 3].mean() > 0.3


def test_a_new_command_is_given_time():
    commands = Commands(CommandConfig(vx=(0.4, 0.4), vy=(0.0, 0.0)), (1, 1), 0.02, torch.device("cpu"))
    commands.value[..., 0] = 1.2
    for _ in range(200):
        commands.watch(torch.zeros(1, 1))
    standing = commands.speed_missed_fast(torch.zeros(1, 1), torch.tensor(9.0))
    assert standing == pytest.approx(1.0 - TRIMMED_AWAY, abs=1e-3)
    commands.resample(torch.ones(1, 1, dtype=torch.bool), torch.full((1, 1, DRAWS), 0.9), torch.zeros(1, 1))
    for _ in range(60):
        commands.watch(torch.full((1, 1), 0.4))
    assert commands.speed_missed_fast(torch.zeros(1, 1), torch.tensor(9.0)) == 0
    assert commands.smoothed_error.abs() < 1e-6 and commands.own_error.abs() < 1e-6  # nothing is left of the old one


def test_finetuning_pays_for_missing_only_where_it_is_asked_to(robot):
    assert set(Holding.of(robot, FinetuneConfig(hold=True)).names) == {
        "speed_error",
        "speed_error_trend",
        "speed_missed_slow",
        "speed_missed_fast",
    }
    assert not Holding.of(robot, FinetuneConfig(hold=True, hold_below=False)).below
    assert not Holding.of(robot, FinetuneConfig(hold=False)).names


def test_a_channel_that_the_env_does_not_write_is_refused():
    spec = Composite(channels=Composite(effort=Unbounded((1, 2)), shape=(1, 2)), shape=(1, 2))
    with pytest.raises(SimulationError, match=r"finetune.hold: .*'speed_error'"):
        Held(("speed_error",)).transform_observation_spec(spec)
