"""Training of a population: rewards, bounds, stopping, saving, and independence of the neighbours."""

from __future__ import annotations

import math

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Binary, Composite, Unbounded

from hts.channels import Channel
from hts.config import EnvConfig, PPOConfig, RandomisationConfig
from hts.contracts import Signals
from hts.errors import PolicyError, SimulationError
from hts.measurement.lstm import LSTM, LSTMSettings
from hts.measurement.transform import MeasurementTransform
from hts.rl.learner import Layout, Learner
from hts.rl.population import Population, Sizes
from hts.rl.task_env import TaskEnv
from hts.training.checkpoint import load_checkpoint, save_checkpoint
from hts.training.finetune import measured_env
from hts.training.trainer import PopulationTrainer

SIZES = Sizes(3, 3, 2, (8,))
QUICK = PPOConfig(horizon=6, epochs=2, minibatches=2)


class Target(TaskEnv):
    """Worlds with a fixed number each, to be hit by the sum of the action. Deterministic, with falls and time-outs.

    r_sim = -(sum of action - number)^2 x dt; ("real_reward", "calm") = 7 - |action|. `poison`: (candidate, step) whose
    measured reward is not a number; `poison_sim` the same for r_sim.
    """

    def __init__(self, seeds, worlds=4):
        super().__init__(batch_size=torch.Size([len(seeds), worlds]))
        self.dt, self.clock = 0.02, 0
        self.poison: set[tuple[int, int]] = set()
        self.poison_sim: set[tuple[int, int]] = set()
        self.number = torch.stack([torch.rand(worlds, generator=torch.Generator().manual_seed(seed)) for seed in seeds])
        self.age = torch.zeros(self.batch_size)
        shape = self.batch_size
        self.observation_spec = Composite(
            observation=Unbounded((*shape, 3)),
            critic_observation=Unbounded((*shape, 3)),
            real_reward=Composite(calm=Unbounded((*shape, 1)), shape=shape),
            shape=shape,
        )
        self.action_spec, self.reward_spec = Unbounded((*shape, 2)), Unbounded((*shape, 1))
        flag = Binary(1, (*shape, 1), dtype=torch.bool)
        self.done_spec = Composite({name: flag.clone() for name in ("done", "terminated", "truncated")}, shape=shape)

    def _set_seed(self, seed):
        pass

    def _look(self):
        return torch.stack((self.number, self.age / 8, torch.ones_like(self.age)), -1)

    def _write(self, entries, real):
        for name in ("observation", "critic_observation"):
            entries[name] = self._look()
        entries["real_reward"] = TensorDict({"calm": real.unsqueeze(-1)}, batch_size=self.batch_size)
        return TensorDict(entries, batch_size=self.batch_size)

    def _reset(self, tensordict=None, **kwargs):
        if tensordict is not None and "_reset" in tensordict.keys():  # noqa: SIM118
            self.age = self.age * ~tensordict["_reset"].squeeze(-1)
        no = torch.zeros(*self.batch_size, 1, dtype=torch.bool)
        return self._write(
            {"done": no, "terminated": no.clone(), "truncated": no.clone()}, torch.zeros(self.batch_size)
        )

    def _step(self, tensordict):
        action = tensordict["action"]
        self.age = self.age + 1
        reward = -(action.sum(-1) - self.number).square() * self.dt
        real = 7.0 - action.abs().sum(-1)
        for where, value in ((self.poison, real), (self.poison_sim, reward)):
            for candidate, step in where:
                if step == self.clock:
                    value[candidate, 0] = float("nan")
        self.clock += 1
        fell = action.sum(-1) > 2.5
        late = (self.age >= 8) & ~fell
        flags = {"terminated": fell, "truncated": late, "done": fell | late}
        return self._write({"reward": reward.unsqueeze(-1), **{k: v.unsqueeze(-1) for k, v in flags.items()}}, real)

    def full_state(self):
        return TensorDict({"age": self.age.clone(), "clock": torch.tensor(self.clock)}, batch_size=[])

    def load_full_state(self, state):
        self.age, self.clock = state["age"].clone(), int(state["clock"])


def trainer(seeds=(1, 2), config=QUICK, anchored=True, resume=None, std=0.3, **settings) -> PopulationTrainer:
    """A population of one common ancestor, in worlds of its own."""
    ancestor = Population(SIZES, 1, init_std=std, seed=11).candidate(0)
    population = Population.from_candidates(SIZES, [ancestor] * len(seeds))
    settings.setdefault("bounds", torch.full((len(seeds),), 0.5) if anchored else None)
    settings.setdefault("weights", {"calm": torch.ones(len(seeds))})
    return PopulationTrainer(
        Target(seeds),
        population,
        config,
        seeds=seeds,
        names=[f"c{seed}" for seed in seeds],
        anchor=population.frozen() if anchored else None,
        resume=resume,
        **settings,
    )


def vectors(made: PopulationTrainer) -> torch.Tensor:
    return torch.stack([vector.detach() for vector in made.population.vectors])


# ---------------------------------------------------------------------------------------------- learning


def test_training_raises_the_reward():
    made = trainer(config=PPOConfig(horizon=24, learning_rate=3e-3), anchored=False, weights={})
    first = made.batch().values["r_sim"]
    for _ in range(25):
        last = made.batch().values["r_sim"]
    assert all(after > before + 0.1 for before, after in zip(first, last, strict=True))


def test_a_bound_holds_the_kl_and_no_bound_lets_it_go():
    bounds = torch.tensor([0.05, math.inf])
    weights = {"calm": torch.tensor([200.0, 200.0])}
    config = PPOConfig(horizon=24, learning_rate=3e-3, multiplier_rate=0.5)
    made = trainer((1, 1), config, bounds=bounds, weights=weights)
    history = [made.batch().values for _ in range(60)]
    held, free = (sum(values["kl"][index] for values in history[-10:]) / 10 for index in (0, 1))
    assert held < 0.05 * 1.5 and free > 5 * held
    assert history[-1]["multiplier"][1] == 0.0 and max(values["multiplier"][0] for values in history) > 0.0


def test_the_bounded_kl_is_seen_from_the_policy_being_trained():
    made = trainer((1,))
    with torch.no_grad():
        made.population.split(made.population.vectors[0])["log_std"].add_(math.log(2.0))  # twice as wide as its anchor
    made.population.refresh()
    observation = torch.rand(1, 5, 3)
    kl = made._measure_kl({"observation": observation.unsqueeze(2)}, {"reference_mean": made.anchor.mean(observation)})
    assert float(kl) == pytest.approx(2 * (1.5 - math.log(2)), rel=1e-5)  # two actions; the other way round 0.64


def test_measured_reward_is_centred_and_weighted_and_nothing_else():
    made = trainer((1, 2), weights={"calm": torch.tensor([0.0, 3.0])})
    data = made.collect()
    total, stats = made._rewards(data)
    simulated = data["next", "reward"].squeeze(-1)
    real = data["next", "real_reward", "calm"].squeeze(-1)
    torch.testing.assert_close(total[0], simulated[0])
    centred = real[1] - real[1].mean()  # the first batch's centre is its own mean
    torch.testing.assert_close(total[1], simulated[1] + 3.0 * 0.02 * centred)
    # Centring is all that happens: the mean measured part is 0 although r_real is about 7, and nothing is cut off.
    assert float((total - simulated)[1].mean()) == pytest.approx(0.0, abs=1e-6)
    assert (total < 0).any()
    assert stats["r_real/calm"][1] == pytest.approx(float(real[1].mean()))
    assert stats["r_sim"][0] == pytest.approx(float(simulated[0].mean()) / 0.02)


def test_each_candidate_has_its_own_learning_rate():
    made = trainer(config=PPOConfig(horizon=6, adaptive_rate=True, desired_kl=0.01, learning_rate=1e-3))

    def adapt(*divergences: float) -> list[float]:
        for index, divergence in enumerate(divergences):
            made.steps.adapt(index, torch.tensor([divergence]))
        return made.steps.rates

    rates = adapt(0.021, 0.004)
    assert rates == pytest.approx([1e-3 / 1.5, 1.5e-3])
    assert adapt(0.015, 0.007) == rates  # between half and twice the target
    for _ in range(60):
        rates = adapt(1.0, 1e-6)
    assert rates == pytest.approx([1e-5, 1e-2])


def test_each_candidates_gradient_is_clipped_by_its_own_norm():
    made = trainer(config=PPOConfig(horizon=6, max_grad_norm=1.0))
    learners = [Learner(Layout(made.population), vector.detach()) for vector in made.population.vectors]
    for index, (learner, norm) in enumerate(zip(learners, (100.0, 0.5), strict=True)):
        learner.gradient.fill_(norm / math.sqrt(len(learner.gradient)))
        made.steps.step(index, learner)
    assert [float(learner.gradient.norm()) for learner in learners] == pytest.approx([1.0, 0.5], rel=1e-4)


def test_warm_up_trains_the_critic_alone():
    made = trainer(config=PPOConfig(horizon=6, warmup_batches=2, entropy_coef=0.01))
    before = made.population.candidate(0)
    for _ in range(2):
        made.batch()
    after = made.population.candidate(0)
    for name in before:
        if name.startswith(("actor", "log_std")):
            assert torch.equal(before[name], after[name]), name
    assert not torch.equal(before["critic.0.weight"], after["critic.0.weight"])
    made.batch()
    assert not torch.equal(before["actor.0.weight"], made.population.candidate(0)["actor.0.weight"])


def test_fine_tuning_leaves_the_normaliser_and_the_anchor_as_they_are():
    made = trainer()
    anchor = [vector.clone() for vector in made.anchor.vectors]
    for _ in range(3):
        made.batch()
    assert not made.population.observation_mean.any() and not made.population.observation_count.any()
    assert all(torch.equal(now, then) for now, then in zip(made.anchor.vectors, anchor, strict=True))


def test_a_batch_reports_every_candidate():
    made = trainer()
    stats = made.batch()
    assert stats.steps == made.steps_per_batch == 2 * 4 * 6
    for name in (
        "r_sim",
        "r_real/calm",
        "kl",
        "multiplier",
        "falls",
        "std",
        "learning_rate",
        "loss/policy",
        "loss/value",
    ):
        assert len(stats.values[name]) == 2, name


# ---------------------------------------------------------------------------------------- bad numbers


def test_a_candidate_whose_measured_reward_is_not_a_number_is_stopped_by_name_and_the_others_go_on():
    made, undisturbed = trainer((1, 2, 3)), trainer((1, 2, 3))
    made.env.poison = {(1, 9)}  # in the second batch, at control step 9
    for _ in range(4):
        made.batch()
        undisturbed.batch()
    assert list(made.stopped) == [1]
    assert (
        made.stopped[1] == "candidate c2: r_real of calm is not finite at control step 9 (batch 1) in 1 of its worlds"
    )
    assert torch.equal(vectors(made)[[0, 2]], vectors(undisturbed)[[0, 2]])
    assert torch.equal(vectors(made)[1], made.anchor.vectors[1])  # put back, not trained on


def test_a_candidate_whose_task_reward_is_not_a_number_is_stopped_by_name():
    made = trainer((1, 2))
    made.env.poison_sim = {(0, 2)}
    made.batch()
    assert made.stopped == {0: "candidate c1: r_sim is not finite at control step 2 (batch 0) in 1 of its worlds"}


def test_a_candidate_with_a_gradient_that_is_not_finite_is_stopped_and_the_others_step():
    made = trainer((1, 2))
    before = vectors(made)
    learners = [Learner(Layout(made.population), vector) for vector in before]
    for index, (learner, slope) in enumerate(zip(learners, (math.inf, 1.0), strict=True)):
        learner.gradient.fill_(slope)
        made.steps.step(index, learner)
    assert list(made.stopped) == [0] and "gradient is not finite" in made.stopped[0]
    assert torch.equal(vectors(made)[0], before[0])  # put back
    stood, moved = (
        torch.equal(learner.parameters, Layout(made.population).packed(vector))
        for learner, vector in zip(learners, before, strict=True)
    )
    assert stood and not moved


def test_training_ends_with_an_error_when_no_candidate_is_left():
    made = trainer((1, 2))
    made.env.poison = {(0, 1), (1, 8)}
    made.batch()
    with pytest.raises(
        SimulationError, match=r"no candidate is left: candidate c1: .*step 1 .*; candidate c2: .*step 8"
    ):
        made.batch()


# --------------------------------------------------------------------------- independence and resuming


def test_a_candidate_ends_with_the_same_parameters_alone_and_in_a_crowd():
    crowd, alone = trainer((5, 1, 9)), trainer((1,))
    for _ in range(5):
        many, one = crowd.batch(), alone.batch()
    assert torch.equal(vectors(crowd)[1], vectors(alone)[0])
    assert one.values["kl"][0] == many.values["kl"][1]
    assert not torch.equal(vectors(crowd)[0], vectors(crowd)[1])


def test_training_goes_on_from_a_saved_state_as_if_undisturbed():
    made = trainer((1, 2), anchored=True)
    for _ in range(2):
        made.batch()
    state = made.full_state().clone()
    expected = [made.batch().values for _ in range(3)]
    other = trainer((1, 2), resume=state)
    went_on = [other.batch().values for _ in range(3)]
    assert went_on == expected
    assert torch.equal(vectors(other), vectors(made)) and other.batches == made.batches == 5


def test_a_stopped_candidate_stays_stopped_after_resuming():
    made = trainer((1, 2))
    made.env.poison = {(0, 1)}
    made.batch()
    other = trainer((1, 2), resume=made.full_state())
    assert list(other.stopped) == [0]
    before = vectors(other)
    other.batch()
    assert torch.equal(vectors(other)[0], before[0]) and not torch.equal(vectors(other)[1], before[1])


# ------------------------------------------------------------------------------------------- on the robot


def walking(seeds, resume=None) -> PopulationTrainer:
    """The shipped policy, fine-tuned with a measurement model in the loop and episodes that end."""
    pytest.importorskip("hts_go1", reason="the robot of this test is not installed")
    from hts.policies.files import load_policy
    from hts_go1.robot import Go1, Go1Settings

    robot = Go1(Go1Settings())
    config = EnvConfig(randomisation=RandomisationConfig(models=2), threads=1, episode_seconds=0.24)
    inputs = ("joint_torque", "joint_velocity")
    env = robot.make_env("mujoco", len(seeds), 3, config, inputs, seeds)
    signals = Signals(tuple(Channel(name, "1", (12,)) for name in inputs), Channel("cost", "1"), 50.0)
    model = LSTM(LSTMSettings(hidden=8), signals)
    env = measured_env(env, [MeasurementTransform(model, torch.neg, "cheap")])
    shipped = load_policy(robot.pretrained_policy(), robot.spec)
    population = Population.from_candidates(shipped.card.sizes(), [shipped.tensors] * len(seeds))
    count = len(seeds)
    return PopulationTrainer(
        env,
        population,
        PPOConfig(horizon=8, epochs=2, minibatches=2),
        seeds=seeds,
        names=[str(seed) for seed in seeds],
        anchor=population.frozen(),
        bounds=torch.full((count,), 0.5),
        weights={"cheap": torch.full((count,), 5.0)},
        resume=resume,
    )


def test_on_the_robot_a_candidate_trains_the_same_alone_and_in_a_population_of_six():
    crowd, alone = walking((4, 8, 6, 1, 2, 3)), walking((8,))
    for _ in range(3):
        crowd.batch()
        alone.batch()
    torch.testing.assert_close(vectors(crowd)[1], vectors(alone)[0], rtol=0, atol=1e-6)
    for made in (crowd, alone):
        made.close()


def test_on_the_robot_training_resumes_exactly_from_a_checkpoint_in_the_middle_of_episodes(tmp_path):
    made = walking((3, 4))
    made.batch()
    save_checkpoint(tmp_path / "training", made.full_state().to_dict(), {"robot": "go1"})
    state = TensorDict(dict(load_checkpoint(tmp_path / "training", {"robot": "go1"})))
    expected = [made.batch().values for _ in range(2)]
    other = walking((3, 4), resume=state)
    assert [other.batch().values for _ in range(2)] == expected
    assert torch.equal(vectors(other), vectors(made))
    for each in (made, other):
        each.close()


# ------------------------------------------------------------------------------------------- checkpoint files


def checkpoint(tmp_path):
    path = tmp_path / "training"
    save_checkpoint(path, {"part": {"numbers": torch.arange(1000.0)}}, {"robot": "dog", "worlds": 4})
    return path


def test_a_checkpoint_holds_what_was_saved(tmp_path):
    state = load_checkpoint(checkpoint(tmp_path), {"robot": "dog"})
    assert torch.equal(state["part"]["numbers"], torch.arange(1000.0))


@pytest.mark.parametrize("keep", [0, 50, 2000, -10])
def test_a_truncated_checkpoint_is_one_line_that_says_what_to_do(tmp_path, keep):
    path = checkpoint(tmp_path)
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(PolicyError, match="training: not a whole checkpoint .* Delete it and resume"):
        load_checkpoint(path, {"robot": "dog"})


def test_a_checkpoint_of_another_robot_is_refused(tmp_path):
    with pytest.raises(PolicyError, match="a checkpoint of robot 'dog', this run has 'cat'"):
        load_checkpoint(checkpoint(tmp_path), {"robot": "cat"})
