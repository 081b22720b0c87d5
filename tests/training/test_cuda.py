"""What only a GPU can show: captured steps do what the same steps do one operation at a time. Skipped without CUDA."""

import math

import pytest
import torch

from hts.channels import Channel
from hts.config import EnvConfig, PPOConfig
from hts.contracts import Signals
from hts.errors import SimulationError
from hts.measurement.lstm import LSTM, LSTMSettings
from hts.measurement.transform import MeasurementTransform
from hts.policies.files import load_policy
from hts.rl.batched_updates import BatchedSteps
from hts.rl.population import Population
from hts.rl.random import PrefetchedNoise
from hts.training.finetune import measured_env
from hts.training.trainer import PopulationTrainer, update_settings

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")

CHANNELS = {"joint_torque": (12,), "joint_velocity": (12,)}
SUBSTEPS = {"substep_torque": (4, 12), "substep_velocity": (4, 12)}
CONFIG = PPOConfig(horizon=8, epochs=2, minibatches=2, fuse=False)
SEEDS = (3, 4)
LONG = EnvConfig(randomisation={"models": 2})
SHORT = EnvConfig(randomisation={"models": 2}, episode_seconds=0.3, stagger=True)  # some episodes end in each batch


def make_trainer(
    config: PPOConfig = CONFIG,
    reward=None,
    resume=None,
    seeds=SEEDS,
    worlds=64,
    env_config: EnvConfig = LONG,
    channels=CHANNELS,
) -> PopulationTrainer:
    from hts_go1.plugin import make_go1

    robot = make_go1({})
    env = robot.make_env("warp", len(seeds), worlds, env_config, tuple(channels), list(seeds))
    signals = Signals(tuple(Channel(name, "1", shape) for name, shape in channels.items()), Channel("t", "N*m"), 50.0)
    model = LSTM(LSTMSettings(hidden=8), signals, seed=1)
    size = sum(math.prod(shape) for shape in channels.values())
    some = torch.randn(200, size + 1, generator=torch.Generator().manual_seed(0))
    model.set_statistics(some[:, :size] * 5, some[:, size])
    policy = load_policy(robot.pretrained_policy())
    population = Population.from_candidates(policy.card.sizes(), [policy.tensors] * len(seeds), env.device)
    population.refresh()
    return PopulationTrainer(
        measured_env(env, [MeasurementTransform(model, reward or (lambda x: -x), "cost")]),
        population,
        config,
        seeds=seeds,
        names=[str(seed) for seed in seeds],
        anchor=population.frozen(),
        bounds=torch.full((len(seeds),), 0.5),
        weights={"cost": torch.ones(len(seeds))},
        resume=resume,
    )


@pytest.mark.parametrize("env_config", [LONG, SHORT], ids=["long", "short"])
@pytest.mark.parametrize("fuse", [False, True])
def test_a_captured_batch_is_the_batch_of_its_steps(fuse, env_config):
    captured = make_trainer(CONFIG.model_copy(update={"fuse": fuse}), env_config=env_config)
    plain = make_trainer(env_config=env_config)
    plain.collector._wants_capture = False
    plain.collector._begun = True
    for transform in plain.collector.transforms:
        transform.prepare(plain.env.batch_size.numel(), plain.population.device)
    plain.collector.bare_env.reset()  # the first episodes draw their numbers before any are drawn ahead
    first = captured.collect()
    for random in (plain.env.base_env.random, plain.noise):
        random.prefetched = PrefetchedNoise(random, CONFIG.horizon, plain.collector._time)
    second = plain.collect()
    assert captured.collector.captured and not plain.collector.captured
    torch.testing.assert_close(first["action"][:, :, 0], second["action"][:, :, 0], atol=1e-3, rtol=0)
    for key in ("observation", "critic_observation", "action", "state_value", "reference_loc"):
        worst = (
            (first[key] - second[key]).abs().flatten(3).amax(-1)
            if first[key].ndim > 3
            else (first[key] - second[key]).abs()
        )
        # Contacts are solved in no fixed order on a GPU, so a few worlds drift apart; most must not.
        assert float((worst < 5e-2).float().mean()) > 0.95, key
    assert torch.equal(first["next", "truncated"], second["next", "truncated"])
    close = (first["next", "real_reward", "cost"] - second["next", "real_reward", "cost"]).abs() < 5e-2
    assert float(close.float().mean()) > 0.95
    captured.close()
    plain.close()


@pytest.mark.parametrize("fuse", [False, True])
def test_a_model_of_the_physics_steps_is_paid_in_captured_steps(fuse):
    captured = make_trainer(CONFIG.model_copy(update={"fuse": fuse}), channels=SUBSTEPS)
    plain = make_trainer(CONFIG.model_copy(update={"capture": False}), channels=SUBSTEPS)
    rewards = [trainer.collect()["next", "real_reward", "cost"] for trainer in (captured, plain)]
    assert captured.collector.captured and not plain.collector.captured
    for reward in rewards:
        assert torch.isfinite(reward).all()
        assert float(reward.std(dim=2).min()) > 0  # of every world: the steps it sees are the running ones
    means = [float(reward.mean()) for reward in rewards]
    assert means[0] == pytest.approx(means[1], abs=0.3 * float(rewards[1].std()))  # other noise, the same walk
    captured.close()
    plain.close()


def test_batches_go_on_from_each_other_and_use_fresh_numbers():
    trainer = make_trainer()
    first = trainer.collect()
    actions, before = first["action"].clone(), trainer.env.base_env.steps.clone()
    second = trainer.collect()
    assert not torch.equal(actions, second["action"])
    went_on = trainer.env.base_env.steps - before
    assert float((went_on == CONFIG.horizon).float().mean()) > 0.9  # all but those whose episode ended
    trainer.close()


@pytest.mark.parametrize("fuse", [False, True])
def test_captured_gradient_steps_are_those_taken_one_by_one(fuse):
    trainer = make_trainer()
    data = trainer.collect()
    with torch.no_grad():
        samples, constant = trainer._samples(data, trainer._rewards(data)[0])
    size = samples["advantage"].shape[1]
    orders = [torch.stack([torch.randperm(size, device="cuda") for _ in SEEDS]) for _ in range(3)]
    results = []
    for capture, fused in ((False, False), (True, fuse)):
        population = Population.from_candidates(
            trainer.population.sizes, [trainer.population.candidate(index) for index in range(len(SEEDS))], "cuda"
        )
        settings = update_settings(CONFIG.model_copy(update={"adaptive_rate": True}))
        stop = lambda index, reason: pytest.fail(reason)
        steps = BatchedSteps(population, settings, stop, capture, tf32=False, fuse=fused)
        losses = steps.run(samples, constant, torch.tensor([0.0, 2.0], device="cuda"), orders, 1.0)
        results.append((torch.stack([v.detach() for v in population.vectors]), losses, steps.rates))
    (plain, losses, rates), (captured, same_losses, same_rates) = results
    torch.testing.assert_close(captured, plain, atol=0.1 * CONFIG.learning_rate, rtol=0)
    assert same_rates == pytest.approx(rates)
    for name, loss in losses.items():
        torch.testing.assert_close(same_losses[name], loss, atol=1e-3, rtol=1e-2)
    trainer.close()


def test_training_goes_on_from_a_saved_state():
    trainer = make_trainer()
    for _ in range(2):
        trainer.batch()
    state = trainer.full_state().clone()
    expected = trainer.batch().values
    resumed = make_trainer(resume=state)
    for index, vector in enumerate(resumed.population.vectors):
        assert torch.equal(vector, state["vectors", str(index)])
    found = resumed.batch().values
    assert resumed.batches == 3
    for name in ("r_sim", "r_real/cost", "kl", "std"):
        assert found[name] == pytest.approx(expected[name], rel=0.2, abs=5e-2), name
    trainer.close()
    resumed.close()


@pytest.mark.parametrize("fuse", [False, True])
def test_a_reward_that_waits_for_the_device_is_named_with_what_to_do(fuse):
    config = CONFIG.model_copy(update={"fuse": fuse})
    trainer = make_trainer(config, reward=lambda x: -x if float(x.sum()) != 0.5 else x)
    with pytest.raises(SimulationError, match=r"waits for the device.*ppo\.capture=false"):
        trainer.collect()


def test_a_candidate_alone_and_in_a_crowd_draws_the_same_noise():
    crowd, alone = make_trainer(), make_trainer(seeds=(4,))
    both, single = crowd.collect(), alone.collect()
    noise = (both["action"] - both["loc"])[1]
    torch.testing.assert_close(noise, (single["action"] - single["loc"])[0], atol=1e-5, rtol=0)
    crowd.close()
    alone.close()
