"""Collection and gradient steps as a GPU runs them, here uncaptured on the CPU against what the CPU runs."""

from functools import partial

import pytest
import torch
from torchrl.data import Unbounded
from torchrl.envs.transforms import RewardScaling, TransformedEnv

from hts.channels import Channel
from hts.config import EnvConfig, PPOConfig
from hts.contracts import Signals
from hts.measurement.lstm import LSTM, LSTMSettings
from hts.measurement.transform import MeasurementTransform, ProxyTransform
from hts.policies.files import load_policy
from hts.rl.batched_updates import BatchedSteps
from hts.rl.capture import StaticBuffers
from hts.rl.captured_collector import CapturedCollector
from hts.rl.deferred import DeferrableTransform
from hts.rl.population import Population
from hts.rl.population_collector import PopulationCollector, can_split, torchrl_collector
from hts.rl.random import PopulationRandom, PrefetchedNoise
from hts.rl.settings import UpdateSettings
from hts.rl.task_env import SplitStepEnv, TaskEnv
from hts.rl.updates import SeparateSteps
from hts.training.finetune import measured_env
from hts.training.trainer import PopulationTrainer, update_settings
from hts_go1.plugin import make_go1

CHANNELS = ("joint_torque", "joint_velocity")
CONFIG = PPOConfig(horizon=12, epochs=2, minibatches=2, adaptive_rate=True)


@pytest.fixture(scope="module")
def robot():
    return make_go1({})


class TorqueObjective:
    """As much of an objective as the baseline's transform wants."""

    name, target, inputs = "cost", Channel("t", "N*m"), CHANNELS

    proxy_in_physics_steps = False

    def proxy(self, channels):
        return channels["joint_torque"].square().sum(-1)

    def reward(self, measured):
        return -0.01 * measured


def make_trainer(robot, seeds=(3, 4), worlds=6, proxy=False) -> PopulationTrainer:
    """Fine-tuning of two candidates, episodes of five steps, so that some end within each batch."""
    config = EnvConfig(episode_seconds=0.1, threads=1, randomisation={"models": 2})
    env = robot.make_env("mujoco", len(seeds), worlds, config, channels=CHANNELS, seeds=list(seeds))
    signals = Signals(tuple(Channel(name, "1", (12,)) for name in CHANNELS), Channel("t", "N*m"), 50.0)
    model = LSTM(LSTMSettings(hidden=8), signals, seed=1)
    some = torch.randn(50, 25, generator=torch.Generator().manual_seed(0))
    model.set_statistics(some[:, :24] * 5, some[:, 24])
    measured = ProxyTransform(TorqueObjective()) if proxy else MeasurementTransform(model, lambda x: -x, "cost")
    policy = load_policy(robot.pretrained_policy())
    population = Population.from_candidates(policy.card.sizes(), [policy.tensors] * len(seeds))
    population.refresh()
    return PopulationTrainer(
        measured_env(env, [measured]),
        population,
        CONFIG,
        seeds=seeds,
        names=[str(seed) for seed in seeds],
        anchor=population.frozen(),
        bounds=torch.full((len(seeds),), 0.5),
        weights={"cost": torch.ones(len(seeds))},
    )


FRAMES = 2 * 6 * CONFIG.horizon


def cpu_collector(trainer):
    assert isinstance(trainer.collector, PopulationCollector)
    return trainer.collector


def gpu_collector(trainer):
    return CapturedCollector(
        trainer.env, trainer.actor, frames_per_batch=FRAMES, capture=False, tf32=False, compiled=False
    )


def break_a_world(trainer, at: int):
    """From the at-th step on, the physics of a world breaks at every seventh."""
    engine, count = trainer.env.base_env.engine, 0
    step = engine.step

    def breaking(ctrl):
        nonlocal count
        step(ctrl)
        count += 1
        if count >= at and (count - at) % 7 == 0:
            engine.diverged[4] = True

    engine.step = breaking


@pytest.mark.parametrize("proxy", [False, True], ids=["model", "proxy"])
@pytest.mark.parametrize("make_collector", [cpu_collector, gpu_collector])
def test_a_population_collector_collects_what_torchrls_collector_collects_bit_by_bit(robot, make_collector, proxy):
    usual, other = make_trainer(robot, proxy=proxy), make_trainer(robot, proxy=proxy)
    collector = torchrl_collector(usual.env, usual.actor, FRAMES)
    stream, batches = iter(collector), iter(make_collector(other))
    for trainer in (usual, other):
        break_a_world(trainer, 3)
    for _ in range(2):
        expected, found = next(stream), next(batches)
        assert found.batch_size == expected.batch_size == (2, 6, CONFIG.horizon)
        missing = set(expected.keys(True, True)) - set(found.keys(True, True))
        assert {key[0] for key in missing if isinstance(key, tuple)} <= {
            "channels",
            "collector",
            "next",
            "measured",
            "real_reward",
            "outside",
        }
        for key in found.keys(True, True):
            assert torch.equal(found[key], expected[key]), key
        for key in (
            ("next", "observation"),
            ("next", "critic_observation"),
            ("next", "reward"),
            ("next", "done"),
            "action_log_prob",
            ("next", "measured", "t"),
            ("next", "real_reward", "cost"),
        ):
            assert key in found.keys(True), key
        assert found["next", "truncated"].any()  # episodes have ended, so resets are compared too
        assert (found["next", "real_reward", "cost"] != 0).any()
    for trainer in (usual, other):
        assert int(trainer.env.base_env.breakdowns.sum()) == 4
    collector.shutdown()
    other.close()


def test_a_seed_given_to_a_collector_draws_other_numbers_for_exploration_than_for_the_env(robot):
    trainer, other = make_trainer(robot), make_trainer(robot, seeds=(7, 8))
    trainer.collector.set_seed(7)
    env, noise = trainer.collector.bare_env.random, trainer.noise
    drawn = noise.normal(50)
    assert not any(torch.equal(one, two) for one in env.normal(50) for two in drawn)
    assert torch.equal(drawn, other.noise.normal(50))  # as a trainer of these seeds
    for one in (trainer, other):
        one.close()


def test_under_next_stands_what_the_old_episode_ended_in_and_not_the_new_episodes_beginning(robot):
    trainer = make_trainer(robot)
    data = trainer.collect()
    done = data["next", "done"][:, :, :-1].squeeze(-1)
    assert done.any()
    following, begun = data["next", "critic_observation"][:, :, :-1], data["critic_observation"][:, :, 1:]
    assert torch.equal(following[~done], begun[~done])  # a step ends where the next one begins,
    assert (following[done] != begun[done]).any(-1).all()  # but for those that ended an episode
    trainer.close()


def test_a_task_that_would_be_passed_by_is_refused_when_it_is_written():
    with pytest.raises(TypeError, match="Own overrides _step: a collector that steps by parts would pass it by"):

        class Own(SplitStepEnv):
            def _step(self, tensordict): ...

    class Other(TaskEnv):  # any other env may
        def _step(self, tensordict): ...


def test_a_transform_that_changes_the_step_goes_through_torchrls_collector(robot):
    env = robot.make_env(
        "mujoco", 1, 2, EnvConfig(threads=1, randomisation={"models": 1}), channels=CHANNELS, seeds=[1]
    )
    assert can_split(env) and can_split(measured_env(env, []))
    scaled = TransformedEnv(env, RewardScaling(0.0, 2.0))
    assert not can_split(scaled)
    with pytest.raises(TypeError, match=r"found VelocityEnv \+ RewardScaling. Take torchrl.collectors.Collector"):
        PopulationCollector(scaled, None, frames_per_batch=2)
    env.close()


class Effort(DeferrableTransform):
    """Writes an entry whose key is a plain word."""

    def __init__(self):
        super().__init__(in_keys=[], out_keys=["effort"])

    def record(self, channels):
        return channels["joint_torque"].square().sum(-1, keepdim=True).flatten(0, 1)

    def evaluate(self, recorded):
        return {"effort": recorded}

    def forget(self, ended): ...

    def transform_observation_spec(self, observation_spec):
        observation_spec["effort"] = Unbounded((*observation_spec.shape, 1))
        return observation_spec


@pytest.mark.parametrize("fast", [PopulationCollector, partial(CapturedCollector, capture=False)])
def test_a_transform_may_name_its_entry_by_a_plain_word(robot, fast):
    def collected(make):
        trainer = make_trainer(robot)
        env = measured_env(trainer.env.base_env, [Effort()])
        collector = make(env, trainer.actor)
        data = next(iter(collector))
        collector.shutdown()
        trainer.close()
        return data

    plain = collected(lambda env, actor: torchrl_collector(env, actor, FRAMES))
    found = collected(partial(fast, frames_per_batch=FRAMES))
    assert torch.equal(found["next", "effort"], plain["next", "effort"]) and (found["next", "effort"] > 0).all()


def test_what_is_computed_beside_the_physics_is_what_learning_would_compute_itself(robot):
    trainer = make_trainer(robot)
    collector = CapturedCollector(
        trainer.env, trainer.actor, frames_per_batch=FRAMES, capture=False, side_stream=True, reference=trainer.anchor
    )
    data = collector.collect()
    with torch.no_grad():
        reward = trainer._rewards(data)[0]
        (found, _), (expected, _) = (
            trainer._samples(data, reward),
            trainer._samples(data.exclude("state_value", "reference_loc"), reward),
        )
    assert {"state_value", "reference_loc"} <= set(data.keys())
    for name, value in expected.items():
        torch.testing.assert_close(found[name], value, atol=5e-5, rtol=1e-4)  # products of other shapes round otherwise
    trainer.close()


def test_numbers_drawn_ahead_differ_from_step_to_step_and_depend_on_their_own_candidate_alone():
    def steps(seeds):
        random, time = PopulationRandom(seeds, torch.device("cpu")), torch.zeros(1, dtype=torch.int64)
        random.prefetched = PrefetchedNoise(random, 3, time)
        seen = []
        for batch in range(2):
            if batch:
                random.renew()
            for step in range(3):
                time.fill_(step)
                random.begin_step()
                seen.append(torch.cat((random.uniform(4, 2), random.uniform(4, 2), random.normal(4, 1)), -1))
        return torch.stack(seen)

    both, alone = steps([5, 6]), steps([6])
    assert torch.equal(both[:, 1], alone[:, 0])
    assert len(set(both.flatten().tolist())) == both.numel()  # nothing comes twice
    random = PopulationRandom([1], torch.device("cpu"))
    random.prefetched = PrefetchedNoise(random, 3, torch.zeros(1, dtype=torch.int64))
    random.uniform(4)
    random.begin_step()
    with pytest.raises(RuntimeError, match="draw 0"):
        random.uniform(5)


def test_gradient_steps_taken_together_are_those_taken_apart(robot):
    trainer = make_trainer(robot)
    data = trainer.collect()
    with torch.no_grad():
        samples, constant = trainer._samples(data, trainer._rewards(data)[0])
    # Of its own: in one order in twenty a gradient is so near zero that Adam's first step may go either way.
    random = torch.Generator().manual_seed(0)
    orders = [torch.stack([torch.randperm(72, generator=random) for _ in range(2)]) for _ in range(3)]
    results = []
    for make in (SeparateSteps, lambda *given: BatchedSteps(*given, capture=False)):
        population = Population.from_candidates(
            trainer.population.sizes, [trainer.population.candidate(index) for index in range(2)]
        )
        steps = make(population, update_settings(CONFIG), lambda index, reason: pytest.fail(reason))
        losses = steps.run(samples, constant, torch.tensor([0.0, 2.0]), orders, 1.0)
        results.append((torch.stack(list(population.vectors)).detach(), losses, torch.tensor(steps.rates)))
    (apart, losses, rates), (together, same_losses, same_rates) = results
    assert not torch.equal(apart, torch.stack(list(trainer.population.vectors)))
    # Adam's first steps have the size of the rate whatever the gradient: a tenth of the rate is close.
    torch.testing.assert_close(together, apart, atol=0.1 * CONFIG.learning_rate, rtol=0)
    torch.testing.assert_close(same_rates, rates)
    for name, loss in losses.items():
        torch.testing.assert_close(same_losses[name], loss, atol=1e-4, rtol=1e-3)
    trainer.close()


def test_taken_together_a_gradient_that_is_not_finite_stops_its_candidate_alone():
    from hts.rl.population import Sizes

    population = Population(Sizes(3, 3, 2, (4,)), 2)
    before = torch.stack(list(population.vectors)).detach().clone()
    reported = []
    steps = BatchedSteps(
        population, UpdateSettings(minibatches=2), lambda index, reason: reported.append((index, reason)), capture=False
    )
    samples = {
        "observation": torch.randn(2, 8, 3),
        "critic_observation": torch.randn(2, 8, 3),
        "action": torch.randn(2, 8, 2),
        "old_mean": torch.zeros(2, 8, 2),
        "log_prob": torch.zeros(2, 8),
        "advantage": torch.randn(2, 8),
        "target": torch.randn(2, 8),
        "old_value": torch.zeros(2, 8),
    }
    samples["advantage"][0, 3] = torch.inf
    order = torch.arange(8).expand(2, 8)
    steps.run(samples, {"old_log_std": torch.zeros(2, 1, 2)}, torch.zeros(2), [order], 1.0)
    assert reported == [(0, "the gradient is not finite")]
    after = torch.stack(list(population.vectors)).detach()
    assert torch.isfinite(after).all() and not torch.equal(after[1], before[1])
    steps.halt(0)
    now = after.clone()
    samples["advantage"][0, 3] = 0.0  # even with finite numbers it does not move again
    steps.run(samples, {"old_log_std": torch.zeros(2, 1, 2)}, torch.zeros(2), [order], 1.0)
    later = torch.stack(list(population.vectors)).detach()
    assert torch.equal(later[0], now[0]) and not torch.equal(later[1], now[1])


def test_held_state_stays_in_its_memory_while_its_values_move():
    class Owner:
        def __init__(self):
            self.kept, self.absent = torch.zeros(2), None

    owner = Owner()
    buffers = StaticBuffers(owner, ("kept", "absent"))
    place = owner.kept.data_ptr()
    owner.kept = owner.kept + 1.0
    buffers.copy_back()
    assert owner.kept.data_ptr() == place and owner.kept.tolist() == [1.0, 1.0]
    buffers.restore()
    assert owner.kept.data_ptr() == place and owner.kept.tolist() == [0.0, 0.0]
