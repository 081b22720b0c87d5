"""Groups of candidates in envs of their own: the same bits as one env of all, stepped side by side."""

from threading import Barrier

import pytest
import torch

from hts.config import EnvConfig
from hts.cores import available
from hts.errors import SimulationError
from hts.policies.files import load_policy
from hts.rl.actor import PopulationActor
from hts.rl.grouped_env import GroupedEnv
from hts.rl.population import Population
from hts.rl.population_collector import PopulationCollector, torchrl_collector
from hts.rl.random import PopulationRandom
from hts_go1.plugin import make_go1

SEEDS, WORLDS, HORIZON = (3, 4, 9), 6, 12
FRAMES = len(SEEDS) * WORLDS * HORIZON


@pytest.fixture(scope="module")
def robot():
    return make_go1({})


@pytest.fixture
def make(robot):
    """make(threads) -> env of three candidates, in two groups if it has two threads; closed afterwards."""
    made = []

    def make(threads):
        config = EnvConfig(episode_seconds=0.1, threads=threads, randomisation={"models": 2})
        channels = ("joint_torque", "command", "angular_velocity")
        env = robot.make_env("mujoco", len(SEEDS), WORLDS, config, channels=channels, seeds=list(SEEDS))
        made.append(env)
        return env

    yield make
    for env in made:
        if not env.is_closed:
            env.close()


def actor_of(robot) -> PopulationActor:
    """Three candidates that differ, and their noise."""
    policy = load_policy(robot.pretrained_policy())
    population = Population.from_candidates(policy.card.sizes(), [policy.tensors] * len(SEEDS))
    with torch.no_grad():
        for index, vector in enumerate(population.vectors):
            vector.mul_(1.0 + 0.01 * index)
    population.refresh()
    return PopulationActor(population, PopulationRandom([seed + 101 for seed in SEEDS], torch.device("cpu")))


def assert_same(found, expected) -> None:
    for key in found.keys(True, True):
        assert torch.equal(found[key], expected[key]), key


def test_two_threads_make_two_groups_and_one_thread_one_env(make):
    grouped, whole = make(2), make(1)
    assert isinstance(grouped, GroupedEnv) and [group.batch_size[0] for group in grouped.groups()] == [2, 1]
    assert list(whole.groups()) == [whole]
    assert grouped.batch_size == whole.batch_size == (3, 6)
    for name in ("observation_spec", "action_spec", "reward_spec", "full_done_spec"):
        assert getattr(grouped, name) == getattr(whole, name), name


@pytest.mark.parametrize("collector", [PopulationCollector, torchrl_collector])
def test_a_grouped_env_gives_the_bits_of_one_env_of_all(robot, make, collector):
    expected = iter(torchrl_collector(make(1), actor_of(robot), FRAMES))
    found = iter(collector(make(2), actor_of(robot), frames_per_batch=FRAMES))
    for _ in range(2):
        batch = next(found)
        assert_same(batch, next(expected))
        assert batch["next", "truncated"].any() and (batch["next", "reward"] != 0).all()


def test_a_saved_state_opens_in_groups_and_in_one_env(robot, make):
    envs = make(2), make(1)
    collectors = [PopulationCollector(env, actor_of(robot), frames_per_batch=FRAMES) for env in envs]
    state = [(collector.collect(), collector.state_dict())[1] for collector in collectors]
    assert_same(*(one["env_state_dict"] for one in state))
    expected = collectors[0].collect()
    for threads, saved in zip((1, 2), state, strict=True):  # each in the other kind
        other = PopulationCollector(make(threads), actor_of(robot), frames_per_batch=FRAMES)
        other.load_state_dict(saved)
        assert_same(other.collect(), expected)


def with_clocks(env, clocks) -> list:
    """Groups that save one number each beside their state; returns what they load later."""
    loaded = []
    for group, clock in zip(env.groups(), clocks, strict=True):
        full_state, load = group.full_state, group.load_full_state
        group.full_state = lambda full_state=full_state, clock=clock: full_state().set(
            ("own", "clock"), torch.tensor(clock)
        )
        group.load_full_state = lambda state, load=load: (loaded.append(state["own", "clock"]), load(state))
    return loaded


def test_a_number_that_all_groups_share_is_saved_once_and_given_to_each(make):
    env = make(2)
    loaded = with_clocks(env, (3, 3))
    env.reset()
    state = env.full_state()
    assert state["own", "clock"].shape == () and state["own", "clock"] == 3
    env.load_full_state(state)
    assert loaded == [3, 3]
    assert_same(env.full_state(), state)


def test_a_number_that_groups_do_not_share_is_told_in_one_line(make):
    env = make(2)
    with_clocks(env, (3, 4))
    env.reset()
    with pytest.raises(SimulationError, match=r"saves one number as 'own.clock', .* different ones \(3, 4\)"):
        env.full_state()


def test_a_seed_given_later_is_that_of_one_env(make):
    grouped, whole = make(2), make(1)
    for env in (grouped, whole):
        env.set_seed(7)
    assert_same(grouped.reset(), whole.reset())
    assert grouped.random.generators[2] is grouped.groups()[1].random.generators[0]


@pytest.mark.skipif(available() < 2, reason="one core: groups take turns")
def test_groups_are_in_their_physics_at_the_same_time(robot, make):
    env, meeting = make(2), Barrier(2, timeout=300.0)
    for group in env.groups():
        step = group.engine.step
        group.engine.step = lambda ctrl, step=step: (meeting.wait(), step(ctrl))  # goes on when both are there
    PopulationCollector(env, actor_of(robot), frames_per_batch=FRAMES).collect()
    assert not meeting.broken


def test_physics_that_fails_in_one_group_ends_the_batch_with_its_error(robot, make):
    env = make(2)
    collector = PopulationCollector(env, actor_of(robot), frames_per_batch=FRAMES)
    collector.collect()

    def fails(ctrl):
        raise SimulationError("the second group has failed")

    env.groups()[1].engine.step = fails
    with pytest.raises(SimulationError, match="the second group has failed"):
        collector.collect()
    collector.shutdown()  # the other group has not been left waiting
